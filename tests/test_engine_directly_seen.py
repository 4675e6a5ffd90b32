# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps as camera rays see them: where they are, and where they are thinner than a pixel."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scenes import studio

from engine_core import PointLight, Settings, SunLight, World, render
from engine_core.directly_seen import DirectlySeen
from engine_core.transport.camera_hits import Pixels

SIZE, RADIUS, RADIANCE = 8, 0.25, 100.0


class Dot:
    """A lamp within one pixel: neither its corners nor the pixels around see it."""

    def first(self, pixels, u):
        x, y = pixels.x[:, None] + u[0] - 4.5, pixels.y[:, None] + u[1] - 3.5
        seen = RADIANCE * (np.hypot(x, y) < RADIUS)
        return SimpleNamespace(values=np.tile(seen.ravel(), (4, 1)))


def test_a_lamp_within_a_pixel_is_seen_by_every_seed():
    def pixels_at(index):
        x, y = index.astype(np.int32)
        return Pixels(x, y, np.zeros(len(x), np.int32))

    about = np.zeros((SIZE, SIZE), bool)
    about[4, 3] = True
    for seed in range(20):
        seen = DirectlySeen(Dot(), about, pixels_at, seed, 1 << 12, lambda f, a: [*map(f, a)], 32, about.size)
        mean = RADIANCE * np.pi * RADIUS**2
        # Of a thousand points of a net.
        assert np.allclose(seen.mean[:, 4, 3], mean, rtol=0.1)
        assert seen.mean.sum() == seen.mean[:, 4, 3].sum()


@pytest.mark.parametrize(
    "beside",
    [(), (SunLight(1e-9, direction=(0, 1, -1), angle=1.0, visible_to_camera=True),)],
    ids=["alone", "a sun"],
)
def test_lamps_are_seen_where_they_are(beside):
    places, radius = [(-2.2, 0, 2.0), (2.4, 1.0, 1.6)], 0.35
    lamps = tuple(PointLight(100.0, position=p, radius=radius, visible_to_camera=True) for p in places)
    scene = studio(96, 64, (*lamps, *beside), world=World(0.0))
    radiance = 100.0 / (4 * np.pi**2 * radius**2)
    seen, sampled = (
        render(scene, Settings(integrator=name, samples=n)).combined[..., :3].mean(axis=2)
        for name, n in (("control_variates", 4), ("sobol", 64))
    )
    whole = np.isclose(sampled, radiance, rtol=1e-4)
    # Both lamps, on either side of the picture.
    assert whole[:, :48].sum() > 20 and whole[:, 48:].sum() > 20
    assert np.allclose(seen[whole], radiance, rtol=0.02)
    part = sampled > 0.2 * radiance
    # Rims by a few rays.
    assert np.allclose(seen[part], sampled[part], atol=0.1 * radiance)
    assert not np.any(seen[~part] > 0.3 * radiance)
