# SPDX-License-Identifier: GPL-3.0-or-later
"""Example scenes for `engine_core` alone, from the same numbers as their .blend files.

They are made of `example_blends.model.Model`, not exported out of Blender, so that figures and growth
can be measured, and tested, where there is no Blender.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from functools import partial

import numpy as np

from engine_core import (
    AreaLight,
    Camera,
    Laser,
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    SpotLight,
    SunLight,
    Volume,
    World,
)
from engine_core.shading import closures, coordinates, ramps, textures
from engine_core.shading.values import compute
from example_blends.model import Fog, Lamp, Model, Ramp, Surface, Thing, aimed
from example_blends.shapes import corner_normals

FOGS = (
    "occluder", "pumpkin", "lighthouse", "laser", "fogged_interior", "stage", "fog_ball", "fog_area",
    "two_spots", "leaves", "fence",
)  # fmt: skip
MODELS = ("slats", "studio_spheres", "veach_plates", "violin", *FOGS)


def example(name: str, width: int, height: int) -> Scene:
    """One of `MODELS`, at this size."""
    return scene(importlib.import_module(f"example_blends.{name}").model(), width, height)


def scene(model: Model, width: int, height: int) -> Scene:
    """``model`` at this size."""
    made = {thing.surface.name: thing.surface for thing in model.things}
    fogs = [what for what in made.values() if isinstance(what, Fog)]
    surfaces = [what for what in made.values() if isinstance(what, Surface)]
    numbers = {what.name: number for kind in (fogs, surfaces) for number, what in enumerate(kind)}
    everywhere = [] if model.fog is None else [model.fog]
    view = model.view
    return Scene(
        Camera.look_at(view.position, view.target, width, height, view.field_of_view, clip_start=0.1),
        [_mesh(thing, numbers[thing.surface.name]) for thing in model.things],
        [_material(surface) for surface in surfaces],
        _lights(model.lamps),
        World(model.world, volume=len(fogs) if everywhere else -1),
        volumes=[_volume(fog) for fog in (*fogs, *everywhere)],
    )


def _volume(fog: Fog) -> Volume:
    return Volume(np.multiply(fog.colour, fog.density), fog.absorption, fog.anisotropy, name=fog.name)


def _mesh(thing: Thing, number: int) -> Mesh:
    """number : of its material, or of its fog."""
    vertices, faces = thing.shape
    fan = [(0, k, k + 1) for k in range(1, faces.shape[1] - 1)]
    triangles = np.concatenate([faces[:, corners] for corners in fan])
    fields = {}
    if thing.smooth:
        normals = corner_normals(vertices, faces)
        fields["normals"] = np.concatenate([normals[:, corners] for corners in fan])
    if thing.uv is not None:
        fields["attributes"] = {"uv:UVMap": np.concatenate([thing.uv[:, corners] for corners in fan])}
    if isinstance(thing.surface, Fog):
        fields |= {"volume": number, "surface": False}
    else:
        fields["materials"] = number
    return Mesh(vertices, triangles, name=thing.name, **fields)


def _material(surface: Surface) -> Material:
    inputs = dict(surface.inputs)
    if surface.shader == "Diffuse":
        return Material(inputs["color"], name=surface.name)
    if surface.shader == "Emission" and not isinstance(inputs["color"], Ramp):
        return Material(0.0, np.multiply(inputs["color"], inputs["strength"]), surface.name)
    for name, value in inputs.items():
        if isinstance(value, Ramp):
            inputs[name] = _ramp(value)
    return Material(name=surface.name, surface=getattr(closures, surface.shader)(**inputs))


def _ramp(ramp: Ramp) -> object:
    """UV map, gradient and a table, as the exporter makes them of a file's nodes."""
    places, colours = zip(*ramp.stops, strict=True)
    entries = np.linspace(0, 1, ramps.ENTRIES)
    table = np.array([np.interp(entries, places, channel) for channel in np.transpose(colours)], np.float32)
    along = compute(partial(textures.gradient, "LINEAR"), coordinates.uv("UVMap"))
    return compute(partial(ramps.look_up, table, True), along)


def _lights(lamps: Iterable[Lamp]) -> list[Light]:
    lights: list[Light] = []
    for lamp in lamps:
        matrix, properties = aimed(lamp.position, lamp.target), lamp.properties
        shared = {
            "power": np.multiply(lamp.colour, lamp.power),
            "visible_to_camera": lamp.seen,
            "name": lamp.name,
        }
        if lamp.kind == "SUN":
            lights.append(SunLight(direction=-matrix[:3, 2], angle=properties["angle"], **shared))
        elif lamp.kind == "LASER":
            beam = {"radius": properties["radius"], "length": properties["length"] or np.inf}
            lights.append(Laser(light_to_world=matrix, **beam, **shared))
        elif lamp.kind == "AREA":
            size = (properties["size"], properties.get("size_y", properties["size"]))
            ellipse = properties["shape"] in ("DISK", "ELLIPSE")
            lights.append(AreaLight(light_to_world=matrix, size=size, ellipse=ellipse, **shared))
        else:
            shared |= {
                "radius": properties["shadow_soft_size"],
                "sphere": not properties.get("use_soft_falloff", True),
            }
            if lamp.kind == "POINT":
                lights.append(PointLight(position=lamp.position, **shared))
            else:
                cone = {"angle": properties["spot_size"], "blend": properties["spot_blend"]}
                lights.append(SpotLight(light_to_world=matrix, **cone, **shared))
    return lights
