# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, emission and background as camera rays see them: an integral of its own, over the pixel alone.

Beside a bright lamp's rim no polynomial is of use, and none is needed: a camera ray costs little, so more
of them go where the neighbours see different things. A pixel's own first ray has no say in that, or what
it finds would decide whether it counts.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .integration.mapping import Map
from .integration.point_sets import SobolPoints
from .transport.direct_light import RGB, DirectLightOverTile, Pixels

STEPS = ((0.02, 16), (0.3, 64), (3.0, 256), (30.0, 1024))
"""Contrast among the neighbours, over the picture's mean, above which a pixel gets so many rays."""

LOOKS, LOOKS_SHARE = 16, 1 / 4
"""Rays of a pixel in which a lamp may be seen that only tell how much they differ, at most; and how many in
all, over the picture's pixels."""

GROUP = 2
"""Of the points: another than those of reflected light. The next is of such looks."""


class DirectlySeen:
    """Means over pixels (W, H) of what needs no light sample.

    mean : (3, W, H) radiance. error : (3, W, H) its standard error, about.
    """

    def __init__(
        self,
        integrand: DirectLightOverTile,
        of_lights: np.ndarray,
        pixels_at: Callable[[np.ndarray], Pixels],
        seed: int,
        batch: int,
        map_: Map,
        of_picture: int,
        beside: float = 0.0,
    ) -> None:
        """of_lights : (W, H) bool, pixels in which a light may be seen. pixels_at : index (2, N) -> pixels.

        batch : rays at once. map_ : over the workers. of_picture : how many pixels there are, with those
        that see nothing. beside : mean radiance of all else that the picture shows.
        """
        bins = of_lights.shape
        self._integrand, self._pixels_at, self._batch, self._map = integrand, pixels_at, batch, map_
        self._points = SobolPoints(range(2), seed, GROUP)
        index = np.indices(bins).reshape(2, -1)
        self.mean = self._rays(index, 0, 1).reshape(3, *bins)
        contrast = contrast_around(self.mean, self._at_corners(of_lights))
        rays = np.ones(bins, np.int64)
        looks = int(min(LOOKS, LOOKS_SHARE * of_picture / max(np.count_nonzero(of_lights), 1)))
        if looks > 1 and of_lights.any():
            # What is thinner than a pixel no neighbour sees.
            own = self._differ(index[:, of_lights.ravel()], looks, seed)
            contrast[:, of_lights] = np.maximum(contrast[:, of_lights], own)
            rays[of_lights] = looks
        # The mean of all others, for the same reason.
        total = self.mean.mean(axis=0)
        others = (total.sum() - total) / max(of_picture - 1, 1)
        bright = others + beside
        for step, count in STEPS:
            rays[contrast.max(axis=0) > step * bright + 1e-30] = count
        for count in np.unique(rays[rays > 1]):
            where = np.flatnonzero(rays.ravel() == count)
            # The first ray is the net's first point, and stays.
            more = self._rays(index[:, where], 1, int(count) - 1)
            first = self.mean.reshape(3, -1)[:, where]
            self.mean.reshape(3, -1)[:, where] = (first + (count - 1) * more) / count
        # An edge across a pixel is integrated by n points of a net with 0.365 n^-3/4 of its contrast.
        self.error = 0.365 * contrast * rays**-0.75

    def _at_corners(self, pixels: np.ndarray) -> np.ndarray:
        """(3, W + 1, H + 1) what rays at the corners of ``pixels`` (W, H) see, NaN at others."""
        wanted = np.zeros([n + 1 for n in pixels.shape], bool)
        for x, y in np.ndindex(2, 2):
            wanted[x : x + pixels.shape[0], y : y + pixels.shape[1]] |= pixels
        seen = np.full((3, *wanted.shape), np.nan)
        index = np.stack(np.nonzero(wanted))

        def look(low: int) -> np.ndarray:
            some = self._pixels_at(index[:, low : low + self._batch])
            hits = self._integrand.first(some, np.zeros((2, len(some), 1)))
            return hits.values[RGB].astype(np.float64)

        if index.size:
            seen[:, wanted] = np.concatenate(self._map(look, range(0, index.shape[1], self._batch)), axis=1)
        return seen

    def _differ(self, index: np.ndarray, count: int, seed: int) -> np.ndarray:
        """(3, N) differences between the most and the least that ``count`` rays see in pixels (2, N)."""
        points = SobolPoints(range(2), seed, GROUP + 1)
        points.prepare(count)
        width = max(1, self._batch // count)

        def look(low: int) -> np.ndarray:
            pixels = self._pixels_at(index[:, low : low + width])
            hits = self._integrand.first(pixels, points.points(pixels.key(), 0, count))
            return np.ptp(hits.values[RGB].reshape(3, len(pixels), count), axis=2)

        return np.concatenate(self._map(look, range(0, index.shape[1], width)), axis=1)

    def _rays(self, index: np.ndarray, start: int, count: int) -> np.ndarray:
        """(3, N) mean of ``count`` rays of pixels (2, N), the net's points from ``start`` on."""
        self._points.prepare(start + count)
        width = max(1, self._batch // count)

        def look(low: int) -> np.ndarray:
            pixels = self._pixels_at(index[:, low : low + width])
            hits = self._integrand.first(pixels, self._points.points(pixels.key(), start, count))
            return hits.values[RGB].reshape(3, len(pixels), count).mean(axis=2, dtype=np.float64)

        return np.concatenate(self._map(look, range(0, index.shape[1], width)), axis=1)


def contrast_around(values: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(C, W, H) difference between the largest and the least of each pixel's eight neighbours, and corners.

    corners : (C, W + 1, H + 1), NaN where they are unknown.
    """
    around = [(x, y) for x in range(3) for y in range(3) if (x, y) != (1, 1)]
    return _contrast(values, around, corners)


def contrast_beside(values: np.ndarray) -> np.ndarray:
    """The same of the four that share an edge with it."""
    return _contrast(values, [(0, 1), (2, 1), (1, 0), (1, 2)])


def _contrast(
    values: np.ndarray, around: list[tuple[int, int]], corners: np.ndarray | None = None
) -> np.ndarray:
    """around : which of 3 x 3 pixels."""
    width, height = values.shape[1:]

    def over_neighbours(choose: np.ufunc, beyond: float) -> np.ndarray:
        padded = np.pad(values, [(0, 0), (1, 1), (1, 1)], constant_values=beyond)
        chosen = padded[:, :width, :height].copy()
        for x, y in around:
            choose(chosen, padded[:, x : x + width, y : y + height], out=chosen)
        if corners is not None:
            known = np.where(np.isnan(corners), beyond, corners)
            for x, y in np.ndindex(2, 2):
                choose(chosen, known[:, x : x + width, y : y + height], out=chosen)
        return chosen

    return np.maximum(over_neighbours(np.maximum, -np.inf) - over_neighbours(np.minimum, np.inf), 0)
