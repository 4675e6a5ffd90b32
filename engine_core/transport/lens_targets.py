# SPDX-License-Identifier: GPL-3.0-or-later
"""What is small and bright behind a lens: which pixels see it, and through which points of the lens.

From the place where a pixel's rays are in focus, a target is seen through a part of the lens that is as much
smaller than the lens as the target's blur is wider than itself. Points of the whole lens hardly find it: most
of a pixel's are of these parts, the rest of all the lens, and all have one density, that of the mixture: the
balance heuristic of E. Veach and L. Guibas, "Optimally Combining Sampling Techniques", 1995.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from ..integration.mapping import Map, in_order
from .around_light import FARTHEST
from .camera_hits import CameraStage, Pixels
from .camera_rays import CameraRays

PLAIN = 0.25
"""Part of the points that are spread over the whole lens, at least: parts hold what they are meant to find
only about."""

LARGE = 0.5
"""Of the lens' square, from which on a part is no better than the whole."""

WIDER = 1.1
"""Times as wide as they are reckoned that parts are."""

MOST_LAMPS = 1024
"""Of more, each pixel would see too many."""

LAMP_WORTH = 4.0
"""Times as many points as beams, of a pixel that sees a lamp: that is brighter by far."""

MOST_PARTS = 16
"""Of the lens, for a pixel; what more targets bring is left to points of the whole lens."""

LEAST_HALF = 1e-7
"""Radii of the lens, below which points of a part are not known in float32."""

SMALL = 16.0
"""Pixels of its radius, up to which a lamp is small, however sharp."""

STRIP = 16
"""Columns that are looked at together."""


@dataclass(frozen=True, eq=False)
class Seers:
    """Which of B pixels see which targets through parts of the lens.

    index : (B,) of pixels, column * rows + row, ascending. target : (K,) numbers of those that they see, one
        pixel's after another's, which begin at first : (B + 1,).
    worth : (B,) how many points what they see is worth, relative to one another; 0 if hardly any.
    """

    index: np.ndarray
    first: np.ndarray
    target: np.ndarray
    worth: np.ndarray

    def __len__(self) -> int:
        return len(self.index)

    @property
    def count(self) -> np.ndarray:
        """(B,) targets that each sees."""
        return np.diff(self.first)

    def take(self, rows: np.ndarray) -> Seers:
        """Of some of the pixels (B',) alone."""
        count = self.count.take(rows)
        first = np.append(0, np.cumsum(count))
        at = np.arange(first[-1]) + np.repeat(self.first.take(rows) - first[:-1], count)
        return Seers(self.index.take(rows), first, self.target.take(at), self.worth.take(rows))


class LensTargets:
    """Rods with round ends, which may be balls: from ``start`` (3, T) to ``end``, of some ``radius`` (T,).

    Each is on one side of what is in focus, in front of the camera, and about as far from both all along.
    """

    def __init__(
        self, rays: CameraRays, start: np.ndarray, end: np.ndarray, radius: np.ndarray, worth: np.ndarray
    ) -> None:
        """worth : (T,) as in `Seers`."""
        self._rays, self._start, self._end, self._radius = rays, start, end, radius
        # In units of the lens, what they are seen through is about so wide to either side.
        with np.errstate(all="ignore"):
            self._half = WIDER * radius * np.max([rays.lens_scale(ends) for ends in (start, end)], axis=0)
        self._worth = worth
        # Others are seen through about all of the lens, or through less than float32 tells of it.
        self._through_part = (worth > 0) & (self._half < 1) & (self._half > LEAST_HALF)

    @staticmethod
    def of(
        rays: CameraRays,
        balls: tuple[np.ndarray, np.ndarray, float],
        rods: Iterable[tuple[np.ndarray, np.ndarray, float, float, float]] = (),
    ) -> LensTargets:
        """balls : centres (3, L) and radii (L,). rods : where each starts (3,), its unit direction, length
        and radius; what both are ``worth`` comes last. What lies behind the camera is left out.
        """
        centre, radius, worth = balls
        ahead = rays.depth(centre) + radius > rays.clip_start
        starts, ends, radii = [centre[:, ahead]], [centre[:, ahead]], [radius[ahead]]
        are_worth = [np.full(len(radii[0]), worth, float)]
        for start, direction, length, half, worth in rods:
            at = rays.stations(start, direction, length, half)
            places = start[:, None] + direction[:, None] * at
            starts.append(places[:, :-1])
            ends.append(places[:, 1:])
            radii.append(np.full(max(len(at) - 1, 0), half))
            are_worth.append(np.full(len(radii[-1]), worth, float))
        lists = np.hstack(starts), np.hstack(ends), np.concatenate(radii), np.concatenate(are_worth)
        return LensTargets(rays, *lists)

    @staticmethod
    def of_lamps(stage: CameraStage) -> LensTargets:
        """Lamps that may be seen, and are small, or seen through a part of the lens; none of too many."""
        centre, radius = stage.visible_lamps()
        if len(radius) > MOST_LAMPS:
            centre, radius = centre[:, :0], radius[:0]
        found = LensTargets.of(stage.rays, (*_together(stage.rays, centre, radius), LAMP_WORTH))
        with np.errstate(all="ignore"):
            small = found._radius * stage.rays.scale(found._start) < SMALL
        some = np.flatnonzero(found._through_part | small)
        ends = (a.take(some, axis=1) for a in (found._start, found._end))
        return LensTargets(stage.rays, *ends, found._radius.take(some), found._worth.take(some))

    def __len__(self) -> int:
        return len(self._radius)

    def seers(
        self,
        region: tuple[int, int, int, int],
        map_: Map = in_order,
        check: Callable[[], None] = lambda: None,
    ) -> Seers:
        """Of all pixels of a region (x0, y0, x1, y1), those that may see any; numbered from its corner.

        map_ : runs a function over items on the workers. check : called now and then; may raise, to give up.
        """
        x0, y0, x1, y1 = region
        with np.errstate(all="ignore"):
            (a, *wide_a), (b, *wide_b) = (
                self._rays.in_picture(p, self._radius) for p in (self._start, self._end)
            )
            slant, unit, blur = (np.maximum(*both) for both in zip(wide_a, wide_b, strict=True))
            wide = 1 + self._radius * slant * unit + blur
            # That of which nothing is known may be anywhere.
            anywhere = ~(np.isfinite(a) & np.isfinite(b)).all(axis=0) | ~(wide < FARTHEST)
        wide = np.where(anywhere, np.inf, wide)
        a, b = (np.where(anywhere, 0.0, p) for p in (a, b))

        def of_strip(low: int) -> Seers:
            check()
            return self._of_strip((low, y0, min(low + STRIP, x1), y1), a, b, wide)

        parts = map_(of_strip, range(x0, x1, STRIP))
        index = [part.index + STRIP * n * (y1 - y0) for n, part in enumerate(parts)]
        count = np.concatenate([part.count for part in parts])
        return Seers(
            np.concatenate(index),
            np.append(0, np.cumsum(count)),
            np.concatenate([part.target for part in parts]),
            np.concatenate([part.worth for part in parts]),
        )

    def _of_strip(
        self, region: tuple[int, int, int, int], a: np.ndarray, b: np.ndarray, wide: np.ndarray
    ) -> Seers:
        """`seers` of rods from ``a`` to ``b`` (2, T) in the picture, ``wide`` (T,) to all sides."""
        x0, y0, x1, y1 = region
        x, y = np.arange(x0, x1)[:, None] + 0.5, np.arange(y0, y1) + 0.5
        index, target = [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]
        # Of each rod, what is next to the region: far away, its ends are not known to a pixel.
        first, last = np.zeros(len(wide)), np.ones(len(wide))
        with np.errstate(divide="ignore", invalid="ignore"):
            for start, end, least, most in zip(a, b, (x0, y0), (x1, y1), strict=True):
                enter = (least - wide - start) / (end - start), (most + wide - start) / (end - start)
                still = start == end
                beside = still & ((start < least - wide) | (start > most + wide))
                first = np.where(still, first, np.fmax(first, np.fmin(*enter)))
                last = np.where(beside, -1.0, np.where(still, last, np.fmin(last, np.fmax(*enter))))
        for number in np.flatnonzero(first <= last):
            if np.isinf(wide[number]):
                found = np.arange(x.size * y.size)
            else:
                along = b[:, number] - a[:, number]
                begin, end = (a[:, number] + at[number] * along for at in (first, last))
                span, square = end - begin, float((end - begin) @ (end - begin))
                across, down = x - begin[0], y - begin[1]
                t = np.clip((across * span[0] + down * span[1]) / square, 0, 1) if square > 0 else 0.0
                near = np.hypot(across - t * span[0], down - t * span[1]) <= wide[number]
                found = np.flatnonzero(near)
            if found.size:
                index.append(found)
                target.append(np.full(len(found), number))
        index, target = np.concatenate(index), np.concatenate(target)
        # The smallest parts of the lens first.
        order = np.lexsort((np.where(self._through_part, self._half, np.inf).take(target), index))
        index, target = index.take(order), target.take(order)
        starts = np.flatnonzero(np.diff(index, prepend=-1))
        rank = np.arange(len(index)) - np.repeat(starts, np.diff(np.append(starts, len(index))))
        through_part = self._through_part.take(target) & (rank < MOST_PARTS)
        worth = np.maximum.reduceat(self._worth.take(target), starts) if starts.size else np.zeros(0)
        first = np.append(0, np.cumsum(through_part))[np.append(starts, len(index))]
        return Seers(index.take(starts), first, target[through_part], worth)

    def points(self, pixels: Pixels, seers: Seers, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (4, B, S) of pixels' unit squares and of the lens, and their weights (B, S).

        seers : of the B pixels, in their order; all of parts of the lens, or none. u : (4, B, S) uniform.
        """
        if len(seers.target) == 0:
            return u, np.ones(u.shape[1:])
        place, count = u[:2], seers.count
        number = np.repeat(np.arange(len(pixels)), count)  # of the pixel, of each pair of it and a target
        of_pair = Pixels(*(a.take(number) for a in (pixels.x, pixels.y, pixels.cell)))
        parts = _Parts.of(self._rays, of_pair, place[:, number], *(
            a.take(seers.target, axis=-1) for a in (self._start, self._end, self._half)
        ))  # fmt: skip
        share = ((1 - PLAIN) / np.maximum(count, 1))[:, None]
        # Of which kind each is: of the whole lens, or of one of the parts.
        kind = (u[2] - PLAIN) / share
        within, kind = np.modf(np.maximum(kind, 0))
        kind = np.minimum(kind.astype(np.intp), count[:, None] - 1)
        pair = seers.first[:-1, None] + kind
        column = np.broadcast_to(np.arange(u.shape[2]), pair.shape)
        of_part = (u[2] >= PLAIN) & parts.use[pair, column]
        spread = parts.at(pair[of_part], column[of_part], within[of_part], u[3][of_part])
        lens = self._rays.on_lens(np.stack([np.where(u[2] < PLAIN, u[2] / PLAIN, within), u[3]]))
        lens[:, of_part] = spread
        inverse = np.add.reduceat(
            np.where(parts.use, parts.hold(lens[:, number]) * (self._rays.lens_area / parts.area), 1),
            seers.first[:-1], axis=0,
        )  # fmt: skip
        on_lens, inside = self._rays.square_of_lens(lens)
        return np.concatenate([place, on_lens]), inside / (PLAIN + share * inverse)


def _together(rays: CameraRays, centre: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centres (3, L) and radii (L,) of balls, but one ball about all that touch, where that is seen through a
    part of the lens as well.
    """
    apart = np.linalg.norm(centre[:, :, None] - centre[:, None], axis=0)
    touch = apart <= radius[:, None] + radius
    group, before = np.arange(len(radius)), None
    while before is None or (group != before).any():
        before, group = group, np.where(touch, group, len(group)).min(axis=1, initial=len(group))
        group = group.take(group)
    number, group = np.unique(group, return_inverse=True)
    group = group.ravel()
    middle = np.stack([np.bincount(group, c, len(number)) for c in centre]) / np.bincount(group)
    reach = np.zeros(len(number))
    np.maximum.at(reach, group, np.linalg.norm(centre - middle[:, group], axis=0) + radius)
    with np.errstate(divide="ignore", over="ignore"):
        small = WIDER * reach * rays.lens_scale(middle) < 1
    alone = ~small[group]
    return np.hstack([middle[:, small], centre[:, alone]]), np.append(reach[small], radius[alone])


@dataclass(eq=False)
class _Parts:
    """Rectangles of the lens, of M pairs of a pixel and a target, at S places of the pixel each.

    low, high : (2, M, S) along the ``axis`` (2, M, S) and across. use : (M, S) bool, which are worth it.
    """

    axis: np.ndarray
    low: np.ndarray
    high: np.ndarray
    area: np.ndarray
    use: np.ndarray

    @staticmethod
    def of(
        rays: CameraRays,
        pixels: Pixels,
        place: np.ndarray,
        start: np.ndarray,
        end: np.ndarray,
        half: np.ndarray,
    ) -> _Parts:
        a, b = (rays.seen_at(p, pixels.x, pixels.y, place) for p in (start, end))
        along = b - a
        length = np.hypot(*along)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            axis = np.where(length > 1e-12, along / length, np.array([1.0, 0.0])[:, None, None])
            half = np.broadcast_to(half[:, None], length.shape)
            # Where the lens' middle is, from the start.
            middle = np.stack([-(a * axis).sum(axis=0), a[0] * axis[1] - a[1] * axis[0]])
            across = np.maximum(-half, middle[1] - 1), np.minimum(half, middle[1] + 1)
            off = np.clip(middle[1], *across) - middle[1]
            chord = np.sqrt(np.maximum(1 - off * off, 0))
            low = np.stack([np.maximum(-half, middle[0] - chord), across[0]])
            high = np.stack([np.minimum(length + half, middle[0] + chord), across[1]])
            low, high = low - middle, high - middle
            size = high - low
            area = size[0] * size[1]
            use = (size > 0).all(axis=0) & (area < 4 * LARGE)
        return _Parts(axis, low, high, np.where(use, area, 1), use)

    def at(self, row: np.ndarray, column: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(2, N) points of rectangles, by u and v (N,)."""
        low, high, (x, y) = (a[:, row, column] for a in (self.low, self.high, self.axis))
        along, across = low + (high - low) * np.stack([u, v])
        return np.stack([along * x - across * y, along * y + across * x])

    def hold(self, lens: np.ndarray) -> np.ndarray:
        """(M, S) bool, whether points (2, M, S) of the lens are in them."""
        x, y = self.axis
        at = np.stack([lens[0] * x + lens[1] * y, lens[1] * x - lens[0] * y])
        return ((at >= self.low) & (at <= self.high)).all(axis=0)
