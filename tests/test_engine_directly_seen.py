# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps as camera rays see them, where they are thinner than a pixel."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

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
        seen = DirectlySeen(Dot(), (SIZE, SIZE), pixels_at, seed, 1 << 12, lambda f, a: [*map(f, a)], about)
        mean = RADIANCE * np.pi * RADIUS**2
        # Of 1024 points of a net.
        assert np.allclose(seen.mean[:, 4, 3], mean, rtol=0.1)
        assert seen.mean.sum() == seen.mean[:, 4, 3].sum()
