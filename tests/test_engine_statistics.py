# SPDX-License-Identifier: GPL-3.0-or-later
"""`Film.statistics`: what was built and what not, and where rays and seconds went."""

from __future__ import annotations

import dataclasses

import pytest
from scenes import area_light, floor, studio

from engine_core import Camera, Material, Scene, Settings, render
from engine_core.shading.closures import Glossy, Transparent


@pytest.fixture(scope="module")
def scene() -> Scene:
    return studio(48, 32, [area_light()])


def test_statistics_tell_what_was_built_and_what_not(scene):
    film = render(scene, Settings(samples=16, threads=2))
    told = film.statistics
    assert told["control variate"] == "built" and told["regions"] > 0 and told["nodes"] > 0
    assert told["samples"] == film.sample_count.sum() < told["camera rays"]
    parts = told["seconds building"] + told["seconds control variate"] + told["seconds sampling"]
    assert 0 < parts <= told["seconds total"] and told["seconds rendering"] <= told["seconds total"]
    told = render(scene, Settings(samples=4, integrator="sobol")).statistics
    assert told["control variate"].startswith("skipped") and "sobol" in told["control variate"]
    assert told["regions"] == told["nodes"] == told["seconds control variate"] == 0
    assert told["volume"].startswith("skipped")


def test_statistics_name_what_polynomials_do_not_follow(scene):
    blurred = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, aperture=0.01))
    many = dataclasses.replace(scene, lights=scene.lights * 9)
    for other, why in ((blurred, "depth of field"), (many, "more than 8 lights")):
        assert why in render(other, Settings(samples=4)).statistics["control variate"]
    glossy = dataclasses.replace(scene, materials=(Material(surface=Glossy(0.8, 0.2)),) * 2)
    told = render(glossy, Settings(samples=4, direct_sampling="bsdf")).statistics
    assert "BSDFs sampled alone" in told["control variate"]


def test_rays_are_counted_by_kind(scene):
    """Each kind is there where its cause is, and only there."""
    kinds = {
        "BSDF rays": Material(surface=Glossy(0.8, 0.2)),
        "transparent crossings": Material(surface=Transparent(0.5)),
    }
    settings = Settings(samples=4, integrator="sobol", threads=2)
    plain = render(scene, settings).statistics
    assert plain["camera rays"] == 4 * 48 * 32 and plain["shadow rays"] > 0
    for kind, material in kinds.items():
        assert plain[kind] == 0
        found = render(dataclasses.replace(scene, materials=(material, material)), settings).statistics
        assert {other for other in kinds if found[other]} == {kind}


def test_crossings_of_a_stack_of_sheets_are_one_for_each():
    """Straight down on three clear sheets over nothing."""
    camera = Camera.look_at((0.1, 0.2, 6), (0.1, 0.2, 0), 8, 8, up=(0, 1, 0))
    scene = Scene(camera, [floor(50, z) for z in (0, 1, 2)], (Material(surface=Transparent(1.0)),))
    told = render(scene, Settings(samples=4, integrator="sobol")).statistics
    assert told["transparent crossings"] == 3 * told["camera rays"]


def test_building_is_told_by_stages(scene):
    told = render(scene, Settings(samples=1)).statistics
    stages = [told[f"seconds {stage}"] for stage in ("triangles", "materials", "Embree", "emitters")]
    assert min(stages) >= 0 and sum(stages) <= told["seconds building"]
