# SPDX-License-Identifier: GPL-3.0-or-later
"""Integrals over pixels and a lens as one over pixels alone, whose every point has a camera ray of its own.

Fog that is seen through a point of the lens, and lit by a point of a lamp, is as smooth over the picture as
without a lens: so points of a net can be followed that are of both.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..integration.integrand import FirstStage, StagedIntegrand, values_at
from ..integration.point_sets import SobolPoints
from ..integration.sobol import digital_shift
from .around_light import FARTHEST, HALF_WIDTH
from .camera_hits import Pixels
from .camera_rays import CameraRays

NEAR = 3.0
"""Radii of a lens from its middle, within which a lamp that is seen has rays of its own."""

LENS_POINTS = 8
"""Of a lens, that tell what is expected of all: a lamp is seen by its middle where few others see it."""


def beside_images(
    rays: CameraRays, places: np.ndarray, reach: np.ndarray, region: tuple[int, int, int, int]
) -> np.ndarray:
    """(W, H) bool, pixels of a region (x0, y0, x1, y1) that may look into places (3, L) in the frame, or next
    to them: there is no bound to what is seen. None of those as large as that, by their reach (L,).
    """
    x0, y0, x1, y1 = region
    found = np.zeros((x1 - x0, y1 - y0), bool)
    image, depth = rays.image_of(places)
    blur, scale = rays.blur(depth), rays.scale(places)
    with np.errstate(invalid="ignore", over="ignore"):
        radius, own = HALF_WIDTH + blur * scale, reach * scale
        seen = (depth > rays.clip_start) & (own <= HALF_WIDTH) & (np.abs(image) < FARTHEST).all(axis=0)
    for (x, y), far in zip(image[:, seen].T, np.fmin(radius[seen], FARTHEST), strict=True):
        part = tuple(
            slice(int(np.clip(at - far, low, high)) - low, int(np.clip(at + far + 1, low, high)) - low)
            for at, low, high in ((x, x0, x1), (y, y0, y1))
        )
        across, down = (
            np.arange(n)[s] + low + 0.5 for n, s, low in zip(found.shape, part, (x0, y0), strict=True)
        )
        found[part] |= np.hypot(across[:, None] - x, down - y) < far
    return found


@dataclass(frozen=True, eq=False)
class Lamp:
    """A lamp in the picture: its number, position (3,) in the frame, and its light alone.

    lit : as of `CameraRays.lens_about`.
    """

    number: int
    position: np.ndarray
    light: StagedIntegrand
    lit: tuple[float, float] | None = None


@dataclass(eq=False)
class PlacesOfPixels:
    """S places (2, B, S) in the unit squares of B pixels: B * S points, no ray yet."""

    pixels: Pixels
    u: np.ndarray
    values: None = field(default=None, init=False)
    lane: None = field(default=None, init=False)

    def rays(self, lane: np.ndarray | None) -> tuple[Pixels, np.ndarray]:
        """Pixels (N,) and places (2, N, 1) of points ``lane`` (N,), None for all."""
        count = self.u.shape[2]
        if lane is None and count == 1:
            return self.pixels, self.u
        lane = np.arange(self.u[0].size) if lane is None else lane
        return self.pixels[lane // count], self.u.reshape(2, -1).take(lane, axis=1)[:, :, None]


class ThroughLens:
    """The integrand: points of the rest are those of ``integrand``, and two more of the lens, the last.

    Where rays through the lens pass a lamp on all sides, fog is as bright as 1/distance: there each such lamp
    has rays of its own, spread about where the lens sees it.
    """

    staged = False

    def __init__(
        self, integrand: StagedIntegrand, lamps: Sequence[Lamp] = (), rays: CameraRays | None = None
    ) -> None:
        """integrand : over a pixel and a lens, of the ``lamps``, too. rays : that see these."""
        self._integrand, self._lamps, self._rays = integrand, lamps, rays
        self.rest_dimensions = integrand.rest_dimensions + 2

    @property
    def counts(self) -> Counter[str]:
        return sum((lamp.light.counts for lamp in self._lamps), Counter(self._integrand.counts))

    def first(self, pixels: Pixels, u: np.ndarray) -> PlacesOfPixels:
        return PlacesOfPixels(pixels, u)

    def rest(self, stage: PlacesOfPixels, lane: np.ndarray | None, u: np.ndarray) -> tuple[None, np.ndarray]:
        pixels, place = stage.rays(lane)
        if len(pixels) == 0:
            return None, np.zeros((3, 0), np.float32)
        u = u.reshape(len(u), len(pixels), -1)
        total, others = np.zeros((3, *u.shape[1:]), np.float32), {}
        for number, lamp in enumerate(self._lamps):
            at = self._rays.seen_at(lamp.position, pixels.x, pixels.y, place)
            near = np.hypot(*at)[:, 0] < NEAR
            rows = np.flatnonzero(near)
            if rows.size == 0:
                continue
            others[lamp.number] = ~near
            own = digital_shift(u[:, rows], number)
            lens, weight = self._rays.lens_about(at[:, rows], own[-2:], lamp.lit)
            light = self._through(lens, pixels[rows], place[:, rows], own, lamp.light)
            total[:, rows] += light * weight.astype(np.float32)
        total += self._through(u[-2:], pixels, place, u, self._integrand, others)
        return None, total.reshape(3, -1)

    def _through(
        self,
        lens: np.ndarray,
        pixels: Pixels,
        place: np.ndarray,
        u: np.ndarray,
        integrand: StagedIntegrand,
        others: dict[int, np.ndarray] | None = None,
    ) -> np.ndarray:
        """(3, B, S) of rays through points of the ``lens`` (2, B, S) and places (2, B, 1) of pixels.

        others : of lights by number, (B,) bool, which pixels get theirs so.
        """
        first = integrand.first(pixels, np.concatenate([np.broadcast_to(place, lens.shape), lens]))
        if others:
            ray = np.repeat(np.arange(len(pixels)), lens.shape[2])
            ray = ray if first.lane is None else ray.take(first.lane)
            first.lit = {number: some.take(ray) for number, some in others.items()}
        rest = u[: integrand.rest_dimensions].reshape(integrand.rest_dimensions, -1)
        return values_at(integrand, first, lens[0].size, None, rest)[:3].reshape(3, *lens.shape[1:])

    def told_by(
        self, tell: Callable[[FirstStage, int], np.ndarray]
    ) -> Callable[[PlacesOfPixels, int], np.ndarray]:
        """What is told of so many rays by their first stage, in the mean over a few points of the lens."""
        net = SobolPoints(range(2), 0, 108)
        net.prepare(LENS_POINTS)
        lens = net.points(np.zeros(1, np.uint32), 0, LENS_POINTS)

        def told(stage: PlacesOfPixels, count: int) -> np.ndarray:
            pixels, place = stage.rays(None)
            u = np.concatenate([np.broadcast_to(a, (2, len(pixels), LENS_POINTS)) for a in (place, lens)])
            return tell(self._integrand.first(pixels, u), u[0].size).reshape(count, -1).mean(axis=1)

        return told
