# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures lit by dozens of lights of all kinds are the sum of those lit by each."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scenes import assert_mean, blocks, mixed_lights, pictures, sphere, studio

from engine_core import Material, PointLight
from engine_core.transport.light_choice import WEIGHED

SEEDS = 24


def test_picture_of_many_lights_is_the_sum_of_all():
    """Points, spheres, disks, spots, areas, suns and a lamp of many triangles."""
    lights = mixed_lights(WEIGHED + 10)
    dark = studio(32, 32)
    glowing = Material(0.0, (3.0, 2.0, 1.0))
    lamp = sphere((0.4, -1.5, 1.0), 0.2, segments=16, materials=len(dark.materials))
    lit = dataclasses.replace(
        dark, lights=lights, meshes=(*dark.meshes, lamp), materials=(*dark.materials, glowing)
    )
    black = dataclasses.replace(lit, materials=(*dark.materials, Material(0.0)))
    fields = {"integrator": "sobol", "light_samples": 1}
    alone = [dataclasses.replace(black, lights=[light]) for light in lights]
    alone.append(dataclasses.replace(lit, lights=()))
    wanted = sum(blocks(pictures(scene, 2, samples=64, **fields)) for scene in alone).mean(axis=0)
    assert_mean(blocks(pictures(lit, SEEDS, samples=4, **fields)), wanted, rounding=2e-3)


@pytest.mark.parametrize("integrator", ["sobol", "monte_carlo"])
def test_a_strong_light_among_weak_ones_does_not_drown_them(integrator: str):
    random = np.random.default_rng(5)
    weak = [PointLight(0.5 * random.random(3), position=random.uniform((-3, -3, 2), 3)) for _ in range(99)]
    strong = PointLight(500.0, position=(-3, -2, 4))
    fields = {"integrator": integrator, "light_samples": 1}
    scenes = [studio(16, 16, lights) for lights in ([strong], weak, [strong, *weak])]
    parts = [blocks(pictures(scene, SEEDS, samples=16, **fields)) for scene in scenes]
    # By the seeds in pairs, which are independent of each other.
    assert_mean(parts[2] - parts[0] - parts[1], 0.0, rounding=0.0)
