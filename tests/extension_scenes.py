# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes made in Blender for the tests of the extension; bpy must have been opened (fixture ``cv``)."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np


def new_scene(width: int = 32, height: int = 24, samples: int = 4) -> Any:
    """An empty file whose scene renders with CV Render into EXR, a black world around."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.engine = "CV_RENDER"
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.cv_render.samples = samples
    scene.world = bpy.data.worlds.new("World")
    tree(scene.world)
    set_world(scene, (0, 0, 0))
    return scene


def tree(datablock: Any) -> Any:
    """The nodes of a material, light or world, switched on where that is a choice."""
    import bpy

    if bpy.app.version < (5, 0, 0):
        datablock.use_nodes = True
    return datablock.node_tree


def set_world(scene: Any, colour: Sequence[float], strength: float = 1.0) -> None:
    background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (*colour, 1)
    background.inputs["Strength"].default_value = strength


def add(scene: Any, name: str, data: Any, location: Any = (0, 0, 0), rotation: Any = (0, 0, 0)) -> Any:
    """A new object of ``data`` in the scene."""
    import bpy

    obj = bpy.data.objects.new(name, data)
    scene.collection.objects.link(obj)
    obj.location, obj.rotation_euler = location, rotation
    return obj


def add_camera(scene: Any, location: Any = (0, -6, 3), rotation: Any = (1.13, 0, 0), **fields: Any) -> Any:
    import bpy

    camera = bpy.data.cameras.new("Camera")
    for name, value in fields.items():
        setattr(camera, name, value)
    scene.camera = add(scene, "Camera", camera, location, rotation)
    return scene.camera


def add_light(scene: Any, kind: str, energy: float = 300.0, location: Any = (2, -3, 4), **fields: Any) -> Any:
    import bpy

    light = bpy.data.lights.new(kind.title(), kind)
    light.energy = energy
    for name, value in fields.items():
        setattr(light, name, value)
    obj = add(scene, kind.title(), light, location, (0.6, 0.4, 0))
    obj.visible_camera = False
    return obj


def add_mesh(scene: Any, name: str, vertices: Any, faces: Any, material: Any = None, **placed: Any) -> Any:
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    if material is not None:
        mesh.materials.append(material)
    return add(scene, name, mesh, **placed)


def add_floor(scene: Any, half: float = 5.0, z: float = -1.0, material: Any = None) -> Any:
    corners = [(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)]
    return add_mesh(scene, "Floor", corners, [(0, 1, 2, 3)], material or diffuse("Floor", (0.8, 0.6, 0.4)))


def add_cube(scene: Any, size: float = 1.0, material: Any = None, **placed: Any) -> Any:
    vertices = [tuple(size / 2 * v for v in corner) for corner in itertools.product((-1, 1), repeat=3)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return add_mesh(scene, "Cube", vertices, faces, material or diffuse("Cube", (0.5, 0.5, 0.5)), **placed)


def add_monkey(scene: Any, smooth: bool = True, material: Any = None) -> Any:
    """Suzanne: quads that are not planar, triangles, and holes."""
    import bmesh
    import bpy

    mesh = bpy.data.meshes.new("Monkey")
    shape = bmesh.new()
    bmesh.ops.create_monkey(shape)
    shape.to_mesh(mesh)
    shape.free()
    mesh.polygons.foreach_set("use_smooth", [smooth] * len(mesh.polygons))
    mesh.materials.append(material or diffuse("Monkey", (0.7, 0.8, 0.3)))
    return add(scene, "Monkey", mesh)


def surface(name: str, kind: str, **inputs: Any) -> Any:
    """A material of one node ``kind`` and its inputs' values."""
    import bpy

    material = bpy.data.materials.new(name)
    nodes = tree(material).nodes
    nodes.clear()
    output, shader = nodes.new("ShaderNodeOutputMaterial"), nodes.new(kind)
    for socket, value in inputs.items():
        shader.inputs[socket].default_value = value
    material.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def diffuse(name: str, colour: Sequence[float]) -> Any:
    return surface(name, "ShaderNodeBsdfDiffuse", Color=(*colour, 1))


def emission(name: str, colour: Sequence[float], strength: float = 1.0) -> Any:
    return surface(name, "ShaderNodeEmission", Color=(*colour, 1), Strength=strength)


def furnished(width: int = 32, height: int = 24, samples: int = 4) -> Any:
    """A cube on a floor under an area light."""
    scene = new_scene(width, height, samples)
    add_camera(scene)
    add_floor(scene)
    add_cube(scene, 1.4, diffuse("Cube", (0.4, 0.6, 0.9)), rotation=(0.2, 0.3, 0.5))
    add_light(scene, "AREA", size=0.5)
    return scene


def like_cycles(scene: Any, samples: int) -> None:
    """Cycles without bounces, and without its cleverness that CV Render does not share."""
    cycles = scene.cycles
    cycles.samples = scene.cv_render.samples = samples
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = 0
    cycles.transmission_bounces = cycles.volume_bounces = 0
    cycles.pixel_filter_type = "BOX"
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_light_tree = False
    cycles.light_sampling_threshold = cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0


def render(scene: Any, folder: Path, engine: str = "CV_RENDER", seed: int = 0) -> np.ndarray:
    """(H, W, 4) float32 picture, row 0 at the bottom."""
    import bpy

    scene.render.engine = engine
    scene.cv_render.seed = scene.cycles.seed = seed
    scene.render.filepath = str(folder / "picture.exr")
    bpy.ops.render.render(write_still=True)
    return load(Path(scene.render.filepath))


def load(path: Path) -> np.ndarray:
    """(H, W, 4) float32 of an EXR file, row 0 at the bottom."""
    import bpy

    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)


def export(cv: ModuleType) -> tuple[Any, list[str]]:
    """(`engine_core.Scene`, messages) of the scene as it stands, without rendering it."""
    import bpy

    messages = cv.cv_render.export.Messages()
    engine = SimpleNamespace(
        camera_override=None,
        camera_model_matrix=lambda camera: camera.matrix_world,
        camera_shift_x=lambda camera: camera.data.shift_x,
    )
    scene = cv.cv_render.export.export_scene(engine, bpy.context.evaluated_depsgraph_get(), messages)
    return scene, list(messages)


def degrees(*angles: float) -> tuple[float, ...]:
    return tuple(math.radians(angle) for angle in angles)
