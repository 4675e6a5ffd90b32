# SPDX-License-Identifier: GPL-3.0-or-later
"""Every kind of light alone over a small scene with two occluders; data only, bpy comes with `build`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

POSITION, TARGET = (-0.7, -0.5, 2.0), (0.1, 0.1, 0.0)


@dataclass(frozen=True)
class Case:
    """One light.

    kind : POINT, SPOT, AREA, SUN, or MESH (an emitting icosphere), GLOSSY MESH (a box), or WORLD.
    power : W; W/m2 for a sun, W/(sr m2) for a mesh and the world.
    properties : of Blender's light. scale : of its object. since : the first Blender that has all this.
    """

    name: str
    kind: str
    power: float
    properties: Mapping[str, Any] = field(default_factory=dict)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    position: tuple[float, float, float] = POSITION
    since: tuple[int, int] = (4, 2)


def _point(name: str, radius: float, soft: bool = True, **more: Any) -> Case:
    properties = {"shadow_soft_size": radius, "use_soft_falloff": soft, **more.pop("properties", {})}
    return Case(f"point, {name}", "POINT", more.pop("power", 60.0), properties, **more)


def _spot(name: str, radius: float, blend: float, soft: bool = True, **more: Any) -> Case:
    properties = {
        "shadow_soft_size": radius, "use_soft_falloff": soft, "spot_blend": blend, "spot_size": 0.9,
        **more.pop("properties", {}),
    }  # fmt: skip
    return Case(f"spot, {name}", "SPOT", more.pop("power", 90.0), properties, **more)


def _area(name: str, shape: str, size: float, size_y: float, **more: Any) -> Case:
    properties = {"shape": shape, "size": size, "size_y": size_y, **more.pop("properties", {})}
    return Case(f"area, {name}", "AREA", more.pop("power", 40.0), properties, **more)


def _sun(name: str, degrees: float, **more: Any) -> Case:
    properties = {"angle": math.radians(degrees), **more.pop("properties", {})}
    return Case(f"sun, {name}", "SUN", more.pop("power", 1.5), properties, **more)


BARE = {"properties": {"normalize": False}, "since": (4, 5)}
"""What makes a light's power that of a unit area."""

CASES = (
    _point("radius 0", 0.0),
    _point("radius 0, casts no shadow", 0.0, properties={"use_shadow": False}),
    _point("radius 0, exposure 1", 0.0, power=30, properties={"exposure": 1.0}, since=(4, 5)),
    _point(
        "radius 0, 3000 K", 0.0, properties={"use_temperature": True, "temperature": 3000.0}, since=(4, 5)
    ),
    _point("radius 0, normalize off", 0.0, **BARE),
    _point("sphere, radius 0.25", 0.25, soft=False),
    _point("sphere, radius 1", 1.0, soft=False),
    _point("sphere, radius 1.9 of 2", 1.9, soft=False),
    _point("sphere, radius 0.5, normalize off", 0.5, soft=False, **BARE),
    _point("sphere in the frame", 0.15, soft=False, position=(-0.7, 0.5, 1.0), power=25),
    _point("soft falloff, radius 0.25", 0.25),
    _point("soft falloff, radius 1", 1.0),
    _point("soft falloff, radius 1.9 of 2", 1.9),
    _point("soft falloff, radius 0.5, normalize off", 0.5, **BARE),
    _point("soft falloff, in the frame", 0.15, position=(-0.7, 0.5, 1.0), power=25),
    _spot("radius 0, blend 0", 0.0, 0.0),
    _spot("radius 0, blend 0.5", 0.0, 0.5),
    _spot("radius 0, blend 1", 0.0, 1.0),
    _spot("sphere, radius 0.2, blend 0.3", 0.2, 0.3, soft=False),
    _spot("sphere, radius 0.8, blend 0.3", 0.8, 0.3, soft=False),
    _spot("soft falloff, radius 0.2, blend 0.3", 0.2, 0.3),
    _spot("soft falloff, radius 0.8, blend 0.3", 0.8, 0.3),
    _spot("soft falloff, radius 0.2, normalize off", 0.2, 0.3, **BARE),
    _spot("scaled (1.6, 0.7, 1)", 0.1, 0.3, scale=(1.6, 0.7, 1.0)),
    _spot("sphere, scaled (0.6, 0.6, 1.3)", 0.2, 0.3, soft=False, scale=(0.6, 0.6, 1.3)),
    _area("square", "SQUARE", 1.0, 1.0),
    _area("rectangle", "RECTANGLE", 1.6, 0.4),
    _area("disk", "DISK", 1.0, 1.0),
    _area("ellipse", "ELLIPSE", 1.6, 0.6),
    _area("square, scaled (1.5, 0.5, 1)", "SQUARE", 1.0, 1.0, scale=(1.5, 0.5, 1.0)),
    _area("disk, mirrored", "DISK", 0.8, 0.8, scale=(-1.0, 1.0, 1.0)),
    _area("square, normalize off", "SQUARE", 0.7, 0.7, power=60.0, **BARE),
    _area("ellipse, normalize off", "ELLIPSE", 0.9, 0.5, power=60.0, **BARE),
    _area("square, spread 90 degrees", "SQUARE", 1.0, 1.0, properties={"spread": math.pi / 2}),
    _area("disk, spread 30 degrees", "DISK", 1.0, 1.0, properties={"spread": math.pi / 6}),
    _area("in the frame", "SQUARE", 0.5, 0.5, position=(-0.6, 0.9, 1.0), power=15),
    _sun("angle 0", 0.0),
    _sun("angle 5 degrees", 5.0),
    _sun("angle 60 degrees", 60.0),
    _sun("angle 30 degrees, normalize off", 30.0, **BARE),
    Case("mesh with emission", "MESH", 9.0),
    Case("glossy mesh with emission, in the frame", "GLOSSY MESH", 5.0, position=(-0.6, 0.5, 0.9)),
    Case("world", "WORLD", 0.5),
)


def build(case: Case) -> None:
    """Leave ``case`` as bpy's open file, without size and engine of the picture."""
    import bpy

    from example_blends import studio

    world = (case.power * 0.8, case.power * 0.9, case.power) if case.kind == "WORLD" else (0.0, 0.0, 0.0)
    studio.empty_stage(world)
    sand, red, blue = (
        studio.material(name, colour)
        for name, colour in (
            ("Sand", (0.75, 0.6, 0.45)),
            ("Red", (0.7, 0.25, 0.2)),
            ("Blue", (0.2, 0.3, 0.7)),
        )
    )
    studio.place("Floor", studio.extruded("Floor", [(-4, 0), (2.5, 0), (2.5, 4)], 8.0, sand))
    box = studio.box("Box", (0.45, 0.45, 0.8), red)
    studio.place("Box", box, (0.45, 0.35, 0), rotation_euler=(0, 0, 0.5))
    studio.place("Ball", studio.ball("Ball", 0.3, blue, cells=8), (-0.45, 0.1, 0.3))
    if case.kind == "MESH":
        glow = studio.material("Glow", (1.0, 0.8, 0.6), emission=case.power)
        studio.place("Light", studio.ball("Light", 0.3, glow, cells=2), case.position)
    elif case.kind == "GLOSSY MESH":
        box = studio.box("Light", (0.15, 0.15, 0.6), _glossy(case.power))
        studio.place("Light", box, case.position, rotation_euler=(0.3, 0.8, 0))
    elif case.kind != "WORLD":
        light = studio.light(case.kind, case.position, case.power, (1.0, 0.9, 0.7), TARGET, **case.properties)
        light.matrix_world = light.matrix_world @ _scaling(case.scale)
        bpy.context.view_layer.update()
    studio.camera((0.0, -4.6, 2.8), (0.05, 0.15, 0.3), lens=80)


def _glossy(emission: float) -> Any:
    """Principled, as whoever sets an emission strength has it."""
    from example_blends import studio

    made = studio.material("Glow")
    nodes = made.node_tree.nodes
    shader = nodes.new("ShaderNodeBsdfPrincipled")
    shader.inputs["Base Color"].default_value = (0.4, 0.3, 0.2, 1.0)
    shader.inputs["Roughness"].default_value = 0.4
    shader.inputs["Emission Color"].default_value = (1.0, 0.8, 0.6, 1.0)
    shader.inputs["Emission Strength"].default_value = emission
    (output,) = (node for node in nodes if node.type == "OUTPUT_MATERIAL")
    made.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return made


def _scaling(scale: tuple[float, float, float]) -> Any:
    from mathutils import Matrix

    return Matrix.Diagonal((*scale, 1.0))
