# SPDX-License-Identifier: GPL-3.0-or-later
"""What every example is put together from: stage, materials, shapes, lights and a camera, through bpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from . import shapes
from .model import Fog, Lamp, Model, Ramp, Surface, Thing
from .model import aimed as aimed_matrix

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


def box(name: str, size: Sequence[float], surface: bpy.types.Material) -> bpy.types.Mesh:
    """`shapes.box` in one material; so are those below."""
    return mesh(name, *shapes.box(size), surface)


def ball(name: str, radius: float, surface: bpy.types.Material, cells: int = 12) -> bpy.types.Mesh:
    return mesh(name, *shapes.ball(radius, cells=cells), surface, smooth=True)


def revolved(
    name: str, profile: Sequence[tuple[float, float]], surface: bpy.types.Material, segments: int = 48
) -> bpy.types.Mesh:
    return mesh(name, *shapes.revolved(profile, segments), surface, smooth=True)


def extruded(
    name: str,
    profile: Sequence[tuple[float, float]],
    width: float,
    surface: bpy.types.Material,
    smooth: bool = False,
) -> bpy.types.Mesh:
    return mesh(name, *shapes.extruded(profile, width), surface, smooth)


def backdrop(surface: bpy.types.Material, width: float = 60.0, depth: float = 9.0) -> bpy.types.Object:
    return place("Backdrop", mesh("Backdrop", *shapes.backdrop(width, depth), surface, smooth=True))


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


# Models


NODES = {
    "Diffuse": "ShaderNodeBsdfDiffuse",
    "Glossy": "ShaderNodeBsdfAnisotropic",
    "Principled": "ShaderNodeBsdfPrincipled",
    "Emission": "ShaderNodeEmission",
}
"""The node of each of a model's shaders."""


def build_model(model: Model) -> None:
    """Leave a `model.Model` as bpy's open file."""
    scene = empty_stage(model.world, model.size)
    if model.fog is not None:
        output = next(node for node in scene.world.node_tree.nodes if node.type == "OUTPUT_WORLD")
        _fill(scene.world.node_tree, model.fog, output)
    made: dict[str, bpy.types.Material] = {}
    for thing in model.things:
        surface = thing.surface
        if surface.name not in made:
            made[surface.name] = _foggy(surface) if isinstance(surface, Fog) else _shaded(surface)
        if thing.lathe is not None:
            _turned(thing, made[surface.name])
            continue
        data = mesh(thing.name, *thing.shape, made[surface.name], thing.smooth)
        if thing.uv is not None:
            data.uv_layers.new(name="UVMap").data.foreach_set("uv", thing.uv.astype(np.float32).ravel())
        placed = place(thing.name, data)
        if isinstance(surface, Fog):
            placed.display_type = "WIRE"  # or it would hide in the viewport what is in it
    for lamp in model.lamps:
        placed = _laser(lamp) if lamp.kind == "LASER" else _light(lamp)
        placed.matrix_world = Matrix(aimed_matrix(lamp.position, lamp.target))
        placed.visible_camera = lamp.seen
    camera(model.view.position, model.view.target, model.view.lens)


def _turned(thing: Thing, surface: bpy.types.Material) -> None:
    """Blender turns the profile when it opens the file: that stays small."""
    lathe, data = thing.lathe, bpy.data.meshes.new(thing.name)
    points = [(radius, 0.0, height) for radius, height in lathe.profile]
    data.from_pydata(points, [(k, k + 1) for k in range(len(points) - 1)], [])
    data.materials.append(surface)
    turn = place(thing.name, data, lathe.position).modifiers.new("Lathe", "SCREW")
    turn.steps = turn.render_steps = lathe.segments
    turn.use_merge_vertices = turn.use_smooth_shade = True
    turn.use_normal_flip, turn.merge_threshold = True, 1e-6


def _light(lamp: Lamp) -> bpy.types.Object:
    return light(lamp.kind, lamp.position, lamp.power, lamp.colour, name=lamp.name, **lamp.properties)


def _laser(lamp: Lamp) -> bpy.types.Object:
    """A narrow spot light to all engines but CV Render.

    Where CV Render is not installed its properties are put where Blender up to 4.5 keeps them, and where
    later ones look when they open such a file.
    """
    placed = light("SPOT", lamp.position, lamp.power, lamp.colour, name=lamp.name, spot_size=np.radians(2))
    data, radius, length = placed.data, lamp.properties["radius"], lamp.properties["length"]
    data.shadow_soft_size = radius
    if hasattr(data, "cv_render"):
        data.cv_render.is_laser, data.cv_render.beam_radius, data.cv_render.length = True, radius, length
    else:
        data["cv_render"] = {"is_laser": True, "beam_radius": float(radius), "length": float(length)}
    return placed


def _foggy(fog: Fog) -> bpy.types.Material:
    made = bpy.data.materials.new(fog.name)
    _with_nodes(made)
    made.node_tree.nodes.clear()
    output = made.node_tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (220, 0)
    _fill(made.node_tree, fog, output)
    return made


def _fill(tree: bpy.types.NodeTree, fog: Fog, output: bpy.types.Node) -> None:
    """Link the nodes of ``fog`` to the volume of an ``output``."""
    scatter = tree.nodes.new("ShaderNodeVolumeScatter")
    scatter.location = (-240, -160)
    scatter.inputs["Color"].default_value = (*fog.colour, 1.0)
    scatter.inputs["Density"].default_value = fog.density
    scatter.inputs["Anisotropy"].default_value = fog.anisotropy
    volume = scatter.outputs[0]
    if any(fog.absorption):
        # The node absorbs density times what its colour lacks of white.
        absorb, both = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("VolumeAbsorption", "AddShader"))
        absorb.location, both.location = (-240, -340), (0, -200)
        density = max(fog.absorption)
        absorb.inputs["Color"].default_value = (*(1 - np.array(fog.absorption) / density), 1.0)
        absorb.inputs["Density"].default_value = density
        tree.links.new(volume, both.inputs[0])
        tree.links.new(absorb.outputs[0], both.inputs[1])
        volume = both.outputs[0]
    tree.links.new(volume, output.inputs["Volume"])


def _shaded(surface: Surface) -> bpy.types.Material:
    made = bpy.data.materials.new(surface.name)
    _with_nodes(made)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    shader = nodes.new(NODES[surface.shader])
    for name, value in surface.inputs.items():
        socket = shader.inputs[name.replace("_", " ").title().replace("Ior", "IOR")]
        if isinstance(value, Ramp):
            links.new(_ramp(made.node_tree, value), socket)
        else:
            socket.default_value = (*value, 1.0) if socket.type == "RGBA" else value
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (320, 0)
    links.new(shader.outputs[0], output.inputs["Surface"])
    colour = surface.inputs.get("color", surface.inputs.get("base_color"))
    if not isinstance(colour, Ramp):
        made.diffuse_color = (*colour, 1.0)
    return made


def _ramp(tree: bpy.types.NodeTree, ramp: Ramp) -> bpy.types.NodeSocket:
    """UV map, Gradient Texture and Color Ramp, one after the other."""
    uv, gradient, colours = (
        tree.nodes.new(kind) for kind in ("ShaderNodeUVMap", "ShaderNodeTexGradient", "ShaderNodeValToRGB")
    )
    for x, node in zip((-760, -560, -340), (uv, gradient, colours), strict=True):
        node.location = (x, 0)
    tree.links.new(uv.outputs["UV"], gradient.inputs["Vector"])
    tree.links.new(gradient.outputs["Fac"], colours.inputs["Fac"])
    elements = colours.color_ramp.elements
    while len(elements) < len(ramp.stops):
        elements.new(0.5)
    for element, (place_, colour) in zip(elements, ramp.stops, strict=True):
        element.position, element.color = place_, (*colour, 1.0)
    return colours.outputs["Color"]
