# SPDX-License-Identifier: GPL-3.0-or-later
"""A group of lights of one kind, which is sampled and met at once.

A light has a *strength*, its radiance times its size (the area that faces a viewer; a sun's solid
angle), which is finite for a light without size. A sample is a vector to a point of the light and a
*measure*: what the strength must be multiplied with, besides the surface's cosine, to give irradiance;
that is the light's own cosine, the change of variables to solid angle and one over pdf and size,
together, so that nothing singular is ever formed. A point in space has no normal (None): there
strength times measure is fluence, the integral of radiance over all directions, and maps follow solid
angle where they followed the cosine too. For MIS, `pdf` is the density of the same map per
solid angle, and `hits` are the lights that a direction of other origin meets. All lengths are in the
frame's units.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...geometry.vectors import length, take
from ...scene import Linking
from .bounds import Bounds

Sample = tuple[np.ndarray, np.ndarray]

_LARGEST = 1e37
"""What no strength or radiance exceeds, so that float32 has room for a few factors."""

FEW = 6
"""How many lights are all intersected with all rays; of more, only those whose bounds a ray crosses."""

# Lights x rays intersected at once, so that the temporary arrays stay in the cache.
_CHUNK = 1 << 16


class LightHits(NamedTuple):
    """K meetings of rays and lights; a ray may meet several lights.

    lane : (K,) which of the rays.
    light : (K,) number in the group.
    distance : (K,) float32 in lengths of the direction; 1 for what is infinitely far.
    gain : (K,) or (3, K) float32, what the light's radiance is multiplied with towards the ray's origin;
        None for 1.
    """

    lane: np.ndarray
    light: np.ndarray
    distance: np.ndarray
    gain: np.ndarray | None


class Emitters:
    """A group of lights of one kind.

    strength : (3, L) float32, radiance times size.
    radiance : (3, L) float32, inf-free; without meaning for a light without size.
    size : (L,) float64, 0 where a light has none.
    linking : of each.
    centre, reach : (3, L) and (L,) float64, the spheres that hold the lights; None for lights at infinity.
    cone_axis, cone_cos : (3, L) and (L,) float64, round cones that hold what shines from points of a light;
        the cosine is at least 0, or -1 for a light that shines to all sides. None if all do.
    core, thickness : (3, L) and (L,) float64 of flat lights: half of what they are longer than wide, and from
        how near they bring no more.
    skewed : (L,) bool of flat lights, which are no rectangle straight ahead: `hits` and cones are not quite
        theirs. None if none are.
    at_infinity : no distance. is_mesh : part of the traced triangles. is_point : none has a size.
    has_tint : strength differs with the direction, as `tint` says.
    is_flat : what it sends falls with the cosine to `cone_axis`, as `falloff` says.
    is_world : it shines from all around.
    is_background : what camera rays see of it is the background, which a transparent film leaves out.
    """

    centre: np.ndarray | None = None
    reach: np.ndarray | None = None
    core: np.ndarray | None = None
    thickness: np.ndarray | None = None
    cone_axis: np.ndarray | None = None
    cone_cos: np.ndarray | None = None
    skewed: np.ndarray | None = None
    at_infinity = False
    is_mesh = False
    is_point = False
    has_tint = False
    is_flat = False
    is_world = False
    is_background = False

    def __init__(self, strength: np.ndarray, size: np.ndarray, linking: Sequence[Linking]) -> None:
        """strength : (L, 3) float64. size : (L,) float64, 0 where a light has none."""
        self.strength = np.minimum(strength, _LARGEST).T.astype(np.float32)
        self.linking = list(linking)
        self._brightness = (self.strength / 3).sum(axis=0)
        self.size = np.asarray(size, np.float64)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            self.radiance = np.minimum(np.asarray(strength).T / self.size, _LARGEST).astype(np.float32)
        self._visible: list[int] = []
        self._sized = np.zeros(0, np.intp)
        self._bounds: Bounds | None = None

    def __len__(self) -> int:
        return self.strength.shape[1]

    @property
    def far_fluence(self) -> np.ndarray:
        """(L,) fluence, the channels' mean: of finite lights times d^2, but for a cone, and `falloff`."""
        return self._brightness

    def falloff(self, which: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        """(...) what flat lights ``which`` (...) send at an angle to the axis, over their strength."""
        raise NotImplementedError

    @property
    def visible(self) -> list[int]:
        """Which camera rays may see."""
        return self._visible

    @property
    def any_visible(self) -> bool:
        """Whether `seen` may find anything."""
        return bool(self._visible)

    def sample(
        self,
        which: np.ndarray | None,
        position: np.ndarray,
        normal: np.ndarray | None,
        w: np.ndarray,
        u: np.ndarray,
    ) -> Sample:
        """Vectors to the light (3, M) and measures (M,).

        which : (M,) index into the group, None if it has but one light.
        position, normal : (3, M) shaded points; normal None for points in space.
        w : (M,) and u : (2, M), uniform in (0, 1).
        """
        raise NotImplementedError

    def pdf(
        self, which: np.ndarray | None, position: np.ndarray, normal: np.ndarray | None, to_light: np.ndarray
    ) -> np.ndarray:
        """(M,) density per solid angle with which `sample` returns the direction of ``to_light``.

        to_light : (3, M) vectors to points of the light; of any length for lights at infinity.
        0 for a light without size.
        """
        return np.zeros(position.shape[1], np.float32)

    def hits(
        self, position: np.ndarray, directions: np.ndarray, lights: np.ndarray | None = None
    ) -> Iterator[LightHits]:
        """The lights of some size that rays meet: all along each ray, as lights hide nothing.

        position : (3, N) float32. directions : (3, N) float32, unit. lights : (L',) only these.
        """
        lights = self._sized if lights is None else lights
        if self._bounds is not None and lights.size > FEW:
            wanted = np.zeros(len(self), bool)
            wanted[lights] = True
            for lane, number in self._bounds.crossed(position, directions):
                light = self._sized.take(number)
                keep = np.flatnonzero(wanted.take(light))
                lane, light = lane.take(keep), light.take(keep)
                origin, unit = take(position, lane), take(directions, lane)
                distance, met = self._meet(light, origin, unit)
                met = np.flatnonzero(met)
                lane, light, origin, unit = (
                    lane.take(met),
                    light.take(met),
                    take(origin, met),
                    take(unit, met),
                )
                yield LightHits(lane, light, distance.take(met), self._gain(light, origin, unit))
        elif lights.size:
            step = max(256, _CHUNK // lights.size)
            for start in range(0, position.shape[1], step):
                origin, unit = position[:, start : start + step], directions[:, start : start + step]
                distance, met = self._meet(lights[:, None], origin[:, None, :], unit[:, None, :])
                row, lane = np.nonzero(met)
                light = lights.take(row)
                gain = self._gain(light, take(origin, lane), take(unit, lane))
                yield LightHits(lane + start, light, distance[met], gain)

    def met(
        self, which: np.ndarray | None, position: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Of rays that are each to meet a light of their own: (M,) distances, 1 for what is infinitely far;
        and (M,) what the light's radiance is multiplied with, but for its tint, 0 where it is not met.

        which : (M,) index into the group, None if it has but one light. position, directions : (3, M), unit.
        """
        light = np.zeros(position.shape[1], np.intp) if which is None else which
        distance, met = self._meet(light, position, directions)
        gain = self._gain(light, position, directions)
        return distance, met.astype(np.float32) if gain is None else met * gain

    def _meet(
        self, light: np.ndarray, position: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """(...) distances to ``light`` (...) along unit directions (3, ...), and whether it is met at all."""
        raise NotImplementedError

    def _gain(self, light: np.ndarray, position: np.ndarray, directions: np.ndarray) -> np.ndarray | None:
        """(K,) what the radiance of ``light`` (K,) is multiplied with along ``directions``; None for 1."""
        return None

    def tint(self, which: np.ndarray | None, to_light: np.ndarray) -> np.ndarray:
        """(3, M) what strength is multiplied with along sampled vectors, where ``has_tint``."""
        raise NotImplementedError

    def irradiance(
        self, position: np.ndarray, normal: np.ndarray, which: np.ndarray | None = None
    ) -> np.ndarray:
        """(L', M) quick, generous estimates of unshadowed irradiance, for choosing among the lights.

        Of all lights, or of ``which`` (L',). Positive wherever a light might reach the point: one of 0 is
        hardly ever sampled.
        """
        raise NotImplementedError

    def seen(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        distance: np.ndarray,
        through: Callable[[np.ndarray, np.ndarray | float], np.ndarray] | None = None,
    ) -> np.ndarray | None:
        """(3, N) radiance of lights that camera rays see before ``distance`` (N,), None if there are none.

        origins : (N, 3). directions : (N, 3) or (1, 3), of any length, in which ``distance`` is measured.
        through : which (K,) of the rays and the distances (K,) of lights -> what fog leaves of them (3, K).
        """
        if not self._visible:
            return None
        scale = length(directions.T)
        unit = np.broadcast_to(directions.T / scale, (3, len(origins)))
        limit = distance * scale
        total = np.zeros((3, len(origins)), np.float32)
        for hits in self.hits(np.ascontiguousarray(origins.T), unit, np.array(self._visible)):
            far = np.float32(np.inf) if self.at_infinity else hits.distance
            near = np.flatnonzero(far <= limit.take(hits.lane))
            lane = hits.lane.take(near)
            colour = take(self.radiance, hits.light.take(near))
            if hits.gain is not None:
                colour *= hits.gain.take(near, axis=-1)
            if through is not None:
                lengths = np.broadcast_to(scale, limit.shape).take(lane)
                colour *= through(lane, np.inf if self.at_infinity else far.take(near) / lengths)
            for channel, out in zip(colour, total, strict=True):
                # Of one ray there may be several.
                out += np.bincount(lane, channel, minlength=len(out)).astype(np.float32)
        return total

    def _column(self, table: np.ndarray, which: np.ndarray | None) -> np.ndarray:
        """Rows of a table (..., L) as a column (..., L', 1), to be met with points (..., 1, M)."""
        return of(table, which)[..., None]


def of(table: np.ndarray, which: np.ndarray | None) -> np.ndarray:
    """Rows of a group's table (..., L) for each lane; a single light is broadcast."""
    return table if which is None else take(table, which)


def vectors_to(table: np.ndarray, which: np.ndarray | None, position: np.ndarray) -> np.ndarray:
    """(3, M) float32 vectors from ``position`` to rows of ``table`` (3, L).

    Points of float64 keep their digits next to a light.
    """
    return (of(table, which) - position).astype(np.float32, copy=False)


def area_to_solid_angle(square: np.ndarray, cosine_d: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Density per solid angle of points uniform on ``area``: d^2 / (area cos), 0 edge-on or from behind.

    square : squared distance. cosine_d : cosine at the light times the distance.
    """
    seen = cosine_d > 0
    return np.where(
        seen, np.minimum(square * np.sqrt(square) / (area * np.where(seen, cosine_d, 1)), _LARGEST), 0
    ).astype(np.float32)
