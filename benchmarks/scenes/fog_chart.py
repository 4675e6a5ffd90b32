# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog of every shape under every kind of light, in small: data; bpy comes with `build`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

LIGHTS = (
    "point", "spot", "sphere", "rectangle", "disk", "sun", "sun without size", "mesh", "world", "world image",
    "glow",
)  # fmt: skip
FOGS = ("world", "box", "ball", "overlapping", "camera inside")
ANISOTROPIES = (-0.8, 0.0, 0.8)
DEPTHS = (0.01, 0.1, 1.0, 10.0)

POSITION, TARGET = (-0.9, -0.7, 1.9), (0.1, 0.0, -0.1)
"""Of the lights that have one: outside of the meshes, and of the frame."""
VIEW = (0.5, -4.6, 1.5)
COLOUR = (0.9, 0.7, 0.5)
"""Of what fog scatters; it absorbs half of what that lacks of white."""


@dataclass(frozen=True)
class Cell:
    """One light in one fog, of scattering anisotropy ``g`` and an optical ``depth`` (green) across it."""

    light: str
    fog: str
    g: float
    depth: float

    def __str__(self) -> str:
        return f"{self.light}, {self.fog}"

    @property
    def extinction(self) -> float:
        """Per scene unit. Fog that the camera is in is as deep from there to the middle."""
        across = math.dist(VIEW, TARGET) if self.fog in ("world", "camera inside") else 2.0
        return self.depth / across


def cells() -> list[Cell]:
    """Every light in every fog, so that each also meets each anisotropy and depth, and these each other.

    Nothing comes through a world of fog from infinity: these four are left out. "glow" is the fog's own.
    """
    return [
        Cell(light, fog, ANISOTROPIES[(i + 2 * j) % 3], DEPTHS[(i + j) % 4])
        for i, light in enumerate(LIGHTS)
        for j, fog in enumerate(FOGS)
        if fog != "world" or not light.startswith(("sun", "world"))
    ]


def build(cell: Cell) -> None:
    """Leave ``cell`` as bpy's open file, without size and engine of the picture."""
    from example_blends import shapes, studio

    scene = studio.empty_stage()
    scene.world.cycles_visibility.camera = False  # what is seen through thin fog would hide its error
    sand, blue = studio.material("Sand", (0.75, 0.6, 0.45)), studio.material("Blue", (0.2, 0.3, 0.7))
    plate = np.array([(-0.8, -0.8, -0.6), (0.8, -0.8, -0.7), (0.8, 0.8, -0.7), (-0.8, 0.8, -0.6)])
    studio.place("Plate", studio.mesh("Plate", plate, np.array([(0, 1, 2, 3)]), sand))
    studio.place("Ball", studio.ball("Ball", 0.3, blue, cells=6), (0.3, -0.1, -0.2))
    _add_light(scene, cell.light)
    glow = 0.5 if cell.light == "glow" else 0.0
    if cell.fog == "world":
        _fill(scene.world, cell.extinction, cell.g, glow)
    else:
        fog = _medium("Fog", cell.extinction, cell.g, glow)
        shape = {
            "box": shapes.block((-1, -1, -1), (1, 1, 1)),
            "ball": shapes.ball(1.1),
            "overlapping": shapes.ball(1.1),
            "camera inside": shapes.block((-6, -6, -4), (5, 5, 4)),
        }[cell.fog]
        studio.place("Fog", studio.mesh("Fog", *shape, fog))
        if cell.fog == "overlapping":
            # It is in the ball for the most part, and holds a third of its own in full.
            other = _medium("Other", 2 * cell.extinction, -cell.g / 2)
            for name, block in (
                ("Other", shapes.block((-0.5, -0.6, -0.4), (1.2, 0.5, 0.3))),
                ("Inner", shapes.block((-0.3, -0.4, -0.3), (0.1, 0.2, 0.1))),
            ):
                studio.place(name, studio.mesh(name, *block, other))
    studio.camera(VIEW, TARGET, lens=58)


def _add_light(scene: Any, name: str) -> None:
    from example_blends import studio

    colour = (1.0, 0.9, 0.7)

    def light(kind: str, power: float, **properties: Any) -> None:
        studio.light(kind, POSITION, power, colour, TARGET, **properties)

    if name == "point":
        light("POINT", 60.0, shadow_soft_size=0.0)
    elif name == "spot":
        light("SPOT", 120.0, shadow_soft_size=0.0, spot_size=0.6, spot_blend=0.3)
    elif name == "sphere":
        light("POINT", 60.0, shadow_soft_size=0.3, use_soft_falloff=False)
    elif name == "rectangle":
        light("AREA", 40.0, shape="RECTANGLE", size=1.0, size_y=0.5)
    elif name == "disk":
        light("AREA", 40.0, shape="DISK", size=0.9)
    elif name == "sun":
        light("SUN", 2.0, angle=math.radians(15))
    elif name == "sun without size":
        light("SUN", 2.0, angle=0.0)
    elif name == "mesh":
        glow = studio.material("Glow", colour, emission=9.0)
        studio.place("Light", studio.ball("Light", 0.3, glow, cells=2), POSITION)
    elif name in ("world", "world image"):
        _set_world(scene.world, image=name == "world image")


def _set_world(world: Any, image: bool) -> None:
    import bpy

    nodes = world.node_tree.nodes
    background = nodes["Background"]
    if not image:
        background.inputs["Color"].default_value = (0.7, 0.8, 1.0, 1.0)
        return
    y, x = np.indices((16, 32))
    bright = 0.2 + 20 * np.exp(-((x - 9.5) ** 2 + (y - 12) ** 2) / 4) + 3 * (y > 12)
    pixels = np.stack([bright, 0.8 * bright, 0.3 + 0.6 * bright, np.ones_like(bright)], axis=-1)
    sky = bpy.data.images.new("Sky", 32, 16, float_buffer=True)
    sky.pixels.foreach_set(pixels.astype(np.float32).ravel())
    sky.pack()
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = sky
    world.node_tree.links.new(texture.outputs[0], background.inputs["Color"])


def _medium(name: str, extinction: float, g: float, glow: float = 0.0) -> Any:
    import bpy

    made = bpy.data.materials.new(name)
    if made.node_tree is None:
        made.use_nodes = True
    made.node_tree.nodes.clear()
    made.node_tree.nodes.new("ShaderNodeOutputMaterial")
    _fill(made, extinction, g, glow)
    return made


def _fill(block: Any, extinction: float, g: float, glow: float) -> None:
    """Link fog of `COLOUR`, which emits ``glow`` per unit, to the output of a material or world."""
    tree = block.node_tree
    scatter, absorb, both = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("VolumeScatter", "VolumeAbsorption", "AddShader")
    )
    for node in (scatter, absorb):
        node.inputs["Color"].default_value = (*COLOUR, 1.0)
        node.inputs["Density"].default_value = extinction if node is scatter else extinction / 2
        tree.links.new(node.outputs[0], both.inputs[0 if node is scatter else 1])
    scatter.inputs["Anisotropy"].default_value = g
    if glow:
        emission, sum_ = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("Emission", "AddShader"))
        emission.inputs["Color"].default_value = (1.0, 0.8, 0.5, 1.0)
        emission.inputs["Strength"].default_value = glow
        tree.links.new(both.outputs[0], sum_.inputs[0])
        tree.links.new(emission.outputs[0], sum_.inputs[1])
        both = sum_
    output = next(node for node in tree.nodes if node.type.startswith("OUTPUT"))
    tree.links.new(both.outputs[0], output.inputs["Volume"])
    block.cycles.volume_sampling = "MULTIPLE_IMPORTANCE"
