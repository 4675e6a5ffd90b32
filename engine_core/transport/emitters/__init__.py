# SPDX-License-Identifier: GPL-3.0-or-later
"""Light sources as functions of a point in primary space: every map beside its measure and its pdf.

Here, and nowhere else, watts become radiance, as Cycles has it:

    point, spot   L = P / (4 pi^2 r^2), or intensity I = P / (4 pi) for r = 0
    area          L = P / (pi A)
    sun           L = E / (pi sin^2 a), a the half angle, or irradiance E for a = 0

and without ``normalize`` the same for unit size: L = P / pi (I = P / pi, L = E).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...geometry.frame import Frame
from ...geometry.triangles import Triangles
from ...scene import AreaLight, Light, Material, PointLight, SpotLight, SunLight, World
from ...shading.abilities import abilities
from .area import AreaEmitters
from .base import Emitters, LightHits, Sample
from .mesh import MeshEmitters
from .mesh_pieces import emissive_pieces
from .points import DiskEmitters, PointEmitters, SphereEmitters
from .sun import SunEmitters
from .world import ImageWorldEmitter, WorldEmitter

__all__ = [
    "AreaEmitters",
    "DiskEmitters",
    "Emitters",
    "ImageWorldEmitter",
    "LightHits",
    "MeshEmitters",
    "PointEmitters",
    "Sample",
    "SphereEmitters",
    "SunEmitters",
    "WorldEmitter",
    "emitter_groups",
]


def _problem(light: Light) -> str | None:
    """Why a light can't be used, or None."""
    if (light.power < 0).any():
        return "has negative power; give it a positive one"
    if not (light.power > 0).any():
        return "has no power"
    if isinstance(light, SpotLight):
        matrix = light.light_to_world[:3, :3]
        largest = np.abs(matrix).max()
        if not largest > 0 or abs(np.linalg.det(matrix / largest)) < 1e-12:
            return "has a scale of 0 on one of its axes"
        if light.angle <= 0:
            return "has a cone of angle 0"
    if isinstance(light, AreaLight):
        axes = light.light_to_world[:3, :3] * np.append(light.size, 1.0)
        if not np.linalg.norm(axes, axis=0).min() > 0:
            return "has no area; make it larger, or use a point light"
    return None


def emitter_groups(
    lights: Sequence[Light],
    world: World,
    materials: Sequence[Material],
    triangles: Triangles,
    frame: Frame,
    transmits: np.ndarray | None = None,
) -> tuple[list[Emitters], list[str]]:
    """All that lights the scene, by kind, and messages about lights that are left out.

    transmits : (number of materials,) bool, which let light straight through; None for none.
    """
    messages, usable = [], []
    for light in lights:
        problem = _problem(light)
        if problem:
            messages.append(f'Light "{light.name}" {problem}; it is left out.')
        else:
            usable.append(light)
    points = [light for light in usable if isinstance(light, PointLight | SpotLight)]
    kinds: list[tuple[type, list]] = [
        (PointEmitters, [p for p in points if p.radius == 0]),
        (DiskEmitters, [p for p in points if p.radius > 0 and not p.sphere]),
        (SphereEmitters, [p for p in points if p.radius > 0 and p.sphere]),
        (AreaEmitters, [light for light in usable if isinstance(light, AreaLight)]),
    ]
    groups: list[Emitters] = [kind(members, frame) for kind, members in kinds if members]
    suns = [light for light in usable if isinstance(light, SunLight)]
    if suns:
        groups.append(SunEmitters(suns))
    if (world.radiance < 0).any():
        messages.append(f'World "{world.name}" has a negative colour; it lights nothing.')
    elif (world.radiance > 0).any():
        groups.append(WorldEmitter(world))
    if world.image is not None and (world.image > 0).any():
        used = np.unique(triangles.material)
        bent = any(abilities(materials[number].surface).bends for number in used)
        groups.append(ImageWorldEmitter(world, bent))
    pieces = emissive_pieces(materials, triangles, transmits)
    if pieces is not None:
        of_light = pieces.row[pieces.first[:-1]]
        radiance = [materials[number].emission for number in triangles.material[of_light]]
        number, linking = triangles.linked(of_light)
        linking = [linking[k] for k in number]
        groups.append(MeshEmitters(np.maximum(radiance, 0), pieces, linking, triangles.offset))
    return groups, messages
