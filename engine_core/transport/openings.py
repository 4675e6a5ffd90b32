# SPDX-License-Identifier: GPL-3.0-or-later
"""By which openings the world gets into the fog of a room, as pilots find them.

From places all over the fog that the picture shows, directions are tried. Those that get out leave a box,
about all that others meet, at places of its sides: a few rectangles hold these, cut so that together they are
as small as can be. Where they gain little, as under the open sky, there are none.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry.raytracer import FAR
from ..geometry.vectors import take
from ..geometry.warps import uniform_sphere
from .camera_hits import Pixels
from .emitters.openings import OTHERS, Openings, Rectangles
from .fog_rays import taken
from .single_scattering import SingleScattering

RAYS, PLACES, DIRECTIONS = 48, 2, 64
"""Along the picture's longer edge, rays that tell places; these, in each segment of fog of theirs; and
directions that are tried from each."""

MOST_PLACES = 4096
"""Of these, at random: of many bodies there are many segments."""

DEPTH = 3.0
"""Optical depth up to which there are places."""

OPEN = 0.35
"""Part of all directions that get out, from which on there is no room."""

ENOUGH, TIMES = 2000, 4
"""Directions that get out; fewer are tried so many times in all, at most."""

FEWEST = 64
"""Directions that get out by a rectangle, at least."""

MOST = 16
"""Rectangles."""

SAVING, BY_CHANCE = 0.03, 30.0
"""Of a rectangle's area, what two are less that it is cut into, at least; and that times the places found in
it, as there are gaps between them by chance.
"""

WIDER, MARGIN = 0.04, 8.0
"""Part of its edges by which a rectangle is wider to either side than the places in it; and the mean distance
of these by which it is, too. What gets in beside rectangles is found by few samples, and bright."""

SMALLEST = 1e-4
"""Of a side's edges, those of a rectangle at least."""

OUTLIERS = 0.002, 0.02, 0.1
"""Part of what is met that may be outside of each of a box's sides: what stands before the windows is."""

SHARES, OF_IMAGES = (0.6, 0.75, 0.9), (0.5,)
"""Of the directions from inside of a box, what may go through rectangles; and to images, whose own directions
know what is bright."""

WORTH = 1.5
"""By how much less f^2 must be in the mean."""

_OF_ALL = np.float32(0.25 / np.pi)


def open_worlds(
    scattering: SingleScattering,
    lights: np.ndarray,
    pixels: Callable[[np.ndarray, np.ndarray], Pixels],
    region: tuple[int, int, int, int],
    seed: int,
    check: Callable[[], None] = lambda: None,
) -> bool:
    """Let the world, where it is one of lights (L,), shine into fog by openings, where these gain; whether
    they do. Other arguments as of `find_openings`.
    """
    groups, first = scattering.lights.groups, scattering.lights.first[:-1]
    worlds = [group for group, n in zip(groups, first, strict=True) if group.is_world and n in lights]
    if not worlds:
        return False
    shares = OF_IMAGES if any(world.has_tint for world in worlds) else SHARES
    found = find_openings(scattering, pixels, region, seed, check, shares)
    for world in worlds:
        world.openings = found
    return found is not None


def find_openings(
    scattering: SingleScattering,
    pixels: Callable[[np.ndarray, np.ndarray], Pixels],
    region: tuple[int, int, int, int],
    seed: int,
    check: Callable[[], None] = lambda: None,
    shares: tuple[float, ...] = SHARES,
) -> Openings | None:
    """None where nothing is gained.

    pixels : in columns and rows (B,) of the whole frame. region : x0, y0, x1, y1. check : called before
        every batch; may raise, to give up. shares : that may be chosen.
    """
    random = np.random.default_rng((seed & 0xFFFFFFFF, 109))
    tried, out, places, met = 0, [], [], []
    for _ in range(TIMES):
        check()
        some = _places(scattering, pixels, region, random)
        at = np.repeat(some, DIRECTIONS, axis=1)
        direction, _ = uniform_sphere(random.random((2, at.shape[1]), np.float32))
        rays = tuple(np.ascontiguousarray(a.T, np.float32) for a in (at, direction))
        got_out, *_ = scattering.shadows.passing(*rays, FAR)
        far = scattering.surfaces.distance(*rays, FAR)
        hit = np.flatnonzero(far < FAR)
        tried += len(far)
        out.append(np.stack([take(at, got_out), take(direction, got_out)]))
        places.append(some)
        met.append(take(at, hit) + take(direction, hit) * far.take(hit))
        count = sum(a.shape[2] for a in out)
        if not 2 * FEWEST <= TIMES * count <= TIMES * ENOUGH:
            break
    if not 2 * FEWEST <= count <= OPEN * tried:
        return None
    out, places, met = (np.concatenate(a, axis=-1) for a in (out, places, met))
    # Half of them say where openings are, the others what that is worth.
    half = random.random(count) < 0.5
    others = out[..., ~half]
    best, worth = None, WORTH
    parts = np.array(OUTLIERS)
    lows, highs = np.quantile(np.concatenate([places, met], axis=1), [parts, 1 - parts], axis=1)
    for low, high in zip(lows, highs, strict=True):
        check()
        # All fog that is seen is inside, so that no place has another map than the next.
        low, high = np.minimum(low, places.min(axis=1)), np.maximum(high, places.max(axis=1))
        found = _weighed(low.astype(np.float32), high.astype(np.float32), *out[..., half], places)
        for share in shares if found else ():
            openings = Openings(*found, share)
            gain = others.shape[2] / (_OF_ALL / openings.pdf(_AnyWorld, *others)).sum()
            if gain > worth:
                best, worth = openings, gain
    return best


def _places(
    scattering: SingleScattering,
    pixels: Callable[[np.ndarray, np.ndarray], Pixels],
    region: tuple[int, int, int, int],
    random: np.random.Generator,
) -> np.ndarray:
    """(3, P) float32 in the fog that camera rays run through, some of each of their segments."""
    x0, y0, x1, y1 = region
    step = max((x1 - x0) / RAYS, (y1 - y0) / RAYS, 1)
    x, y = (np.arange(low, high, step).astype(np.int32) for low, high in ((x0, x1), (y0, y1)))
    some = pixels(*(a.ravel() for a in np.meshgrid(x, y)))
    rays = scattering.first(some, np.full((scattering.screen_dimensions, len(some), 1), 0.5, np.float32))
    media = rays.media
    if rays.through is not None:
        # Some may be behind what lets nothing through.
        media = taken(media, np.flatnonzero(rays.through.any(axis=0)))
    # Anywhere alike: what is lit is not yet known.
    length = np.minimum(media.end - media.start, DEPTH / scattering.thinnest.take(media.mixture))
    t = media.start + (np.arange(PLACES)[:, None] + random.random((PLACES, len(length)))) / PLACES * length
    along, origin = (take(a, media.ray)[:, None] for a in (rays.direction, rays.origin))
    places = (origin + along * t).reshape(3, -1).astype(np.float32)
    return take(places, random.permutation(places.shape[1])[:MOST_PLACES])


def _weighed(
    low: np.ndarray, high: np.ndarray, at: np.ndarray, direction: np.ndarray, places: np.ndarray
) -> tuple[Rectangles, np.ndarray] | None:
    """Openings in the sides of the box from ``low`` to ``high`` (3,), and how often each should be taken,
    over what it seems to fill: by directions (3, N) that get out from points (3, N), of those tried at
    ``places``.
    """
    none = np.zeros((2, 0), np.float32)
    box = Rectangles(low, high, np.zeros(0, np.intp), none, none)
    inside = np.flatnonzero(box.hold(at))
    at, direction = take(at, inside), take(direction, inside)
    side, place, _ = box.leaving(at, direction)
    found = rectangles(low, high, side, place)
    if found is None:
        return None
    # Bars, and walls that are thick, let less through than there seems to be.
    which, _ = found.through(at, direction)
    count = np.bincount(which[which >= 0], minlength=len(found))
    seen = Openings(found, np.ones(len(found)), 1.0).seen(take(places, np.flatnonzero(box.hold(places))))
    return found, np.sqrt(count / seen.sum(axis=1))


class _AnyWorld:
    """One of which nothing is known."""

    @staticmethod
    def pdf_in_space(direction: np.ndarray) -> np.ndarray:
        return np.full(direction.shape[1], _OF_ALL)


def rectangles(low: np.ndarray, high: np.ndarray, side: np.ndarray, place: np.ndarray) -> Rectangles | None:
    """Few that hold most of the places (2, N) where directions leave a box, by its sides (N,)."""
    parts = []
    for s in range(6):
        rows = np.flatnonzero(side == s)
        if rows.size >= FEWEST:
            across = OTHERS[s % 3]
            parts.append(_Part(s, take(place, rows), np.stack([low[across], high[across]])))
    while parts and len(parts) < MOST:
        k = max(range(len(parts)), key=lambda k: parts[k].saved)
        if parts[k].saved <= 0:
            break
        parts[k : k + 1] = parts[k].cut()
    if not parts:
        return None
    first, last = np.stack([part.corners for part in parts], axis=-1).astype(np.float32)
    # float32 may leave nothing of what is tiny.
    some = np.flatnonzero((last > first).all(axis=0))
    if some.size == 0:
        return None
    side = np.array([part.side for part in parts])
    return Rectangles(low, high, side.take(some), take(first, some), take(last, some))


class _Part:
    """A rectangle of a side, and how it is best cut in two.

    saved : area, 0 if it is not to be cut.
    """

    def __init__(self, side: int, places: np.ndarray, bounds: np.ndarray) -> None:
        """places : (2, N) in it. bounds : (2, 2) lower and upper corner of what it may be at most."""
        self.side, self._places, self._bounds = side, places, bounds
        self._first, self._last = places.min(axis=1), places.max(axis=1)
        area, n = float(np.prod(self._last - self._first)), places.shape[1]
        self.saved, least = 0.0, max(SAVING, BY_CHANCE / n) * area
        for axis in range(2) if n >= 2 * FEWEST else ():
            ordered = places[:, places[axis].argsort()]
            # Of the first so many, and of all others.
            before, after = (
                np.prod(np.maximum.accumulate(a, axis=1) - np.minimum.accumulate(a, axis=1), axis=0)
                for a in (ordered, ordered[:, ::-1])
            )
            # What is in one place is not told apart.
            apart = ordered[axis, 1:] > ordered[axis, :-1]
            both = np.where(apart, before[:-1] + after[-2::-1], np.inf)[FEWEST - 1 : n - FEWEST]
            k = int(both.argmin())
            if area - both[k] > max(self.saved, least):
                self.saved, k = area - float(both[k]), k + FEWEST
                self._axis, self._upper = axis, ordered[axis, k]
                self._at = float(ordered[axis, k - 1 : k + 1].mean(dtype=np.float64))

    def cut(self) -> list[_Part]:
        """Both parts of it."""
        found = []
        for upper in (False, True):
            bounds = self._bounds.copy()
            bounds[0 if upper else 1, self._axis] = self._at
            rows = np.flatnonzero((self._places[self._axis] >= self._upper) == upper)
            found.append(_Part(self.side, take(self._places, rows), bounds))
        return found

    @property
    def corners(self) -> np.ndarray:
        """(2, 2), a little further than what is in it."""
        margin = (WIDER + MARGIN / self._places.shape[1]) * (self._last - self._first)
        margin = np.maximum(margin, SMALLEST * (self._bounds[1] - self._bounds[0]))
        return np.stack(
            [
                np.maximum(self._first - margin, self._bounds[0]),
                np.minimum(self._last + margin, self._bounds[1]),
            ]
        )
