# SPDX-License-Identifier: GPL-3.0-or-later
"""By which part of the sky surfaces are lit, learned by pilots all over the picture (`guide`).

Into a room few directions of the sky come, by its windows; which, that is another at each place of its walls.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace

import numpy as np

from ..integration.mapping import Map
from .camera_hits import CameraHits, Pixels
from .direct_light import NOTHING, DirectLight, DirectLightOverTile
from .guide import Guide
from .light_choice import OneLight

TILES = 16, 8
"""As of `Guide.of`."""

LEARNING = 0.25
"""Of the samples that surfaces get, what pilots may take beyond their first points, about."""


class OfOneLight:
    """What one light brings surfaces, by its samples alone; `StagedIntegrand` of pixels without a lens."""

    staged = True

    def __init__(self, integrand: DirectLight, light: int, check: Callable[[], None]) -> None:
        """check : called before every batch; may raise, to give up."""
        alone = copy(integrand)
        # What lobes find, and fog that glows, is not where light samples go; nor is what the power heuristic
        # leaves to lobes.
        alone._sample_lobe = lambda *_: NOTHING
        alone._glows = False
        choice = OneLight(light) if len(integrand.lights) > 1 else None
        self._integrand = DirectLightOverTile(alone, choice, check, seen=False)
        self._lens = integrand.screen_dimensions - 2
        self.rest_dimensions, self.rest = self._integrand.rest_dimensions, self._integrand.rest
        self.counts = self._integrand.counts

    def first(self, pixels: Pixels, u: np.ndarray) -> CameraHits:
        """Through the lens' middle, without values of its own."""
        middle = np.full((self._lens, *u.shape[1:]), 0.5, u.dtype)
        return replace(self._integrand.first(pixels, np.concatenate([u, middle])), values=None)


def guide_of_sky(
    integrand: DirectLight,
    pixels: Callable[[np.ndarray, np.ndarray], Pixels],
    region: tuple[int, int, int, int],
    seed: int,
    samples: int,
    map_: Map,
    check: Callable[[], None],
) -> tuple[Guide | None, list[OfOneLight]]:
    """None where there is no sky, or nothing is gained; and what counted the rays.

    samples : of a pixel. Other arguments as of `Guide.of`, and `OfOneLight`.
    """
    skies = integrand.lights.of_world.tolist()
    if not (skies and integrand.reflects):
        return None, []
    lights = [OfOneLight(integrand, light, check) for light in skies]
    size = (region[2] - region[0]) * (region[3] - region[1])
    guide = Guide.of(lights, pixels, region, seed, int(LEARNING * samples * size), map_, 2, TILES)
    if guide is not None:
        guide.gaining = [skies[number] for number in guide.gaining]
    return guide, lights
