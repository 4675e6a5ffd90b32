# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions on the unit cube that an integrator is judged with, and the true means of their bins.

Each has smooth parts, edges, ridges or peaks as light does. As many dimensions as can be are
integrated in closed form (along a ray between the edges of shadows, along a row of a light), the
rest by a tensor of Gauss points where they are smooth, else by two long Owen-scrambled Sobol nets
in every bin, whose difference tells the error.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import erf

import dev
from engine_core.integration.point_sets import SobolPoints
from engine_core.integration.sobol import hash_combine, mix

CACHE = dev.PRIVATE / "integrands"
BATCH = 1 << 14

Function = Callable[[np.ndarray], np.ndarray]
"""u (D, N) -> (N,) or (C, N)."""


@dataclass(frozen=True)
class Integrand:
    """A function on the unit cube.

    ndim : its dimensions. bins : the usual grid over the first of them.
    mean : over the whole cube, of channel 0.
    reduced : the function with all but its first ``reduced_ndim`` dimensions integrated out.
    smooth : whether Gauss points integrate what is left; if not, nets do, ``net_points`` over all bins.
    panels : pieces that Gauss points need along each dimension of ``reduced`` (of 8 points).
    exact : bins -> (C, *bins) where there is a closed form for everything.
    """

    name: str
    ndim: int
    bins: tuple[int, ...]
    f: Function
    mean: float
    reduced: Function | None = None
    reduced_ndim: int = 0
    smooth: bool = False
    panels: tuple[int, ...] = (32, 32)
    net_points: int = 1 << 24
    exact: Callable[[tuple[int, ...]], np.ndarray] | None = None


@dataclass(frozen=True)
class Reference:
    """True means of all bins.

    value : (C, *bins). noise : mean square error that they have themselves, about.
    """

    value: np.ndarray
    noise: float

    def relative_error(self, value: np.ndarray) -> float:
        """RMSE over bins and channels, relative to the mean; the reference's own noise taken off."""
        square = np.mean((value - self.value) ** 2) - self.noise
        return float(np.sqrt(max(square, 0.0)) / abs(self.value.mean()))

    @property
    def own_error(self) -> float:
        """The reference's own relative RMSE."""
        return float(np.sqrt(self.noise) / abs(self.value.mean()))


# Smooth functions, a ridge, a disk


def smooth3(u: np.ndarray) -> np.ndarray:
    x, y, z = u
    return (1 + x * y + z * z) * np.exp(-(x + 2 * y) * z)


def ridge3(u: np.ndarray) -> np.ndarray:
    x, y, z = u
    return (0.5 + y) * np.exp(-(((z - 0.3 - 0.4 * x) / 0.08) ** 2))


def _ridge3_along_z(u: np.ndarray) -> np.ndarray:
    x, y = u
    return (0.5 + y) * _mean_of_bell(0.3 + 0.4 * x, 1 / 0.08)


def _mean_of_bell(
    centre: float | np.ndarray, sharpness: float, low: float | np.ndarray = 0.0, high: float = 1.0
) -> np.ndarray:
    """The integral of exp(-(sharpness (z - centre))^2) over z from ``low`` to ``high``."""
    scale = math.sqrt(math.pi) / (2 * sharpness)
    return scale * (erf(sharpness * (high - centre)) - erf(sharpness * (low - centre)))


def disk2(u: np.ndarray) -> np.ndarray:
    x, y = u
    return np.where((x - 0.5) ** 2 + (y - 0.5) ** 2 < 0.16, 1.0, 0.1)


def _disk2_bins(bins: tuple[int, ...]) -> np.ndarray:
    x, y = (np.linspace(-0.5, 0.5, n + 1) for n in bins)
    corner = _disk_quadrant(x[:, None], y[None, :], 0.4)
    area = np.diff(np.diff(corner, axis=0), axis=1)
    return (0.1 + 0.9 * area * bins[0] * bins[1])[None]


def _disk_quadrant(x: np.ndarray, y: np.ndarray, r: float) -> np.ndarray:
    """The area of the disk about 0 that lies left of x and below y."""

    def below(t: np.ndarray) -> np.ndarray:
        """Of sqrt(r^2 - t^2), from 0 to t."""
        return (t * np.sqrt(np.maximum(r * r - t * t, 0)) + r * r * np.arcsin(t / r)) / 2

    x, y = np.clip(x, -r, r), np.clip(y, -r, r)
    chord = np.sqrt(r * r - y * y)
    inner = np.clip(x, -chord, chord)
    # Between -chord and chord columns reach from the circle to y; beyond, they're whole or empty.
    area = y * (inner + chord) + below(inner) - below(-chord)
    whole = below(np.minimum(x, -chord)) - below(-r) + below(np.maximum(x, chord)) - below(chord)
    return area + np.where(y > 0, 2 * whole, 0)


def spike3(u: np.ndarray) -> np.ndarray:
    x, y, z = u
    return 0.05 + np.exp(-(((x - 0.52) ** 2 + (y - 0.37) ** 2 + (z - 0.61) ** 2) / 0.02**2))


def _spike3_along_z(u: np.ndarray) -> np.ndarray:
    x, y = u
    return 0.05 + np.exp(-(((x - 0.52) ** 2 + (y - 0.37) ** 2) / 0.02**2)) * _mean_of_bell(0.61, 50.0)


_BUMP_CENTRES = (0.4, 0.6, 0.3, 0.55, 0.7, 0.45, 0.35)


def bump10(u: np.ndarray) -> np.ndarray:
    """A product of ten factors, with an edge between dimensions 0 and 2."""
    value = (1 + u[1]) * np.exp(-4 * (u[0] - 0.4) ** 2 - 2.25 * (u[2] - 0.5) ** 2)
    for x, centre in zip(u[3:], _BUMP_CENTRES, strict=True):
        value = value * np.exp(-2.25 * (x - centre) ** 2)
    return value * np.where(u[2] > 0.3 + 0.4 * u[0], 1.0, 0.25)


def _bump10_on_screen(u: np.ndarray) -> np.ndarray:
    x, y = u
    rest = math.prod(float(_mean_of_bell(centre, 1.5)) for centre in _BUMP_CENTRES)
    above = _mean_of_bell(0.5, 1.5, low=0.3 + 0.4 * x)
    return (1 + y) * np.exp(-4 * (x - 0.4) ** 2) * rest * (0.25 * _mean_of_bell(0.5, 1.5) + 0.75 * above)


_COLOURS = ((1.0, 0.3), (0.6, 0.9), (0.2, 1.4))


def colour3(u: np.ndarray) -> np.ndarray:
    """Three ridges, one a channel, on either side of a wavy edge."""
    x, y, z = u
    ridges = [np.exp(-(((z - 0.3 - 0.1 * c - 0.3 * x) * (9 - 2 * c)) ** 2)) for c in range(3)]
    return np.stack(ridges) * _tint(x, y)


def _tint(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(3, N) the colours of colour3."""
    above = y > 0.5 + 0.2 * np.sin(4 * x)
    return np.stack([np.where(above, a, b) for a, b in _COLOURS])


def _colour3_along_z(u: np.ndarray) -> np.ndarray:
    x, y = u
    ridges = [_mean_of_bell(0.3 + 0.1 * c + 0.3 * x, 9 - 2 * c) for c in range(3)]
    return np.stack(ridges) * _tint(x, y)


def checkerboard4(u: np.ndarray) -> np.ndarray:
    """0 or 1 at random in each of 64^4 cells: no neighbour tells anything."""
    cell = np.minimum((64 * u).astype(np.uint32), np.uint32(63))
    return _checker(cell[0], cell[1], cell[2], cell[3])


def _checker(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    six = np.uint32(6)
    return (mix((((((a << six) | b) << six) | c) << six) | d) >> np.uint32(31)).astype(np.float64)


def _checkerboard4_bins(bins: tuple[int, ...]) -> np.ndarray:
    i = np.arange(64, dtype=np.uint32)
    cells = np.stack(
        [_checker(a, i[:, None, None], i[:, None], i).mean(axis=(1, 2)) for a in i.reshape(64, 1)]
    )
    for n in bins:  # each product puts its new axis last and the next one first
        cells = np.tensordot(cells, _share_of_cells(n, 64), axes=(0, 1))
    return cells[None]


def _share_of_cells(bins: int, cells: int) -> np.ndarray:
    """(bins, cells) which part of each bin lies in each cell."""
    low, high = (np.arange(bins) + k for k in (0, 1))
    edges = np.arange(cells)
    # In units of 1 / (bins cells), where all edges are integers.
    overlap = np.minimum(high[:, None] * cells, (edges + 1) * bins) - np.maximum(
        low[:, None] * cells, edges * bins
    )
    return np.maximum(overlap, 0) / cells


# Fog: a camera at 0, rays (x - .5, y - .5, 1) to the plane z = 3


@dataclass(frozen=True)
class _Rays:
    """Camera rays with equiangular sampling about a point.

    direction : (3, N). foot : distance along the ray of what is nearest to the point.
    gap : how near that is. low, high : angles of the ray's ends, seen from the point.
    """

    direction: np.ndarray
    foot: np.ndarray
    gap: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def through(cls, x: np.ndarray, y: np.ndarray, point: np.ndarray) -> _Rays:
        """point : (3, 1) or (3, N)."""
        direction = np.stack([x - 0.5, y - 0.5, np.ones_like(x)])
        norm = np.sqrt(_dot(direction, direction))
        direction /= norm
        foot = _dot(direction, point)
        offset = point - foot * direction
        gap = np.sqrt(_dot(offset, offset))
        return cls(direction, foot, gap, np.arctan2(-foot, gap), np.arctan2(3 * norm - foot, gap))

    def at(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Angle and distance along the ray for z in [0, 1]."""
        angle = self.low + z * (self.high - self.low)
        return angle, self.foot + self.gap * np.tan(angle)

    def z_at(self, t: np.ndarray) -> np.ndarray:
        """z in [0, 1] of distances along the ray, those beyond the ends moved there; 0 for NaN."""
        z = (np.arctan2(t - self.foot, self.gap) - self.low) / (self.high - self.low)
        return np.clip(np.nan_to_num(z), 0, 1)

    def take(self, index: np.ndarray) -> _Rays:
        return _Rays(*(np.take(a, index, -1) for a in vars(self).values()))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _column(*values: float) -> np.ndarray:
    return np.array(values, float)[:, None]


def _unblocked(p: np.ndarray, q: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Whether the segments from p to q (3, N) miss a sphere."""
    way, to = q - p, centre - p
    miss = to - np.clip(_dot(to, way) / _dot(way, way), 0, 1) * way
    return _dot(miss, miss) >= radius * radius


def _roots(a: np.ndarray, half_b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of a t^2 + 2 half_b t + c; NaN where there are none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        q = -(half_b + np.copysign(np.sqrt(half_b * half_b - a * c), half_b))
        return q / a, c / q


def _along_lit_rays(
    rays: _Rays,
    light: np.ndarray,
    centre: np.ndarray,
    radius: float,
    f: Callable[[_Rays, np.ndarray, np.ndarray], np.ndarray],
    order: int = 12,
) -> np.ndarray:
    """The integral over z of ``f(rays, light, z)`` where the light (3, N) isn't behind the sphere.

    What the sphere hides is bounded by the cone about it, and before the cone's circle of contact by
    the sphere itself: a ray crosses each at two places at most, the roots of quadratics. Gauss
    points serve the pieces between them that are lit.
    """
    count = rays.direction.shape[1]
    light = np.broadcast_to(light, (3, count))
    d, w = rays.direction, centre - light
    m = _dot(w, w) - radius * radius
    a, b = _dot(d, w), _dot(light, w)
    cone = _roots(a * a - m, m * _dot(d, light) - a * b, b * b - m * _dot(light, light))
    sphere = _roots(1.0, -_dot(d, centre), _dot(centre, centre) - radius * radius + np.zeros(count))
    edges = np.stack([np.zeros(count), *map(rays.z_at, (*cone, *sphere)), np.ones(count)])
    edges.sort(axis=0)
    total = np.zeros(count)
    nodes, weights = _gauss(order)
    for low, high in itertools.pairwise(edges):
        there = np.flatnonzero(high - low > 1e-14)
        _, t = rays.take(there).at((low[there] + high[there]) / 2)
        lit = _unblocked(t * d[:, there], light[:, there], centre, radius)
        there = there[lit]
        if len(there) == 0:
            continue
        here = rays.take(np.repeat(there, order))
        width = (high - low)[there]
        z = low[there][:, None] + width[:, None] * nodes
        values = f(here, np.repeat(light[:, there], order, axis=1), z.ravel()).reshape(z.shape)
        total[there] += width * (values @ weights)
    return total


_LIGHT = _column(1.2, 0.2, 1.5)
_BALL = _column(0.75, 0.15, 1.5)


def _sscat(rays: _Rays, light: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Scattered once, unshadowed: sigma_t .3, sigma_s .25, Henyey-Greenstein g .4, intensity 1."""
    angle, t = rays.at(z)
    cosine = -np.sin(angle)  # between the way from the light and the way to the camera
    phase = 0.84 / (4 * math.pi * (1.16 - 0.8 * cosine) ** 1.5)
    distance = rays.gap / np.cos(angle)
    return 0.25 * phase * np.exp(-0.3 * (t + distance)) * (rays.high - rays.low) / rays.gap


def sscat_occ(u: np.ndarray) -> np.ndarray:
    x, y, z = u
    rays = _Rays.through(x, y, _LIGHT)
    _, t = rays.at(z)
    return _sscat(rays, _LIGHT, z) * _unblocked(t * rays.direction, _LIGHT, _BALL, 0.2)


def _sscat_occ_along_z(u: np.ndarray) -> np.ndarray:
    return _along_lit_rays(_Rays.through(*u, _LIGHT), _LIGHT, _BALL, 0.2, _sscat)


_LAMP = _column(0.3, 1.7, 1.6)
_SHADE = _column(0.2, 1.0, 1.5)


def _lamp(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, N) points on fog5's lamp, a square that looks down."""
    return _LAMP + 0.6 * np.stack([a - 0.5, np.zeros_like(a), b - 0.5])


def _fog5(rays: _Rays, light: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Scattered once from a point on the lamp, unshadowed; equiangular about the lamp's centre."""
    angle, t = rays.at(z)
    way = t * rays.direction - light
    square = _dot(way, way)
    distance = np.sqrt(square)
    light_here = np.exp(-0.3 * (t + distance)) * 0.36 * -way[1] / (distance * square)
    return 0.25 / (4 * math.pi) * light_here * (rays.high - rays.low) * rays.gap / np.cos(angle) ** 2


def fog5(u: np.ndarray) -> np.ndarray:
    """An area light in fog, with a ball before it: screen, distance, lamp."""
    x, y, z, a, b = u
    rays, light = _Rays.through(x, y, _LAMP), _lamp(a, b)
    _, t = rays.at(z)
    return _fog5(rays, light, z) * _unblocked(t * rays.direction, light, _SHADE, 0.25)


def _fog5_along_z(u: np.ndarray) -> np.ndarray:
    x, y, a, b = u
    return _along_lit_rays(_Rays.through(x, y, _LAMP), _lamp(a, b), _SHADE, 0.25, _fog5)


_LASER_START, _LASER_WAY = _column(0.56, -0.4, 1.0), _column(0.56, 1.2, 1.0)


def vrl4(u: np.ndarray) -> np.ndarray:
    """A laser just outside the picture: a ridge of 1/h towards the edge. Screen, laser, ray."""
    x, y, v, z = u
    point = _LASER_START + v * _LASER_WAY
    rays = _Rays.through(x, y, point)
    angle, t = rays.at(z)
    length = math.sqrt(float(_dot(_LASER_WAY, _LASER_WAY)[0]))
    way = t + v * length + rays.gap / np.cos(angle)
    return length * np.exp(-0.4 * way) * (rays.high - rays.low) / rays.gap


# Floors under area lights


def direct4(u: np.ndarray) -> np.ndarray:
    """A floor, 4 x 4, a square light of 1 x 1 two above it, a ball between them."""
    floor, light = _floor(u[0], u[1]), _ceiling(u[2], u[3])
    way = light - floor
    square = _dot(way, way)
    return 4 / (square * square) * _unblocked(floor, light, _column(0.4, 0.3, 1.0), 0.3)


def _floor(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([4 * x - 2, 4 * y - 2, np.zeros_like(x)])


def _ceiling(z: np.ndarray, w: np.ndarray) -> np.ndarray:
    return np.stack([z - 0.5, w - 0.5, np.full_like(z, 2.0)])


def _row(square: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The integral of 4 / (square + s^2)^2 over s from ``low`` to ``high``; 0 where that is empty."""
    root = np.sqrt(square)

    def upto(s: np.ndarray) -> np.ndarray:
        return 2 * s / (square * (square + s * s)) + 2 * np.arctan(s / root) / (square * root)

    return upto(np.maximum(high, low)) - upto(low)


def _direct4_along_row(u: np.ndarray) -> np.ndarray:
    x, y, w = u
    floor = _floor(x, y)
    left, right = -0.5 - floor[0], 0.5 - floor[0]
    across = w - 0.5 - floor[1]
    square = 4 + across * across
    # The cone about the ball cuts the row where (v.c)^2 > |v|^2 m, v = (s, across, 2).
    c = _column(0.4, 0.3, 1.0) - floor
    m = _dot(c, c) - 0.09
    k = across * c[1] + 2 * c[2]
    ends = np.stack(_roots(c[0] * c[0] - m, c[0] * k, k * k - m * square))
    low, high = (np.clip(np.nan_to_num(end), left, right) for end in (ends.min(0), ends.max(0)))
    hidden = np.where(np.isnan(ends[0]), 0.0, _row(square, low, high))
    return _row(square, left, right) - hidden


_BARS = 6
"""Bars of grid4 for each unit of length; they cover an eighth of it."""


def grid4(u: np.ndarray) -> np.ndarray:
    """direct4 with a grid of thin bars in place of the ball, half way up."""
    floor, light = _floor(u[0], u[1]), _ceiling(u[2], u[3])
    way, middle = light - floor, (light + floor) / 2 * _BARS
    square = _dot(way, way)
    is_open = (_fraction(middle[0]) > 0.125) & (_fraction(middle[1]) > 0.125)
    return 4 / (square * square) * is_open


def _fraction(x: np.ndarray) -> np.ndarray:
    return x - np.floor(x)


def _grid4_along_row(u: np.ndarray) -> np.ndarray:
    x, y, w = u
    floor = _floor(x, y)
    left, right = -0.5 - floor[0], 0.5 - floor[0]
    across = w - 0.5 - floor[1]
    square = 4 + across * across
    first = np.floor((floor[0] - 0.5) / 2 * _BARS)
    total = np.zeros_like(x)
    for gap in range(_BARS // 2 + 1):
        # Half way up is at floor + s / 2.
        low, high = (2 * ((first + gap + end) / _BARS - floor[0]) for end in (0.125, 1))
        total += _row(square, np.clip(low, left, right), np.clip(high, left, right))
    return total * (_fraction((floor[1] + w - 0.5) / 2 * _BARS) > 0.125)


_SPOT_AXIS = _column(-0.4, 0.2, -1.0) / math.sqrt(1.2)
_SPOT_RIGHT = _column(1.0, 0.0, -0.4) / math.sqrt(1.16)
_SPOT_UP = np.cross(_SPOT_AXIS, _SPOT_RIGHT, axis=0)
_SPOT_EDGE = math.cos(math.radians(35))


def spot4(u: np.ndarray) -> np.ndarray:
    """The blurred rim of a tilted square spot light, and the half-shadow of a board's edge in it."""
    x, y, z, w = u
    floor = np.stack([3 * x - 1.5, 3 * y - 1.5, np.zeros_like(x)])
    light = _column(0.5, -0.3, 1.6) + 0.5 * ((z - 0.5) * _SPOT_RIGHT + (w - 0.5) * _SPOT_UP)
    way = floor - light
    square = _dot(way, way)
    distance = np.sqrt(square)
    cosine = _dot(way, _SPOT_AXIS) / distance
    blend = np.clip((cosine - _SPOT_EDGE) / (0.3 * (1 - _SPOT_EDGE)), 0, 1)
    at_board = floor - way * (0.7 / light[2])
    is_open = at_board[0] < 0.1 + 0.3 * at_board[1]
    falloff = blend * blend * (3 - 2 * blend) * cosine * light[2] / (square * distance)
    return 0.25 * falloff * is_open


REFERENCE_FIVE = ("smooth3", "ridge3", "disk2", "sscat_occ", "direct4")
"""Those of the table in `docs/method.md`."""

INTEGRANDS = {
    integrand.name: integrand
    for integrand in (
        Integrand(
            "smooth3", 3, (32, 32), smooth3, 0.779738914719, smooth=True, panels=(32, 32, 2), reduced_ndim=3
        ),
        Integrand("ridge3", 3, (32, 32), ridge3, 0.141796307669, _ridge3_along_z, 2, smooth=True),
        Integrand("disk2", 2, (8, 8), disk2, 0.552389342117, exact=_disk2_bins),
        Integrand(
            "sscat_occ", 3, (32, 32), sscat_occ, 0.0116373854, _sscat_occ_along_z, 2, net_points=1 << 22
        ),
        Integrand("direct4", 4, (32, 32), direct4, 0.0956656318, _direct4_along_row, 3, net_points=1 << 26),
        Integrand("checkerboard4", 4, (32, 32), checkerboard4, 0.499902069569, exact=_checkerboard4_bins),
        Integrand("spot4", 4, (32, 32), spot4, 0.00994381, net_points=1 << 26),
        Integrand("vrl4", 4, (32, 32), vrl4, 1.657909, smooth=True, panels=(32, 32, 16, 2), reduced_ndim=4),
        Integrand("fog5", 5, (32, 32), fog5, 0.001434561, _fog5_along_z, 4, net_points=1 << 22),
        Integrand("bump10", 10, (32, 32), bump10, 0.144445683534, _bump10_on_screen, 2, smooth=True),
        Integrand(
            "spike3", 3, (32, 32), spike3, 0.050044546624, _spike3_along_z, 2, smooth=True, panels=(128, 128)
        ),
        Integrand("grid4", 4, (32, 32), grid4, 0.08190901, _grid4_along_row, 3, net_points=1 << 26),
        Integrand("colour3", 3, (32, 32), colour3, 0.1166116, _colour3_along_z, 2),
    )
}


# References


def reference(
    integrand: Integrand,
    bins: tuple[int, ...] | None = None,
    net_points: int | None = None,
    cache: Path | None = CACHE,
) -> Reference:
    """The true means of ``bins`` (the integrand's own by default), from the cache if they were made before.

    net_points : of each of two nets, over all bins, instead of the integrand's. cache : None for none.
    """
    bins = bins or integrand.bins
    net_points = net_points or integrand.net_points
    if cache is None:
        return _computed(integrand, bins, net_points)
    size = "x".join(map(str, bins))
    path = cache / f"{integrand.name}-{size}-{_fingerprint(integrand)}-{net_points:x}.npz"
    if path.exists():
        with np.load(path) as stored:
            return Reference(stored["value"], float(stored["noise"]))
    made = _computed(integrand, bins, net_points)
    cache.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part")
    with part.open("wb") as file:
        np.savez(file, value=made.value, noise=made.noise)
    os.replace(part, path)
    return made


def _fingerprint(integrand: Integrand) -> str:
    """Eight letters that change with the function: a digest of its values at some points."""
    net = SobolPoints(range(integrand.ndim), 7, 0)
    net.prepare(512)
    values = integrand.f(net.points(np.zeros(1, np.uint32), 0, 512)[:, 0].astype(np.float64))
    text = " ".join(f"{value:.9g}" for value in np.ravel(values))
    return hashlib.sha256(f"{text} {integrand.panels}".encode()).hexdigest()[:8]


def _computed(integrand: Integrand, bins: tuple[int, ...], net_points: int) -> Reference:
    if integrand.exact is not None:
        value = integrand.exact(bins)
        return Reference(value, float(np.square(1e-14 * value.mean())))
    function, dimensions = integrand.reduced or integrand.f, integrand.reduced_ndim or integrand.ndim
    if integrand.smooth:
        sizes = [*bins, *(1 for _ in range(dimensions - len(bins)))]
        panels = [-(-p // n) for p, n in zip(integrand.panels, sizes, strict=True)]
        # Bins far narrower than what they have to resolve need fewer points.
        orders = [4 if n >= 4 * p else 8 for p, n in zip(integrand.panels, sizes, strict=True)]
        if math.prod(p * o for p, o in zip(panels, orders, strict=True)) * math.prod(bins) <= 1 << 29:
            fine, coarse = (_by_gauss(function, bins, panels, [o - k for o in orders]) for k in (0, 1))
            return Reference(fine, float(np.mean((fine - coarse) ** 2)))
    count = 1 << int(np.clip(math.log2(net_points / math.prod(bins)), 2, 18))
    one, other = (_by_nets(function, dimensions, bins, count, seed) for seed in (1001, 2002))
    return Reference((one + other) / 2, float(np.mean((one - other) ** 2) / 4))


def _gauss(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in [0, 1] and weights that sum to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return (nodes + 1) / 2, weights / 2


def _by_gauss(f: Function, bins: tuple[int, ...], panels: list[int], orders: list[int]) -> np.ndarray:
    """(C, *bins) means by a tensor of Gauss points, ``panels`` times ``orders`` a dimension of each bin."""
    nodes, weights = [], []
    for p, order in zip(panels, orders, strict=True):
        x, w = _gauss(order)
        nodes.append(((np.arange(p)[:, None] + x) / p).ravel())
        weights.append(np.tile(w / p, p))
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*nodes, indexing="ij")])
    weight = np.prod(np.meshgrid(*weights, indexing="ij"), axis=0).ravel()

    def means(part: slice) -> np.ndarray:
        total = 0.0
        for low in range(0, len(weight), BATCH):
            some = slice(low, low + BATCH)
            u = np.broadcast_to(grid[:, None, some], (len(grid), part.stop - part.start, weight[some].size))
            total = total + _values(f, bins, part, u) @ weight[some]
        return total

    return _by_slices(means, bins, len(weight))


def _by_nets(f: Function, dimensions: int, bins: tuple[int, ...], count: int, seed: int) -> np.ndarray:
    """(C, *bins) means over ``count`` points of a Sobol net in each bin."""
    net = SobolPoints(range(dimensions), seed, 0)
    net.prepare(count)
    keys = hash_combine(seed, np.arange(math.prod(bins)))

    def means(part: slice) -> np.ndarray:
        total = 0.0
        for low in range(0, count, BATCH):
            u = net.points(keys[part], low, min(BATCH, count - low))
            total = total + _values(f, bins, part, u).sum(axis=2)
        return total / count

    return _by_slices(means, bins, count)


def _values(f: Function, bins: tuple[int, ...], part: slice, u: np.ndarray) -> np.ndarray:
    """(C, B, S) of f at points u (D, B, S) in each of the bins ``part`` (numbered in C order)."""
    at = u.astype(np.float64)
    for d, index in enumerate(np.unravel_index(np.arange(part.start, part.stop), bins)):
        at[d] = (at[d] + index[:, None]) / bins[d]
    return np.reshape(f(at.reshape(len(at), -1)), (-1, *u.shape[1:]))


def _by_slices(means: Callable[[slice], np.ndarray], bins: tuple[int, ...], points: int) -> np.ndarray:
    """(C, *bins) of ``means`` (slice -> (C, B)), called for some bins at a time on all processors."""
    count, width = math.prod(bins), max(1, BATCH // points)

    def slices() -> Iterator[slice]:
        for low in range(0, count, width):
            yield slice(low, min(low + width, count))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return np.concatenate(list(pool.map(means, slices())), axis=1).reshape(-1, *bins)


def main() -> None:
    """Make all references, and say how good they are."""
    print("| integrand | dimensions | bins | mean | own relative RMSE |\n|---|---|---|---|---|")
    for integrand in INTEGRANDS.values():
        made = reference(integrand)
        size, mean = " x ".join(map(str, integrand.bins)), made.value[0].mean()
        print(f"| {integrand.name} | {integrand.ndim} | {size} | {mean:.9g} | {made.own_error:.1e} |")


if __name__ == "__main__":
    main()
