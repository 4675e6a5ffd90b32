# SPDX-License-Identifier: GPL-3.0-or-later
"""What every example is put together from: stage, materials, shapes, lights and a camera, through bpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

Colour = Sequence[float]


def empty_stage(world: Colour = (0.0, 0.0, 0.0), size: tuple[int, int] = (960, 540)) -> bpy.types.Scene:
    """An empty file whose one scene is set up for direct light alone, in a world of one colour."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "Standard"
    scene.render.dither_intensity = 0.0  # its noise would triple the size of a PNG
    scene.world = bpy.data.worlds.new("World")
    _with_nodes(scene.world)
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*world, 1.0)
    direct_light_only(scene)
    return scene


def direct_light_only(scene: bpy.types.Scene) -> None:
    """Make Cycles render what CV Render does: no bounces, box filter, every light, no denoising."""
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device = "CPU"
    for bounces in ("max", "diffuse", "glossy", "transmission", "volume"):
        setattr(cycles, f"{bounces}_bounces", 0)
    cycles.pixel_filter_type = "BOX"
    cycles.light_sampling_threshold = 0.0
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.samples = 64


def _with_nodes(block: bpy.types.World | bpy.types.Material) -> None:
    """Give a new data-block its nodes; from Blender 5 on it has them already."""
    if block.node_tree is None:
        block.use_nodes = True


def material(name: str, colour: Colour = (0.8, 0.8, 0.8), emission: float = 0.0) -> bpy.types.Material:
    """A Diffuse BSDF of ``colour``, or an emitter of ``emission`` times ``colour`` in W/(sr m2)."""
    made = bpy.data.materials.new(name)
    _with_nodes(made)
    made.diffuse_color = (*colour, 1.0)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    shader = nodes.new("ShaderNodeEmission" if emission else "ShaderNodeBsdfDiffuse")
    shader.inputs["Color"].default_value = (*colour, 1.0)
    if emission:
        shader.inputs["Strength"].default_value = emission
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (220, 0)
    links.new(shader.outputs[0], output.inputs["Surface"])
    return made


def place(name: str, data: Any, location: Sequence[float] = (0, 0, 0), **properties: Any) -> bpy.types.Object:
    """A new object of the scene; ``properties`` such as ``rotation_euler`` or ``scale`` are set on it."""
    placed = bpy.data.objects.new(name, data)
    placed.location = location
    for key, value in properties.items():
        setattr(placed, key, value)
    bpy.context.scene.collection.objects.link(placed)
    return placed


def mesh(
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    surface: bpy.types.Material | None = None,
    smooth: bool = False,
) -> bpy.types.Mesh:
    """A mesh of (V, 3) vertices and (F, 3 or 4) faces in one material."""
    made = bpy.data.meshes.new(name)
    made.from_pydata(np.asarray(vertices, float), [], np.asarray(faces))
    made.polygons.foreach_set("use_smooth", np.full(len(made.polygons), smooth))
    made.materials.append(surface)
    return made


def grid_faces(rows: int, columns: int, around: bool = False) -> np.ndarray:
    """(F, 4) squares between ``rows`` x ``columns`` vertices; ``around`` closes every row to a ring."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - (not around)), indexing="ij")
    k = (j + 1) % columns
    corners = (i * columns + j, i * columns + k, (i + 1) * columns + k, (i + 1) * columns + j)
    return np.stack(corners, -1).reshape(-1, 4)


def box(name: str, size: Sequence[float], surface: bpy.types.Material) -> bpy.types.Mesh:
    """A box of ``size`` that stands on z = 0, centred in x and y."""
    corners = np.array([(x, y, z) for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)]
    return mesh(name, corners * size, np.array(faces), surface)


def ball(name: str, radius: float, surface: bpy.types.Material, cells: int = 12) -> bpy.types.Mesh:
    """A smooth ball of 12 ``cells``^2 triangles: a cube of ``cells``^2 squares a side, blown up."""
    t = np.tan(np.linspace(-np.pi / 4, np.pi / 4, cells + 1))
    u, v = (a.ravel() for a in np.meshgrid(t, t, indexing="ij"))
    one, square = np.ones_like(u), grid_faces(cells + 1, cells + 1)
    sides = [(one, u, v), (-one, v, u), (v, one, u), (u, -one, v), (u, v, one), (v, u, -one)]
    vertices = np.concatenate([np.stack(side, -1) for side in sides])
    faces = np.concatenate([square + i * len(u) for i in range(6)])
    # The six sides share their edges: weld them, or the ball would show seams.
    vertices, welded = np.unique(vertices.round(9), axis=0, return_inverse=True)
    vertices *= radius / np.linalg.norm(vertices, axis=1, keepdims=True)
    return mesh(name, vertices, welded.reshape(-1)[faces], surface, smooth=True)


def revolved(
    name: str, profile: Sequence[tuple[float, float]], surface: bpy.types.Material, segments: int = 48
) -> bpy.types.Mesh:
    """The surface that a ``profile`` of (radius, height) sweeps about the z axis, from bottom to top."""
    radius, height = np.array(profile, float).T[..., None]
    turn = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    vertices = np.stack(np.broadcast_arrays(radius * np.cos(turn), radius * np.sin(turn), height), -1)
    faces = grid_faces(len(profile), segments, around=True)
    return mesh(name, vertices.reshape(-1, 3), faces, surface, smooth=True)


def extruded(
    name: str,
    profile: Sequence[tuple[float, float]],
    width: float,
    surface: bpy.types.Material,
    smooth: bool = False,
) -> bpy.types.Mesh:
    """The sheet over a ``profile`` of (y, z), ``width`` wide along x."""
    y, z = np.array(profile, float).T
    x = np.array([[width / 2], [-width / 2]])
    vertices = np.stack(np.broadcast_arrays(x, y, z), -1).reshape(-1, 3)
    return mesh(name, vertices, grid_faces(2, len(y)), surface, smooth)


def backdrop(surface: bpy.types.Material, width: float = 60.0, depth: float = 9.0) -> bpy.types.Object:
    """A photographer's sheet: a floor that rises behind the scene in one curve."""
    turn = np.linspace(0, np.pi / 2, 24)
    curve = np.stack([depth + 4 * np.sin(turn), 4 - 4 * np.cos(turn)], -1)
    profile = np.concatenate([[(-30.0, 0.0)], curve, [(depth + 4, 30.0)]])
    return place("Backdrop", extruded("Backdrop", profile, width, surface, smooth=True))


def aimed(location: Sequence[float], target: Sequence[float]) -> Matrix:
    """The matrix of a camera or light at ``location`` whose -Z points to ``target``."""
    to_target = Vector(target) - Vector(location)
    return Matrix.Translation(location) @ to_target.to_track_quat("-Z", "Y").to_matrix().to_4x4()


def light(
    kind: str,
    location: Sequence[float],
    power: float,
    colour: Colour = (1.0, 1.0, 1.0),
    target: Sequence[float] | None = None,
    name: str | None = None,
    **properties: Any,
) -> bpy.types.Object:
    """A light of ``kind`` POINT, SPOT, AREA or SUN, ``power`` in W (W/m2); ``properties`` of its data."""
    data = bpy.data.lights.new(name or kind.title(), kind)
    data.energy, data.color = power, colour
    for key, value in properties.items():
        setattr(data, key, value)
    placed = place(data.name, data, location)
    if target is not None:
        placed.matrix_world = aimed(location, target)
    return placed


def camera(location: Sequence[float], target: Sequence[float], lens: float = 50.0) -> bpy.types.Object:
    """The scene's camera at ``location`` towards ``target``, of ``lens`` mm on a 36 mm sensor."""
    data = bpy.data.cameras.new("Camera")
    data.lens = lens
    placed = place("Camera", data)
    placed.matrix_world = aimed(location, target)
    bpy.context.scene.camera = placed
    return placed
