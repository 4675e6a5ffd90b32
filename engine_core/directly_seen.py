# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, emission and background as camera rays see them: an integral of its own, over the pixel alone.

Beside a bright lamp's rim no polynomial is of use, and none is needed: a camera ray costs little, so more
of them go where the neighbours see different things. A pixel's own first ray has no say in that, or what
it finds would decide whether it counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .integration.mapping import Map
from .integration.point_sets import SobolPoints
from .settings import Settings
from .transport.camera_hits import CameraStage
from .transport.direct_light import RGB, DirectLightOverTile, Pixels

OF_EDGE = 0.365
"""Error by a ray of a pixel that an edge crosses, in units of its contrast; n of a net have n^-3/4 of it."""

PRECISE = 0.01
"""Error that is wanted, of the picture's mean radiance, with one sample a pixel; with n, n^-3/4 of it."""

RAYS, FEWEST = 1.0, 1 << 15
"""Of each pixel for each of `Settings.samples`, on average, at most; or so many in all, as a small picture
has no fewer edges in a pixel than a large one."""

LEAST, MOST = 1 / 8, 1 << 14
"""Rays of a pixel: for each of `Settings.samples` at least, as no other may see what is in it; at most."""

FURTHER = 0.5
"""Part of the contrast that pixels of the other colour two steps further on show, that is expected of one."""

BESIDE = ((-1, 0), (1, 0), (0, -1), (0, 1))
FURTHER_ON = (*BESIDE, *((x * i, y * j) for x in (-1, 1) for y in (-1, 1) for i, j in ((1, 2), (2, 1))))
"""Pixels of a chessboard's other colour: those that share an edge with one, and the next."""

LOOKS, LOOKS_SHARE = 16, 1 / 4
"""Rays of a pixel in which a lamp may be seen that only tell how much they differ, at most; and how many in
all, over the picture's pixels."""

GROUP = 2
"""Of the points: another than those of reflected light. The next is of such looks."""

UNKNOWN = 16
"""Samples that are reckoned with at most where a threshold or the clock decides how many there are."""


def directly_seen(
    eye: DirectLightOverTile,
    stage: CameraStage,
    region: tuple[int, int, int, int],
    settings: Settings,
    map_: Map,
    beside: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """(2, 3, W, H) mean radiance, and its standard error, of what needs no light sample.

    region : x0, y0, x1, y1 in the whole frame. beside : mean radiance of all else that is shown.
    """
    x0, y0, x1, y1 = region
    of_lights = stage.images_of_lights((x0, y0, x1 - x0, y1 - y0))
    where = slice(None), slice(None)
    if not stage.sees_elsewhere:
        where = tuple(_extent(of_lights.any(axis=1 - axis)) for axis in (0, 1))
    corner = np.array([[low + (part.start or 0)] for low, part in zip((x0, y0), where, strict=True)])

    def pixels_at(index: np.ndarray) -> Pixels:
        x, y = (index + corner).astype(np.int32)
        return Pixels(x, y, np.zeros(len(x), np.int32))

    found = np.zeros((2, 3, *of_lights.shape))
    if of_lights[where].size:
        samples = settings.samples
        if settings.noise_threshold or settings.time_limit:
            samples = min(samples, UNKNOWN)
        seen = DirectlySeen(
            eye,
            of_lights[where],
            pixels_at,
            settings.seed + 1,
            settings.batch_size,
            map_,
            samples,
            of_lights.size,
            beside,
        )
        found[:, :, *where] = seen.mean, seen.error
    return found


def _extent(some: np.ndarray) -> slice:
    """From the first to the last of ``some`` (N,) bool."""
    index = np.flatnonzero(some)
    return slice(int(index[0]), int(index[-1]) + 1) if len(index) else slice(0, 0)


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
        samples: int,
        of_picture: int,
        beside: float = 0.0,
    ) -> None:
        """of_lights : (W, H) bool, pixels in which a light may be seen. pixels_at : index (2, N) -> pixels.

        batch : rays at once. map_ : over the workers. samples : as in `Settings`. of_picture : how many
        pixels there are, with those that see nothing. beside : mean radiance of all else that is shown.
        """
        bins = of_lights.shape
        self._integrand, self._pixels_at, self._batch, self._map = integrand, pixels_at, batch, map_
        self._points = SobolPoints(range(2), seed, GROUP)
        index = np.indices(bins).reshape(2, -1)
        self.mean = self._rays(index, 0, 1).reshape(3, *bins)
        contrast = contrast_beside(self.mean, self._at_corners(of_lights))
        contrast = np.maximum(contrast, FURTHER * contrast_beside(self.mean, around=FURTHER_ON))
        rays = np.full(bins, 1 << int(np.log2(max(1, LEAST * samples))))
        looks = int(min(LOOKS, LOOKS_SHARE * of_picture / max(np.count_nonzero(of_lights), 1)))
        if looks > 1 and of_lights.any():
            # What is thinner than a pixel no neighbour sees.
            own = self._differ(index[:, of_lights.ravel()], looks, seed)
            contrast[:, of_lights] = np.maximum(contrast[:, of_lights], own)
            rays[of_lights] = np.maximum(rays[of_lights], looks)
        rays = np.maximum(rays, self._shared(contrast.max(axis=0), samples, of_picture, beside))
        for count in np.unique(rays[rays > 1]):
            where = np.flatnonzero(rays.ravel() == count)
            # The first ray is the net's first point, and stays.
            more = self._rays(index[:, where], 1, int(count) - 1)
            first = self.mean.reshape(3, -1)[:, where]
            self.mean.reshape(3, -1)[:, where] = (first + (count - 1) * more) / count
        self.error = OF_EDGE * contrast * rays**-0.75

    def _shared(self, contrast: np.ndarray, samples: int, of_picture: int, beside: float) -> np.ndarray:
        """(W, H) rays of pixels, powers of two, by which the picture's error is the least."""
        rays, seen = np.ones(contrast.shape, np.int64), self.mean.mean(axis=0)
        black = np.indices(contrast.shape).sum(axis=0) % 2 == 0
        # As of a chessboard: what is not a pixel's own colour alone tells how many rays it has.
        for which in (black, ~black):
            share, pixels = contrast[which] ** 0.8, max(of_picture / 2, 1)
            bright = max(seen[~which].sum() / pixels + beside, 1e-30)
            total = float(share.sum())
            if not total > 0:
                continue
            # By c^0.8 k rays in each pixel, the sum of squared errors is OF_EDGE^2 k^-1.5 sum(c^0.8).
            wanted = PRECISE * samples**-0.75 * bright
            k = (OF_EDGE**2 * total / (pixels * wanted**2)) ** (2 / 3)
            k = min(k, max(RAYS * samples * pixels, FEWEST / 2) / total)
            rays[which] = np.exp2(np.rint(np.log2(np.clip(k * share, 1, MOST)))).astype(np.int64)
        return rays

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


def contrast_beside(
    values: np.ndarray, corners: np.ndarray | None = None, around: Sequence[tuple[int, int]] = BESIDE
) -> np.ndarray:
    """(C, W, H) difference between the largest and the least of the pixels ``around`` each, and its corners.

    corners : (C, W + 1, H + 1), NaN where they are unknown.
    """
    width, height = values.shape[1:]
    reach = 2

    def over_neighbours(choose: np.ufunc, beyond: float) -> np.ndarray:
        padded = np.pad(values, [(0, 0), (reach, reach), (reach, reach)], constant_values=beyond)
        chosen = np.full_like(values, beyond)
        for x, y in around:
            at = np.s_[:, reach + x : reach + x + width, reach + y : reach + y + height]
            choose(chosen, padded[at], out=chosen)
        if corners is not None:
            known = np.where(np.isnan(corners), beyond, corners)
            for x, y in np.ndindex(2, 2):
                choose(chosen, known[:, x : x + width, y : y + height], out=chosen)
        return chosen

    return np.maximum(over_neighbours(np.maximum, -np.inf) - over_neighbours(np.minimum, np.inf), 0)
