# SPDX-License-Identifier: GPL-3.0-or-later
"""Where along a ray light is looked for: maps from the unit interval to a segment, and their densities.

A distance is measured from the segment's start, in the frame's units; all is in float64, as the maps are
steep near a light. What a map about a light needs of it is its *foot*, where the ray is nearest to it
(a distance from the start, that may be negative or beyond the end), and how far it is from there.

    EquiAngular        pdf ~ 1 / r^2                      thesis eq. 6.5, 6.6
    FreePath           pdf ~ exp(-sigma t), truncated     eq. 6.3, 6.4, on the segment
    UntruncatedPath    the same, that may leave it        eq. 6.3, 6.4
    Tabulated          pdf ~ 1 / r^2 times a factor that is tabulated
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

LONGEST = 69.07755278982137
"""Optical depth of what is still looked at, -log(1e-30)."""

_NEAREST = 1e-7
"""Distance of a light from the ray, as a part of the segment's range: none is taken to be nearer."""


class DistanceMap(Protocol):
    """N segments, each with a map of the unit interval onto it.

    Their parameters may be (N, 1), and what is (N,) below (N, S) then.
    """

    def sample(self, u: np.ndarray) -> np.ndarray:
        """(N,) distances at u (N,) in [0, 1]."""
        ...

    def pdf(self, t: np.ndarray) -> np.ndarray:
        """(N,) densities per length of ``sample`` at distances t (N,)."""
        ...


def within_depth(sigma: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Lengths (N,), which may be infinite, up to where fog of extinction ``sigma`` (N,) lets light come from.

    What scatters has an extinction, so that all results are finite where it is not 0.
    """
    with np.errstate(divide="ignore"):
        return np.minimum(length, LONGEST / sigma)


class EquiAngular:
    """The angle at which the light sees the point is uniform.

    C. Kulla, M. Fajardo, "Importance sampling techniques for path tracing in participating media", 2012.

    distance : (N,) that of the light, but not next to nothing.
    """

    def __init__(self, foot: np.ndarray, distance: np.ndarray, length: np.ndarray) -> None:
        """foot, distance : (N,) of the light. length : (N,), finite."""
        self._foot, self._length = foot, length
        beyond = length - foot
        reach = np.maximum(np.maximum(np.abs(foot), np.abs(beyond)), 1e-300)
        self.distance = d = np.maximum(distance, _NEAREST * reach)
        # Of the difference of two angles, not the difference of two arctangents.
        self._angle = np.arctan2(d * length, d * d - foot * beyond)
        self._square = d * d + foot * foot

    @property
    def weight(self) -> np.ndarray:
        """(N,) the integral of 1 / r^2."""
        return self._angle / self.distance

    def sample(self, u: np.ndarray) -> np.ndarray:
        angle = u * self._angle
        sin, cos = np.sin(angle), np.cos(angle)
        t = sin * self._square / np.maximum(self.distance * cos + self._foot * sin, 1e-300)
        return np.clip(t, 0, self._length)

    def steps(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Places (count + 1, N) at even steps of u, roughly, float32: from the foot, and from the start."""
        root = np.sqrt(self._square)
        cos, sin = (x.astype(np.float32) for x in (self.distance / root, -self._foot / root))
        step = (self._angle / count).astype(np.float32)
        step_cos, step_sin = np.cos(step), np.sin(step)
        slope = np.empty((count + 1, *step.shape), np.float32)
        for row in slope:
            np.divide(sin, np.maximum(cos, np.float32(1e-30)), out=row)
            cos, sin = cos * step_cos - sin * step_sin, sin * step_cos + cos * step_sin
        slope *= self.distance.astype(np.float32)
        foot, length = self._foot.astype(np.float32), self._length.astype(np.float32)
        t = np.clip(slope + foot, 0, length)
        return t - foot, t

    def cdf(self, t: np.ndarray) -> np.ndarray:
        """(N,) the u that `sample` takes to t."""
        d = self.distance
        angle = np.arctan2(d * t, self._square - self._foot * t)
        return angle / np.maximum(self._angle, 1e-300)

    def pdf(self, t: np.ndarray) -> np.ndarray:
        x, d = t - self._foot, self.distance
        return d / (np.maximum(self._angle, 1e-300) * (d * d + x * x))


class FreePath:
    """What a fog's own extinction leaves, cut off at the segment's end."""

    def __init__(self, sigma: np.ndarray, length: np.ndarray) -> None:
        """sigma : (N,) per length. length : (N,), finite (`within_depth`)."""
        self._sigma, self._length = sigma, length
        depth = sigma * length
        self._mass = -np.expm1(-depth)
        thin = depth < 1e-12
        self._depth = np.where(thin, 1, depth)
        self._thin = thin
        # The density at the start.
        self._first = np.where(thin, 1, depth / np.where(thin, 1, self._mass)) / np.maximum(length, 1e-300)

    def sample(self, u: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore"):
            part = np.where(self._thin, u, -np.log1p(-u * self._mass) / self._depth)
        return np.clip(part, 0, 1) * self._length

    def pdf(self, t: np.ndarray) -> np.ndarray:
        return self._first * np.exp(-self._sigma * t)


class UntruncatedPath:
    """Free paths as if the fog had no end: distances beyond the segment's are of no use."""

    def __init__(self, sigma: np.ndarray, length: np.ndarray) -> None:
        self._sigma = sigma

    def sample(self, u: np.ndarray) -> np.ndarray:
        with np.errstate(divide="ignore"):
            return -np.log1p(-u) / np.maximum(self._sigma, 1e-300)

    def pdf(self, t: np.ndarray) -> np.ndarray:
        return self._sigma * np.exp(-self._sigma * t)


class Tabulated:
    """Another map, whose density is multiplied with a factor, linear between values at even steps of its u.

    For the product of 1 / r^2, which the map has, and what falls off as smoothly as extinction and phase do.
    """

    def __init__(self, inner: EquiAngular, factor: np.ndarray) -> None:
        """factor : (K, N) or (K, N, 1) at u = 0, 1 / (K - 1) ... 1 of the other map; at least 0."""
        self._inner = inner
        steps = len(factor) - 1
        # Where a factor vanishes, a little remains, since it is only known at the steps.
        factor = factor + 1e-3 * factor.mean(axis=0) + 1e-30
        mass = np.cumsum(factor[1:] + factor[:-1], axis=0)
        self._factor = factor * (2 * steps / mass[-1])
        self._upper = mass / mass[-1]

    def sample(self, u: np.ndarray) -> np.ndarray:
        return self._inner.sample(self._place(u))

    def _place(self, u: np.ndarray) -> np.ndarray:
        steps = len(self._upper)
        step = np.zeros(u.shape, np.intp)
        for bound in self._upper[:-1]:
            step += u >= bound
        low = np.where(step > 0, _row(self._upper, step - 1), 0)
        a, b = _row(self._factor, step), _row(self._factor, step + 1)
        # Of the trapezoid from a to b, of area (a + b) / 2, the part below u; stable for a = b, too.
        wanted = np.maximum(u - low, 0) * steps
        root = np.sqrt(np.maximum(a * a + 2 * (b - a) * wanted, 0))
        part = np.clip(2 * wanted / np.maximum(a + root, 1e-300), 0, 1)
        return (step + part) / steps

    def pdf(self, t: np.ndarray) -> np.ndarray:
        steps = len(self._upper)
        place = np.clip(self._inner.cdf(t) * steps, 0, steps)
        step = np.minimum(place.astype(np.intp), steps - 1)
        a, b = _row(self._factor, step), _row(self._factor, step + 1)
        return self._inner.pdf(t) * (a + (b - a) * (place - step))


def _row(table: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Of each column of a table (K, N) or (K, N, 1) rows (N,) or (N, S)."""
    columns = np.arange(table.shape[1]).reshape(-1, *(1,) * (row.ndim - 1))
    return table.reshape(-1).take(row * table.shape[1] + columns)
