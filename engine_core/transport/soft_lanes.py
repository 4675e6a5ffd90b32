# SPDX-License-Identifier: GPL-3.0-or-later
"""Lanes to points of small lights: balls, disks that face the fog, and suns.

From every place x of a ray a light fills a cone of directions, which `emitters.points` samples evenly. A
lane keeps one place (p, q) in the unit disk: its direction turns with x as the cone does, in a frame in which
the ray and the light's centre lie in a plane, so that all is smooth in x. From a distance d, fluence hangs on
nothing but that: it is what a light without size would have, times

    2 (1 - cos a) d^2 / r^2,     sin a = r / d of a ball, tan a = r / d of a disk.

A sun's direction is the same everywhere, and its fluence, too. So all that is left to chance is where
shadows are, and cones of spots. Lights' opposite points see these to either side of where the centre does, by
as much, and their mean errs by the square of that alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ..geometry.vectors import dot, take
from ..geometry.warps import basis, cap, concentric_disk, sin_sqr_to_one_minus_cos
from ..integration.sobol import hash_combine, unit_float
from .bare_lights import BALL, BARE, DISK, POINT, SPOT, SUN, BareLights
from .fog_lanes import (
    SHORT,
    AboutPoints,
    FogSegments,
    Lanes,
    TowardsSuns,
    columns,
    within_cones,
)
from .line_integrals import wrapped

_GOLDEN = (5**0.5 - 1) / 2

_NEXT_TO_NOTHING = np.float32(1e-30)

_WIDEST = np.float32(1 - 1e-6)
"""1 - cosine to a point of a disk, at most."""


class AboutSmall(AboutPoints, ABC):
    """Lanes to points of balls and disks, of lights and of spots."""

    def _choose_points(self, aside):
        n, along, foot = len(self), self.along, self._foot
        u = _of_rays(self._segments, self._lights, self.segment, self.light)
        self.turn = _turns(self._lights, self.light, n)
        if self.several is not None:
            # A lattice of them.
            u[0] += (self._pair / self.several).astype(np.float32)
            u[1] += (self._pair * _GOLDEN).astype(np.float32)
            self.turn = ((self._pair + self.turn) / self.several).astype(np.float32)
        self._place = np.stack(concentric_disk(*_opposite(self._lights, self.light, u)))
        self._aside = aside.astype(np.float32)
        # The ray's direction, that from the light to its foot, and their normal: of the line through the
        # centre any will do.
        length = np.sqrt(dot(foot, foot))
        any_foot, _ = basis(along)
        self._across = np.where(length > 0, foot / np.maximum(length, np.float32(1e-37)), any_foot)
        self._normal = np.cross(along, self._across, axis=0)
        self._radius = np.broadcast_to(self._lights.radius.take(self.light), n).astype(np.float32)
        self._from = (take(self._lights.position, self.light) + foot).astype(np.float32)
        if self._cone is not None:
            # To the lights' own spaces.
            axes = [-take(row, self.light) for row in self._lights.axes]
            frame = (along, self._across, self._normal)
            self._own = np.array([[dot(row, v) for v in frame] for row in axes], np.float32)

    def _dimming(self, at_foot, along, below, sharpness, low, high):
        # The cone begins elsewhere, and that depends on where it is seen from.
        places, moved = [], []
        begins, ends = within_cones(at_foot, along, below, low, high)
        for x in (np.where(ends > begins, begins, low), np.where(ends > begins, ends, high)):
            vectors, *_ = self._vectors(x.astype(np.float32))
            vectors[0] += x
            vectors[1] += self._aside
            moved.append(at_foot - np.stack([dot(row, vectors) for row in self._own]))
        for cone in (below, below - 1 / sharpness):
            begins, ends = (within_cones(m, along, cone, low, high)[i] for i, m in enumerate(moved))
            places += [np.where(ends > begins, x, low) for x in (begins, ends)]
        return places

    @abstractmethod
    def _vectors(self, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """Of places x (..., n) of the rays: vectors (3, ..., n) to the lanes' points of lights, by the frame
        of ray, foot and normal; (..., n) their lengths, those to the centres, and those softened by the
        radius, of which `_distance` is the least; and fluence, over the inverse square of the last.
        """

    def smooth(self, s):
        m, p, s = self._at(s)
        vectors, reach, d, soft, scale = self._vectors(self._x(m, p))
        scale *= 4 / (p * p + m * m)
        if self._cone is not None:
            scale *= self._in_cone(vectors, d)
        path = s / p
        path *= self._over_p
        open_ = np.zeros(0, np.intp) if self._closed is True else np.flatnonzero(~self._closed)
        if open_.size:
            ahead = path + self._over_m * s / m
            path = np.where(self._closed, 2 * path + (reach - soft), ahead)
        else:
            path *= 2
            path += reach - soft
        depth = columns(self.sigma, path.ndim) * path
        if open_.size:
            ahead = take(ahead.reshape(-1, len(self)), open_)
            position = take(self.begin, open_)[:, None] + take(self.along, open_)[:, None] * ahead
            to_light = self._in_space(take(vectors.reshape(3, -1, len(self)), open_), open_)
            legs = self._legs(position, to_light, 1.0, open_)
            depth.reshape(len(depth), -1, len(self))[:, :, open_] += legs
        np.negative(depth, out=depth)
        value = np.exp(depth, out=depth)
        value *= scale
        less = more = None
        if self._segments.anisotropy.any():
            vectors /= np.maximum(reach, _NEXT_TO_NOTHING)
            square = vectors[1] * vectors[1]
            square += vectors[2] * vectors[2]
            less, more = ((np.square(1 - sign * vectors[0]) + square) / 4 for sign in (1, -1))
        return self._phases(value, less, more)

    def _in_cone(self, vectors: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Of spots, as `AboutPoints._attenuation`, by vectors to them. d : to their centres."""
        u, v, z = (-dot(rows, vectors) for rows in self._own)
        return self._smoothstep(u, v, z)

    def _in_space(self, vectors: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
        """(3, ...), of vectors by ray, foot and normal of lanes ``rows``, None for all."""
        frame = [v if rows is None else take(v, rows) for v in (self.along, self._across, self._normal)]
        out = np.empty_like(vectors)
        for i, row in enumerate(out):
            np.multiply(vectors[0], frame[0][i], out=row)
            row += vectors[1] * frame[1][i]
            row += vectors[2] * frame[2][i]
        return out

    def seen(self, s, look):
        m, p, s = self._at(s)
        x = self._x(m, p)
        to_light = self._in_space(self._vectors(x)[0])
        vector, origin = np.empty((2, *x.shape, 3), np.float32)
        if self._far:
            ahead = self._over_p * s / p + self._over_m * s / m
            for i in range(3):
                origin[..., i] = self.begin[i] + self.along[i] * ahead
                vector[..., i] = to_light[i]
            reach = 1.0
        else:
            for i in range(3):
                np.multiply(x, self.along[i], out=origin[..., i])
                origin[..., i] += self._from[i]
                origin[..., i] += to_light[i]
                np.negative(to_light[i], out=vector[..., i])
            reach = SHORT
        return self._visible(look, origin, vector, reach)


class AboutDisks(AboutSmall):
    """The same of disks that face the fog (`emitters.DiskEmitters`)."""

    is_cut = True

    def _vectors(self, x):
        aside, (p, q) = self._aside, self._place
        r = self._radius * self._radius
        square = x * x + aside * aside
        d = np.sqrt(square)
        square += r
        rim = np.sqrt(square)
        one_minus_cos = r / (rim * (rim + d))
        # A light that is as near as nothing fills a half space.
        below = np.minimum((p * p + q * q) * one_minus_cos, _WIDEST)
        reach = d / (1 - below)
        across = np.sqrt(one_minus_cos * (2 - below))
        across *= reach
        vectors = np.empty((3, *x.shape), np.float32)
        np.multiply(q, across, out=vectors[2])
        across *= p / d
        np.multiply(across, aside, out=vectors[0])
        vectors[0] -= x
        np.multiply(across, -x, out=vectors[1])
        vectors[1] -= aside
        return vectors, reach, d, rim, 2 * rim / (rim + d)


class AboutBalls(AboutSmall):
    """The same of balls (`emitters.SphereEmitters`); from within one, it is all around."""

    def _vectors(self, x):
        aside, (p, q) = self._aside, self._place
        square = x * x + aside * aside
        d = np.sqrt(square)
        r = self._radius * self._radius
        inside = square <= r
        one_minus_cos = sin_sqr_to_one_minus_cos(np.minimum(r / square, 1))
        one_minus_cos = np.where(inside, np.float32(2), one_minus_cos)
        # As `warps.cap`.
        below = (p * p + q * q) * one_minus_cos
        scale = np.sqrt(one_minus_cos * (2 - below))
        chord = np.sqrt(np.maximum(r - square * (below * (2 - below)), 0))
        cos = 1 - below
        reach = d * cos + np.where(inside, chord, -chord)
        far = reach / d
        across, ahead = p * scale * far, cos * far
        vectors = np.empty((3, *x.shape), np.float32)
        np.multiply(across, aside, out=vectors[0])
        vectors[0] -= ahead * x
        np.multiply(across, -x, out=vectors[1])
        vectors[1] -= ahead * aside
        np.multiply(q * scale, reach, out=vectors[2])
        soft = square + r
        fluence = soft / np.where(inside, r / 4, square * (1 - one_minus_cos / 2))
        return vectors, reach, d, np.sqrt(soft), fluence

    def _in_cone(self, vectors, d):
        # Within a ball there is no cone, as in Cycles.
        return np.where(d <= self._radius, 1, super()._in_cone(vectors, d))


class TowardsDisks(TowardsSuns):
    """Lanes to points of suns that fill an angle."""

    def _directions(self):
        axis, sine = (take(x, self.light) for x in (self._lights.position, self._lights.radius))
        u = _of_rays(self._segments, self._lights, self.segment, self.light)
        self.turn = _turns(self._lights, self.light, len(self))
        x, y, below = cap(*_opposite(self._lights, self.light, u), sin_sqr_to_one_minus_cos(sine * sine))
        s, t = basis(axis)
        return x * s + y * t + (1 - below) * axis


def _of_rays(segments: FogSegments, lights: BareLights, segment: np.ndarray, light: np.ndarray) -> np.ndarray:
    """(2, n) float32, where lanes have their points: of a ray for all lights, moved for each."""
    u = segments.lamp
    if u is None:
        u = np.stack([unit_float(hash_combine(segments.bits, i)) for i in range(2)])
    return take(u, segment) + take(lights.lamp, light).astype(np.float32)


def _turns(lights: BareLights, light: np.ndarray, count: int) -> np.ndarray:
    """(count,) of pairs, as `Lanes.turn`."""
    opposite = lights.opposite.take(light)
    return np.broadcast_to(np.where(opposite, np.float32(0.5), np.float32(0)), count)


def _opposite(lights: BareLights, light: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(2, n) u (2, n) modulo 1, or, of half of the pairs, what is opposite to that: on a disk, too."""
    u = wrapped(u)
    return np.where(lights.opposite.take(light), 1 - u, u)


LANES: dict[tuple[int, int], type[Lanes]] = {
    (POINT, BARE): AboutPoints,
    (POINT, DISK): AboutDisks,
    (POINT, BALL): AboutBalls,
    (SPOT, BARE): AboutPoints,
    (SPOT, DISK): AboutDisks,
    (SPOT, BALL): AboutBalls,
    (SUN, BARE): TowardsSuns,
    (SUN, DISK): TowardsDisks,
}
"""Of lights of each kind and shape."""
