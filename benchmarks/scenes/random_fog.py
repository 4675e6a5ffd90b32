# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of fog, bodies and lights by chance, which either engine renders; bpy comes with `build`.

What Cycles treats otherwise than light would is left out: objects that only cameras or shadows do not see,
meshes with holes around fog, and a sky behind a world of fog, which now and then one of its samples sees.
"""

from __future__ import annotations

import math
from random import Random
from typing import Any

BESIDE, AHEAD = 3.0, (-2.0, 5.0)
"""Where bodies are, to either side and from the camera on."""


def build(seed: int) -> None:
    """Leave scene ``seed`` as bpy's open file, without size and engine of the picture."""
    from example_blends import studio

    random = Random(seed)
    sky, all_is_fog = _colour(random, 0.02, 0.3), random.random() < 0.4
    scene = studio.empty_stage((0, 0, 0) if all_is_fog or random.random() < 0.6 else sky)
    if all_is_fog:
        _fill(scene.world, random, 0.01, 0.12)
    ground = studio.box("Ground", (24, 24, 0.3), _surface("Ground", random, glows=0))
    studio.place("Ground", ground, (0, 4, -0.3))
    for number in range(random.randint(1, 4)):
        _add_body(f"Body {number}", random)
    for number in range(random.choice((0, 1, 1, 2, 3))):
        _add_fog(f"Fog {number}", random)
    for _ in range(random.randint(1, 3)):
        _add_light(random)
    eye = random.uniform(-2, 2), random.uniform(-9, -4), random.uniform(0.5, 4)
    target = random.uniform(-1, 1), 2, random.uniform(0.3, 1.5)
    studio.camera(eye, target, lens=random.uniform(20, 45))


def _colour(random: Random, least: float = 0.2, most: float = 1.0) -> tuple[float, ...]:
    return tuple(random.uniform(least, most) for _ in range(3))


def _turned(random: Random) -> tuple[float, ...]:
    return tuple(random.uniform(0, math.pi) for _ in range(3))


def _surface(name: str, random: Random, glows: float = 0.2, clear: float = 0.0) -> Any:
    """glows, clear : chances of an emission, and else of a transparent surface, which may hold fog."""
    from example_blends import studio

    if random.random() < glows:
        return studio.material(name, _colour(random), emission=random.uniform(1, 30))
    made = studio.material(name)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
    if random.random() < clear:
        shader = nodes.new("ShaderNodeBsdfTransparent")
        shader.inputs["Color"].default_value = (*_colour(random), 1)
        if random.random() < 0.5:
            _fill(made, random, 0.1, 2.0)
    else:
        shader = nodes.new("ShaderNodeBsdfPrincipled")
        shader.inputs["Base Color"].default_value = (*_colour(random, 0.05, 0.9), 1)
        shader.inputs["Roughness"].default_value = random.uniform(0.15, 1)
        shader.inputs["Metallic"].default_value = random.choice((0, 0, 1))
    links.new(shader.outputs[0], output.inputs["Surface"])
    return made


def _add_body(name: str, random: Random) -> None:
    from example_blends import studio

    surface = _surface(name, random, clear=0.2)
    kind = random.choice(("ball", "box", "sheet"))
    if kind == "ball":
        mesh = studio.ball(name, random.uniform(0.3, 1.2), surface, cells=random.choice((6, 16)))
    else:
        thickness = 0.01 if kind == "sheet" else random.uniform(0.3, 2)
        size = random.uniform(0.5, 2.5), thickness, random.uniform(0.5, 2.5)
        mesh = studio.box(name, size, surface)
    place = random.uniform(-BESIDE, BESIDE), random.uniform(*AHEAD), random.uniform(0, 2)
    scale = random.choice(((1, 1, 1), (-1, 1, 1), (0.6, 1.7, 1.1)))
    studio.place(name, mesh, place, rotation_euler=_turned(random), scale=scale)


def _add_fog(name: str, random: Random) -> None:
    from example_blends import studio

    made = studio.material(name)
    made.node_tree.nodes.clear()
    made.node_tree.nodes.new("ShaderNodeOutputMaterial")
    _fill(made, random, *random.choice(((0.02, 0.3), (0.3, 3.0))))
    if random.random() < 0.5:
        mesh = studio.ball(name, random.uniform(0.6, 2.5), made)
    else:
        mesh = studio.box(name, [random.uniform(1, 7) for _ in range(3)], made)
    place = random.uniform(-2, 2), random.uniform(-3, 4), random.uniform(0, 2)
    studio.place(name, mesh, place, rotation_euler=_turned(random))


def _fill(block: Any, random: Random, thin: float, dense: float) -> None:
    """Give a world or material a Volume Scatter, with an absorption beside it by chance."""
    nodes, links = block.node_tree.nodes, block.node_tree.links
    output = next(node for node in nodes if node.type.startswith("OUTPUT"))
    scatter = nodes.new("ShaderNodeVolumeScatter")
    scatter.inputs["Color"].default_value = (*_colour(random), 1)
    scatter.inputs["Density"].default_value = random.uniform(thin, dense)
    scatter.inputs["Anisotropy"].default_value = random.choice((0, random.uniform(-0.8, 0.8)))
    volume = scatter
    if random.random() < 0.3:
        absorption, volume = nodes.new("ShaderNodeVolumeAbsorption"), nodes.new("ShaderNodeAddShader")
        absorption.inputs["Color"].default_value = (*_colour(random), 1)
        absorption.inputs["Density"].default_value = random.uniform(0.02, 0.5)
        for number, shader in enumerate((scatter, absorption)):
            links.new(shader.outputs[0], volume.inputs[number])
    links.new(volume.outputs[0], output.inputs["Volume"])


def _add_light(random: Random) -> None:
    from example_blends import studio

    kind = random.choice(("POINT", "POINT", "SPOT", "SPOT", "AREA", "SUN"))
    radius = random.choice((0.0, 0.05, random.uniform(0.1, 0.5)))
    properties: dict[str, Any] = {
        "POINT": {"shadow_soft_size": radius, "use_soft_falloff": random.random() < 0.5},
        "SPOT": {
            "shadow_soft_size": radius,
            # Within a wide ball Cycles has fog lit by less than surfaces.
            "use_soft_falloff": radius > 0.05 or random.random() < 0.5,
            "spot_size": random.uniform(0.1, 2.6),
            "spot_blend": random.random(),
        },
        "AREA": {
            "shape": random.choice(("SQUARE", "RECTANGLE", "DISK", "ELLIPSE")),
            "size": random.uniform(0.1, 3),
            "size_y": random.uniform(0.1, 3),
            "spread": random.choice((math.pi, random.uniform(0.4, 3))),
        },
        "SUN": {"angle": random.choice((0.0, 0.0093, random.uniform(0.02, 0.6)))},
    }[kind]
    power = random.uniform(0.5, 5) if kind == "SUN" else random.uniform(50, 600)
    place = random.uniform(-4, 4), random.uniform(-4, 6), random.uniform(0.5, 5)
    target = random.uniform(-2, 2), random.uniform(-1, 4), random.uniform(0, 2)
    light = studio.light(kind, place, power, _colour(random), target, **properties)
    light.data.use_shadow = random.random() > 0.15
    light.visible_volume_scatter = random.random() > 0.1
