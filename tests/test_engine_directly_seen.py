# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps as camera rays see them: where they are, and where they are thinner than a pixel."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import studio

from engine_core import PointLight, Settings, SunLight, World, render
from engine_core.directly_seen import DirectlySeen
from engine_core.transport.camera_hits import Pixels
from engine_core.transport.direct_light import DirectLight

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


def test_lamps_among_many_are_seen_without_aliasing():
    """Nine lamps in the picture, sampled plainly: right in the mean, with less noise than Sobol's."""
    random = np.random.default_rng(3)
    lamps = [
        PointLight(2.0, position=p, radius=0.05, visible_to_camera=True)
        for p in random.uniform((-2, -1, 0.5), (2, 2, 2), (9, 3))
    ]
    made = studio(48, 32, lights=lamps)

    def pictures(count, settings):
        seeds = (replace(settings, seed=settings.seed + k) for k in range(count))
        return np.array([render(made, one).combined[..., :3] for one in seeds], np.float64)

    plain, ours = pictures(4, Settings(64, integrator="sobol", seed=90)), pictures(8, Settings(2))
    few = pictures(8, Settings(2, integrator="sobol"))
    assert np.sqrt(ours.var(axis=0).mean()) < 0.25 * np.sqrt(few.var(axis=0).mean())
    means = [a.mean(axis=(1, 2, 3)) for a in (ours, plain)]
    error = np.hypot(*(a.std(ddof=1) / len(a) ** 0.5 for a in means))
    assert abs(means[0].mean() - means[1].mean()) < 4 * error + 1e-3 * means[1].mean()
    told = render(made, Settings(2, standard_error=True)).standard_error
    assert np.isfinite(told).all() and told.max() > 0


def test_images_of_many_lights_are_the_boxes_about_them():
    random = np.random.default_rng(4)
    places = random.uniform((-4, -1, -1), (4, 6, 3), (40, 3))
    places[::5, 1] -= 40  # behind the camera
    lamps = [
        PointLight(1.0, position=p, radius=0.2, visible_to_camera=k % 4 > 0) for k, p in enumerate(places)
    ]

    def images(*some):
        return DirectLight(studio(48, 32, lights=some)).stage.images_of_lights((5, 3, 40, 26))

    one_by_one = np.array([images(lamp) for lamp in lamps])
    assert 0.1 < one_by_one.any(axis=0).mean() < 0.9
    assert not one_by_one[::4].any() and not one_by_one[::5].any()
    np.testing.assert_array_equal(images(*lamps), one_by_one.any(axis=0))
