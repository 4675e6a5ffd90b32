# SPDX-License-Identifier: GPL-3.0-or-later
"""Which light a sample of the fog along a ray goes to.

As `light_choice` for surfaces, but in proportion to a quick estimate of what each light, unshadowed, would
scatter from a whole segment of a camera ray,

    integral from start to end of exp(-extinction (t - start)) exp(-leg r) strength / r^2 dt.

Without extinction that is the angle that the light sees the segment under, over its distance D from the ray
(thesis eq. 6.5); segments are cut by the cone of a spot or area light first. Of many lights few are weighed
for every segment, those that pilot rays through a cell of the picture find to stand for all: see
`light_clusters.Clusters`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..geometry.vectors import dot, length, take
from .light_choice import _BELOW_ONE, CandidateLights, Choice, WeighedLights
from .light_clusters import CELL, Clusters, weighed_clusters
from .light_estimates import Lights
from .long_lights import past

WEIGHED = 32
"""How many lights are all weighed for every segment."""

WEIGHED_FLAT = 64
"""The same where one is flat: two rays of a cell see those so differently that none stands for others."""

# Lights x segments evaluated at once, so that the temporary arrays stay in the cache.
_CHUNK = 1 << 15

# What no length exceeds, so that float32 has room for its square, and that square times another.
_FAR = np.float32(1e9)
_LARGEST = np.float32(1e30)

# What part of a flat light's most intensity is expected of it at any angle.
_LEAST = np.float32(0.01)

# How near a ray a light can be, as a part of its distance: nearer, float32 has no digits.
_NEAREST = np.float32(1e-6)


class RaySegments(NamedTuple):
    """Parts (...) of rays in fog, packed as what chooses lights takes them: see `segments`."""

    place: np.ndarray
    direction: np.ndarray

    def reshape(self, *shape: int) -> RaySegments:
        return RaySegments(*(x.reshape(len(x), *shape) for x in self))


def segments(
    origin: np.ndarray,
    direction: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
    extinction: np.ndarray,
    leg: np.ndarray | float = 0.0,
) -> RaySegments:
    """Segments from ``start`` to ``end`` (...) of rays ``origin``, ``direction`` (3, ...), which is unit.

    extinction : (...) of the fog there, leg : of all space, on the way from a light; each the least of all
    channels, as these say what fog does not let through.
    """
    start, end, extinction, leg = (
        np.clip(x, 0, _FAR) for x in np.broadcast_arrays(start, end, extinction, leg)
    )
    return RaySegments(
        np.concatenate([origin, np.stack([start, end, extinction, leg])]).astype(np.float32),
        np.asarray(direction, np.float32),
    )


class AirLights:
    """Lights as segments see them, in the place of `Lights` for what chooses among these.

    only : (L,) ascending numbers of the lights that are meant.
    are_few : whether all are weighed for every segment.
    core, thickness : (3, L) of what is longer than wide, half of its length, as in `long_lights`, else 0; and
        (L,) how wide lights are, about. long : (L,) bool, whether there is a core.
    coned : (L,) bool, whether all that a light shines on is in a cone of at most a half space, which has its
    apex (3, L) behind the light, an axis (3, L), and cos (L,) of half its angle; float32.
    """

    def __init__(
        self, lights: Lights, only: np.ndarray | None = None, clear: np.ndarray | None = None
    ) -> None:
        """clear : (L,) bool of all lights, between which and what they light is no fog; None if none are."""
        self.only = np.arange(len(lights)) if only is None else np.asarray(only, np.intp)
        self._clear = np.zeros(len(self), bool) if clear is None else clear.take(self.only)
        axis, cos, brightness = np.zeros((3, len(lights))), np.full(len(lights), -1.0), np.zeros(len(lights))
        core, thickness = np.zeros((3, len(lights))), lights.reach.copy()
        flat, turns = np.zeros((2, len(lights)), bool)
        for group, start, stop in zip(lights.groups, lights.first[:-1], lights.first[1:], strict=True):
            brightness[start:stop] = group.far_fluence
            if group.cone_cos is not None:
                axis[:, start:stop], cos[start:stop] = group.cone_axis, group.cone_cos
            if group.skewed is not None:
                cos[start:stop][group.skewed] = -1
            if group.is_flat:
                flat[start:stop], self._flat_group, self._first_flat = True, group, start
                core[:, start:stop], thickness[start:stop] = group.core, group.thickness
            if group.is_mesh:
                turns[start:stop], self._mesh, self._first_of_mesh = True, group, start
        self._far_off = np.isinf(lights.reach.take(self.only))
        cos = cos.take(self.only)
        self.coned, self._flat, self._turns = cos >= 0, flat.take(self.only), turns.take(self.only)
        reach = np.where(self._far_off, 0, lights.reach.take(self.only))
        centre, axis = take(lights.centre, self.only), take(axis, self.only)
        # The cone that holds all points' cones begins behind the light: about its sphere, or its rim if flat.
        cos = np.clip(cos, 0, 1)
        sin = np.maximum(np.sqrt(1 - cos * cos), 1e-3)
        apex = centre - reach * np.where(self._flat, cos, 1) / sin * axis
        most = 0.3 * _FAR
        self._centre, self.apex, self.axis, self.cos, self._reach = (
            np.clip(x, -most, most).astype(np.float32) for x in (centre, apex, axis, cos, reach)
        )
        # No narrower than they are.
        self.cos = np.nextafter(self.cos, np.float32(0))
        core, thickness = take(core, self.only), np.where(self._far_off, 0, thickness.take(self.only))
        self.core, self.thickness = (np.clip(x, -most, most).astype(np.float32) for x in (core, thickness))
        self.long = dot(self.core, self.core) > 0
        # All of a light with a narrow spread shines on a place, or none.
        self._beside_core = np.maximum(self._reach - np.where(self.cos > 0.1, 0, length(self.core)), 0)
        self.are_few = len(self) <= (WEIGHED_FLAT if self._flat.any() else WEIGHED)
        self._brightness = np.minimum(brightness.take(self.only), _LARGEST).astype(np.float32)

    def __len__(self) -> int:
        return len(self.only)

    def irradiance(
        self, place: np.ndarray, direction: np.ndarray, which: np.ndarray | None = None
    ) -> np.ndarray:
        """(L', M) estimates for segments (7, M), (3, M) of all lights, or of ``which`` (L',)."""
        which = np.arange(len(self)) if which is None else which
        step = max(1, _CHUNK // max(len(which), 1))
        parts = [
            self._estimate(place[:, first : first + step], direction[:, first : first + step], which)
            for first in range(0, place.shape[1], step)
        ]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def irradiance_of_all(
        self, place: np.ndarray, direction: np.ndarray, which: np.ndarray, between: Callable[[], None]
    ) -> np.ndarray:
        """(M,) float64 sums of the estimates of lights ``which`` (L',), whose array is never whole.

        between : called now and then; may raise, to give up.
        """
        step, found = max(1, _CHUNK // max(len(which), 1)), np.zeros(place.shape[1])
        for first in range(0, len(found), step):
            between()
            part = slice(first, first + step)
            found[part] = self._estimate(place[:, part], direction[:, part], which).sum(axis=0)
        return found

    def _estimate(self, place: np.ndarray, direction: np.ndarray, which: np.ndarray) -> np.ndarray:
        start, end, extinction, leg = place[3:]
        near = np.flatnonzero(~self._far_off.take(which))
        far = np.flatnonzero(self._far_off.take(which))
        estimate = np.empty((len(which), place.shape[1]), np.float32)
        if near.size:
            legs = leg
            if self._clear.any():
                legs = leg * ~self._clear.take(which.take(near))[:, None]
            estimate[near] = self._near(which.take(near), place[:3], direction, start, end, extinction, legs)
        if far.size:
            # What fog lets through along the segment; where it fills all space, no light comes from far off.
            length = np.maximum(end - start, 0)
            estimate[far] = length / (1 + extinction * length)
            estimate[far] *= (leg == 0) | self._clear.take(which.take(far))[:, None]
        estimate *= self._brightness.take(which)[:, None]
        return np.minimum(estimate, _LARGEST, out=estimate)

    def _near(self, which, origin, direction, start, end, extinction, leg) -> np.ndarray:
        """(L', M) estimates of lights of finite distance, for unit strength."""
        to_light, foot, square = self._seen(self._centre, which, origin, direction)
        thickness = self.thickness.take(which)[:, None]
        floor = _NEAREST * foot
        square = np.maximum(square, floor * floor)
        # A light of some size has no more to give the nearer it is.
        square += np.maximum(thickness * thickness, np.float32(1e-36))
        long, of_nearest = np.flatnonzero(self.long.take(which)), foot
        if long.size:
            core, vector = take(self.core, which.take(long))[:, :, None], to_light[:, long]
            square[long], near, along = past(core, vector, foot[long], direction[:, None, :], square[long])
            of_nearest = foot.copy()
            of_nearest[long] += near * along
        low, high = np.broadcast_to(start, foot.shape), np.broadcast_to(end, foot.shape)
        coned = np.flatnonzero(self.coned.take(which))
        if coned.size:
            low, high = low.copy(), high.copy()
            first, last = self._lit(which.take(coned), origin, direction)
            low[coned] = np.minimum(np.maximum(low[coned], first), _FAR)
            high[coned] = np.minimum(high[coned], last)
        high = np.maximum(high, low)
        if long.size:
            # What runs beside a light passes it as long as that is.
            here, along = foot[long], np.abs(along)
            foot = foot.copy()
            foot[long] += np.clip(np.clip(here, low[long], high[long]) - here, -along, along)
        # By the segment's fog, from its start on, and by that of all space, from the light: the integral's
        # two humps are where it begins, and where it is nearest to the light.
        nearest = np.clip(foot, low, high)
        x, middle = low - foot, nearest - foot
        at_start = np.exp(-(extinction * (low - start) + leg * np.sqrt(square + x * x)))
        at_middle = np.exp(-(extinction * (nearest - start) + leg * np.sqrt(square + middle * middle)))
        range_ = 1 / np.maximum(extinction, 1 / _FAR)
        beyond = 1 / np.maximum(extinction + leg, 1 / _FAR)
        ends = np.minimum(high, low + range_), np.minimum(high, nearest + beyond)
        humps = [
            at * _angle(square, x, end - foot) for at, end in zip((at_start, at_middle), ends, strict=True)
        ]
        flat = np.flatnonzero(self._flat.take(which))
        if flat.size:
            for hump, end in zip(humps, ends, strict=True):
                # The cone's ends are dark, but where the light is nearest counts.
                off = np.minimum(0.25 * (end[flat] - low[flat]), np.sqrt(square[flat]))
                t = np.clip(of_nearest[flat], low[flat] + off, end[flat] - off)
                hump[flat] *= self._falloff(which.take(flat), t * direction[:, None, :] - to_light[:, flat])
        estimate = np.maximum(*humps, out=humps[0])
        turning = np.flatnonzero(self._turns.take(which))
        if turning.size:
            vector = nearest[turning] * direction[:, None, :] - to_light[:, turning]
            number = self.only.take(which.take(turning)) - self._first_of_mesh
            estimate[turning] *= self._mesh.facing(number[:, None], vector, direction[:, None, :])
        return estimate

    @staticmethod
    def _seen(
        table: np.ndarray, which: np.ndarray, origin: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vectors (3, L', M) from the origins to points, where rays pass them, squared distances of that."""
        vector = take(table, which)[:, :, None] - origin[:, None, :]
        foot = dot(vector, direction[:, None, :])
        beside = vector - foot * direction[:, None, :]
        return vector, foot, dot(beside, beside)

    def _lit(
        self, which: np.ndarray, origin: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(L', M) from where to where rays are within lights' cones; the first is the larger if never."""
        vector, foot, square = self._seen(self.apex, which, origin, direction)
        axis, cos = take(self.axis, which)[:, :, None], self.cos.take(which)[:, None]
        slope = dot(axis, direction[:, None, :])
        # At the foot, along the axis.
        height = foot * slope - dot(axis, vector)
        a = slope * slope - cos * cos
        a = np.copysign(np.maximum(np.abs(a), np.float32(1e-12)), a)
        radicand = height * height + square * a
        root = cos * np.sqrt(np.maximum(radicand, 0))
        one, other = (-height * slope - root) / a, (-height * slope + root) / a
        wide = a > 0
        first = np.where(wide, np.where(slope > 0, other, -_FAR), np.minimum(one, other))
        last = np.where(wide, np.where(slope > 0, _FAR, one), np.maximum(one, other))
        # What runs steeper than the cone meets it twice, or its mirror image, or nothing.
        never = ~wide & ((radicand < 0) | (height <= 0))
        return np.where(never, _FAR, foot + first), np.where(never, -_FAR, foot + last)

    def _falloff(self, which: np.ndarray, vector: np.ndarray) -> np.ndarray:
        """(L', M) of flat lights towards points at ``vector`` (3, L', M) from them; never quite dark."""
        number = (self.only.take(which) - self._first_flat)[:, None]
        long = np.flatnonzero(self.long.take(which))
        if long.size:
            # From the place that is behind the point.
            core, there = take(self.core, which.take(long))[:, :, None], vector[:, long]
            there -= np.clip(dot(core, there) / dot(core, core), -1, 1) * core
            vector[:, long] = there
        cosine = dot(take(self.axis, which)[:, :, None], vector)
        inverse = 1 / np.sqrt(np.maximum(dot(vector, vector), np.float32(1e-30)))
        cosine *= inverse
        size = np.minimum(self._beside_core.take(which)[:, None] * inverse, 1)
        cosine += size
        cosine /= 1 + size
        group = self._flat_group
        least = _LEAST * group.falloff(number, np.ones(number.shape, np.float32))
        return group.falloff(number, np.clip(cosine, 0, 1)) + least


def _angle(square: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Integral of 1 / (square + x^2) from ``low`` to ``high``, at most 22 % too small.

    That is angle / D; the angle 2 atan(s) of s = tan(angle / 2) is taken for 2 s / (1 + 2 s / pi).
    """
    step = np.maximum(high - low, 0)
    below = np.sqrt((square + low * low) * (square + high * high)) + square + low * high
    return 2 * step / (np.maximum(below, 0) + np.float32(2 / np.pi) * np.sqrt(square) * step)


class CellsOfPicture(NamedTuple):
    """The cells of a rectangle, row by row: column and row of the first, and how many columns and rows."""

    first: tuple[int, int]
    count: tuple[int, int]

    @classmethod
    def of(cls, x: np.ndarray, y: np.ndarray) -> CellsOfPicture:
        """Of cells' columns and rows (K,)."""
        first = int(x.min()), int(y.min())
        return cls(first, (int(x.max()) - first[0] + 1, int(y.max()) - first[1] + 1))

    def drawn(self, place: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cells (N,) for places (2, N) in pixels, by w (N,), and what that left of it.

        Each of the four whose middles are around has a chance, the nearer the more. With those of one
        cell for all of its pixels, what a net is wrong by would end at the cells' edges, and be seen there.
        """
        cell, w = np.zeros(w.shape, np.intp), w.astype(np.float64)
        for axis in (1, 0):
            at = place[axis].astype(np.float64) / CELL - 0.5 - self.first[axis]
            low = np.floor(at)
            part = at - low
            second = w < part
            w -= np.where(second, 0, part)
            w /= np.where(second, part, 1 - part)
            index = np.clip(low + second, 0, self.count[axis] - 1).astype(np.intp)
            cell = cell * self.count[axis] + index
        return cell, np.clip(w, 0, _BELOW_ONE).astype(np.float32)


class FogChoice:
    """A discrete distribution over lights for every segment, in which none of them has no chance."""

    def __init__(
        self,
        lights: AirLights,
        clusters: list[Clusters] | None = None,
        cells: CellsOfPicture | None = None,
    ) -> None:
        """clusters : of each of ``cells``, by `fog_clusters`; None for few lights."""
        self._lights, self.cells = lights, cells
        self._choice = (
            WeighedLights(lights, unlikely=np.float32(1))
            if clusters is None
            else CandidateLights(lights, clusters)
        )

    def choose(self, where: RaySegments, cell: np.ndarray | None, w: np.ndarray) -> Choice:
        """Lights (M * S,), their probabilities, and ``w`` (M, S) stretched over what was chosen.

        where : M segments. cell : (M,) of these. w : uniform in (0, 1).
        """
        light, chance, w = self._choice.choose(*where, cell, w)
        return self._lights.only.take(light), chance, w

    def pdf(self, light: np.ndarray, where: RaySegments, cell: np.ndarray | None) -> np.ndarray:
        """(N,) probabilities with which `choose` takes ``light`` (N,) for segments (N,) of ``cell`` (N,)."""
        return self._choice.pdf(np.searchsorted(self._lights.only, light), *where, cell)


def fog_clusters(
    lights: AirLights, where: RaySegments, found: np.ndarray, between: Callable[[], None] = lambda: None
) -> list[Clusters] | None:
    """The clusters of lights in K cells, None where all lights can be weighed for every segment.

    where : segments (K, P), P pilots a cell. found : (K, P) bool, which of them are in fog.
    between : called now and then; may raise, to give up.
    """
    if lights.are_few:
        return None
    return weighed_clusters(lights, *where, found.astype(np.float32), between)
