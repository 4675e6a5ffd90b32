# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a beam and a camera ray exchange light: points on both, from two uniform numbers.

What is to be integrated over the beam (v) and the ray (t) is 1/r^2 times a smooth factor. Along the beam the
map is by 1/distance to the line of the ray (thesis eq. 6.12-6.13; Novak et al. 2012, "Virtual ray lights"),
which is asinh; along the ray by 1/r^2 about the point that was sampled on the beam. Nothing singular is left:

    dv dt / r^2 = (A1 - A0) / sin * 2 (w1 - w0) / (1 + w^2) du1 du2,     w = tan(angle / 2) from the foot

The thesis maps the ray about the point that is nearest to the beam's line, at that distance (eq. 6.14-6.15).

Of the two lines: along the beam, ``y`` is the distance from the ray's line within the plane of both
directions (0 where they pass each other, growing with sin), ``h`` the distance between the lines; along the
ray, ``x`` is measured from the foot of the sampled point. All float64: near the beam differences of large
numbers count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.vectors import dot

LEAST_DISTANCE = 1e-12
"""Of the lines, over the beam's length: what a smaller one counts as, in map and density alike."""

LEAST_GAP = 1e-9
"""Of a point of the beam and the ray, over the length of the ray: the same."""

LEAST_SINE = 1e-30
"""Lines that are parallel count as nearly so: the map's limit, uniform on the beam, needs no other case."""

LEAST_OF_LOBE = 1e-6
"""Of a lobe, the part that a stretch fills, below which all of it is alike."""


@dataclass(eq=False)
class Passage:
    """L pairs of a stretch of a ray and a stretch of a beam; all (L,) float64.

    sin, cos : of the angle between the directions. h : distance of the lines.
    y : where the beam's stretch begins. foot : of that beginning on the ray, from the ray's origin.
    a, da : asinh(y / h) there, and how much it grows to the stretch's end.
    start, end : of the ray's stretch, from its origin.
    """

    sin: np.ndarray
    cos: np.ndarray
    h: np.ndarray
    y: np.ndarray
    foot: np.ndarray
    a: np.ndarray
    da: np.ndarray
    start: np.ndarray
    end: np.ndarray

    def take(self, rows: np.ndarray) -> Passage:
        return Passage(*(getattr(self, name).take(rows) for name in self.__dataclass_fields__))

    def columns(self) -> Passage:
        """All (L, 1), for several points of each pair."""
        return Passage(*(getattr(self, name)[:, None] for name in self.__dataclass_fields__))


def passages(
    between: np.ndarray,
    ray: np.ndarray,
    beam: np.ndarray,
    length: np.ndarray,
    start: np.ndarray,
    end: np.ndarray,
) -> Passage:
    """Pairs of stretches.

    between : (3, L) float64 from the ray's origin to where the beam's stretch begins. ray, beam : (3, L) unit
    directions. length : (L,) of the beam's stretch. start, end : (L,) of the ray's.
    """
    foot = dot(between, ray)
    apart = between - foot * ray
    cos = dot(ray, beam)
    across = beam - cos * ray
    sin = np.sqrt(dot(across, across))
    # Of parallel lines, any direction across them.
    unit = across / np.maximum(sin, LEAST_SINE)
    y = dot(apart, unit)
    rest = apart - y * unit
    h = np.sqrt(dot(rest, rest))
    sin = np.maximum(sin, LEAST_SINE)
    h = np.maximum(h, LEAST_DISTANCE * length)
    low, high = y / h, (y + sin * length) / h
    # asinh(high) - asinh(low) without cancelling, where both have one sign.
    root_low, root_high = np.sqrt(1 + low * low), np.sqrt(1 + high * high)
    same = low * high > 0
    whole = np.where(same, high * root_low + low * root_high, 1)
    difference = np.where(
        same,
        (high + low) / np.where(whole == 0, 1, whole) * (sin * length / h),
        high * root_low - low * root_high,
    )
    return Passage(sin, cos, h, y, foot, np.arcsinh(low), np.arcsinh(difference), start, end)


def along_beam(p: Passage, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of the beam's stretch, from its beginning, for u (N,), and dv/du (N,), of N passages.

    Here and below, u (L, S) for passages of columns.
    """
    half = 0.5 * p.da * u
    # Hyperbolic functions, by two exponentials.
    grown = np.expm1(half)
    middle = np.exp(p.a + half)
    scale = p.h / p.sin
    v = middle + 1 / middle
    v *= grown + grown / (1 + grown)
    v *= 0.5 * scale
    middle *= 1 + grown
    return v, (0.5 * scale * p.da) * (middle + 1 / middle)


def along_ray(p: Passage, v: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the ray about v (N,) of the beam: x from their foot, r, and dx / r^2 / du; (N,) each."""
    foot, gap = foot_and_gap(p, v)
    w, dw = half_angles(p.start - foot, p.end - foot, gap)
    return at_half_angle(w + u * dw, dw, gap)


def foot_and_gap(p: Passage, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of points v of the beam's stretch: their foot on the ray, from its origin, and their distance to it."""
    y = p.y + v * p.sin
    foot = p.foot + v * p.cos
    far = np.maximum(np.abs(p.start - foot), np.abs(p.end - foot))
    return foot, np.maximum(np.sqrt(p.h * p.h + y * y), LEAST_GAP * far)


def half_angles(low: np.ndarray, high: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """tan(angle / 2) of points ``low`` of a line, from their foot, and how much it grows to ``high``."""
    square = gap * gap
    below, above = low / (gap + np.sqrt(square + low * low)), high / (gap + np.sqrt(square + high * high))
    return below, above - below


def half_angles_by_lobe(
    low: np.ndarray, dw: np.ndarray, lobe: tuple[np.ndarray, np.ndarray, np.ndarray], u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """w (L, S) from ``low`` (L,) on at u (L, S), a share of them about an angle as 1 / (width^2 + off^2) and
    the others evenly over ``dw`` (L,); and dw/du, by the balance heuristic of both.

    lobe : (L,) each: the angle 2 arctan w in its middle, width, and share.
    """
    (middle, width, share), low, dw = (a[:, None] for a in lobe), low[:, None], dw[:, None]
    first, last = (np.arctan((2 * np.arctan(w) - middle) / width) for w in (low, low + dw))
    # Within so little, nothing differs.
    share = np.where(last - first > LEAST_OF_LOBE, share, 0)
    evenly = u >= share
    v = np.where(evenly, (u - share) / (1 - share), u / np.where(share > 0, share, 1))
    angle = middle + width * np.tan(first + v * (last - first))
    w = np.where(evenly, low + v * dw, np.clip(np.tan(0.5 * angle), low, low + dw))
    off = 2 * np.arctan(w) - middle
    density = (
        2 * width * dw / ((width * width + off * off) * (1 + w * w) * np.maximum(last - first, LEAST_OF_LOBE))
    )
    return w, dw / (1 - share + share * density)


def at_half_angle(
    w: np.ndarray, dw: np.ndarray, gap: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the line at w = tan(angle / 2): x from the foot, distance r, and dx / r^2 for ``dw``."""
    square = w * w
    scale = gap / (1 - square)
    return 2 * w * scale, (1 + square) * scale, 2 * dw / (gap * (1 + square))


def along_ray_as_in_thesis(
    p: Passage, v: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Like `along_ray`, with the angle about the point of the ray that is nearest to the beam's line."""
    span = p.end - p.start
    nearest = np.clip(p.foot - p.y * p.cos / p.sin, p.start - 1e3 * span, p.end + 1e3 * span)
    # Seen from too near the ray's line, far away points of it would be at one angle.
    off_it = np.maximum(np.maximum(p.start - nearest, nearest - p.end), 0)
    h = np.maximum(p.h, np.maximum(LEAST_GAP * span, 1e-4 * off_it))
    low, high = np.arctan2(p.start - nearest, h), np.arctan2(p.end - nearest, h)
    off = h * np.tan(low + u * (high - low))
    weight = (h * h + off * off) * (high - low) / h
    foot, gap = foot_and_gap(p, v)
    x = np.clip(nearest + off, p.start, p.end) - foot
    r = np.sqrt(gap * gap + x * x)
    return x, r, weight / (r * r)
