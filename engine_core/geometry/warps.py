# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps from the unit square to disks, caps, spheres and hemispheres, and frames to place them in."""

from __future__ import annotations

import numpy as np

TWO_PI = np.float32(2 * np.pi)


def basis(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (3, N) perpendicular to the unit vectors ``n`` (3, N) and to each other.

    T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
    """
    sign = np.copysign(np.float32(1), n[2])
    a = -1 / (sign + n[2])
    b = n[0] * n[1] * a
    s = np.stack([1 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]])
    t = np.stack([b, sign + n[1] * n[1] * a, -n[1]])
    return s, t


def concentric_disk(u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Uniform points (x, y) of the unit disk; pdf 1 / pi.

    P. Shirley and K. Chiu, "A Low Distortion Map Between Disk and Square", 1997.
    """
    a, b = 2 * u - 1, 2 * v - 1
    wide = np.abs(a) > np.abs(b)
    radius = np.where(wide, a, b)
    other = np.where(wide, b, a)
    # Both vanish only in the very centre, which no point set of cell centres contains exactly.
    angle = np.float32(np.pi / 4) * (other / np.where(radius == 0, np.float32(1), radius))
    cos, sin = radius * np.cos(angle), radius * np.sin(angle)
    return np.where(wide, cos, sin), np.where(wide, sin, cos)


def regular_polygon(
    corners: int, rotation: float, u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Uniform points (x, y) of a regular polygon in the unit circle, an edge's middle at ``rotation``."""
    scaled = u * np.float32(corners)
    number = np.minimum(np.floor(scaled), np.float32(corners - 1))
    root = np.sqrt(scaled - number)
    v = v * root
    # Of the triangle between the centre and two corners; a and b weigh the corners.
    a, b = root - v, v
    angle = number * np.float32(2 * np.pi / corners) + np.float32(rotation - np.pi / corners)
    following = angle + np.float32(2 * np.pi / corners)
    return a * np.cos(angle) + b * np.cos(following), a * np.sin(angle) + b * np.sin(following)


def square_of_disk(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of `concentric_disk`."""
    wide = np.abs(x) > np.abs(y)
    radius = np.copysign(np.hypot(x, y), np.where(wide, x, y))
    near, far = np.where(wide, x, y), np.where(wide, y, x)
    other = radius * np.arctan(far / np.where(near == 0, 1, near)) * (4 / np.pi)
    a, b = np.where(wide, radius, other), np.where(wide, other, radius)
    return (a + 1) / 2, (b + 1) / 2


def square_of_polygon(
    corners: int, rotation: float, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of `regular_polygon`."""
    sector = 2 * np.pi / corners
    turned = (np.arctan2(y, x) - rotation) / sector + 0.5
    number = np.mod(np.floor(turned), corners)
    # Along the edge's normal and along the edge, the edge's middle at 1 and its ends at -1 and 1.
    middle = rotation + number * sector
    root = (x * np.cos(middle) + y * np.sin(middle)) / np.cos(sector / 2)
    along = (y * np.cos(middle) - x * np.sin(middle)) / np.sin(sector / 2)
    v = (along / np.where(root > 0, root, 1) + 1) / 2
    return (number + root * root) / corners, v


def in_regular_polygon(corners: int, rotation: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Whether points are in that of `regular_polygon`."""
    sector = 2 * np.pi / corners
    middle = rotation + np.rint((np.arctan2(y, x) - rotation) / sector) * sector
    return x * np.cos(middle) + y * np.sin(middle) <= np.cos(sector / 2)


def about_angle(u: np.ndarray, middle: float, half: float, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parts of a circle at u, ``part`` within an angle ``half`` of its ``middle``; and 1 / density."""
    wide = half / np.pi
    # From the middle on, so that the circle closes in what is far.
    beside = 2 * np.mod(u - middle / (2 * np.pi) + 0.5, 1) - 1
    far = np.abs(beside)
    near = far < part
    slope = np.where(near, wide / part, (1 - wide) / (1 - part))
    moved = np.where(near, far * slope, 1 - (1 - far) * slope)
    return np.mod(middle / (2 * np.pi) + np.copysign(moved, beside) / 2, 1), slope


def polar_in_disk(
    x: np.ndarray, y: np.ndarray, u: np.ndarray, v: np.ndarray, corners: int = 0, rotation: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the unit disk, or of the `regular_polygon` in it, by angle and distance about places (x, y),
    which may be anywhere; and their weights, to a uniform density. Far outside that is nearly even.

    The map has no jump where a weight is, wherever the place moves.
    """
    away = np.hypot(x, y)
    # Half of the angle that the disk fills; a little more next to it, as it is all around inside.
    half = np.arcsin(1 / np.maximum(away, 1)) + np.pi / 2 * np.clip(5 - 4 * away, 0, 1)
    half = np.where(away < 1, np.pi, half)
    towards = np.arctan2(-y, -x)
    beside = np.mod(2 * np.pi * u - towards + np.pi, 2 * np.pi) - np.pi
    angle = towards + beside * (half / np.pi)
    cos, sin = np.cos(angle), np.sin(angle)
    along, past = x * cos + y * sin, x * sin - y * cos
    chord = np.sqrt(np.maximum(1 - past * past, 0))
    entry, leave = np.maximum(-along - chord, 0), -along + chord
    area = np.pi
    if corners >= 3:
        area = corners / 2 * np.sin(2 * np.pi / corners)
        for edge in rotation + np.arange(corners) * (2 * np.pi / corners):
            slope = cos * np.cos(edge) + sin * np.sin(edge)
            room = np.cos(np.pi / corners) - x * np.cos(edge) - y * np.sin(edge)
            with np.errstate(divide="ignore", invalid="ignore"):
                at = room / slope
            entry = np.where(slope < 0, np.maximum(entry, at), entry)
            leave = np.where(slope > 0, np.minimum(leave, at), leave)
            leave = np.where((slope == 0) & (room < 0), entry, leave)
    length = np.where(past * past < 1, np.maximum(leave - entry, 0), 0)
    radius = entry + v * length
    return x + radius * cos, y + radius * sin, radius * length * (2 * half / area)


def cap(u: np.ndarray, v: np.ndarray, one_minus_cos: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Uniform directions (x, y, 1 - z) of a spherical cap about +z; pdf 1 / (2 pi one_minus_cos).

    Concentric squares go to concentric rings. 1 - z is returned, not z: it keeps its digits in a
    tiny cap.
    """
    x, y = concentric_disk(u, v)
    below = (x * x + y * y) * one_minus_cos
    scale = np.sqrt(one_minus_cos * (2 - below))
    return x * scale, y * scale, below


def sin_sqr_to_one_minus_cos(sin_sqr: np.ndarray) -> np.ndarray:
    """1 - cos of an angle in [0, pi/2] from its squared sine, without cancellation."""
    return sin_sqr / (1 + np.sqrt(np.maximum(1 - sin_sqr, 0)))


def cosine_hemisphere(normal: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions about ``normal`` with pdf cos / pi, and their measure pi / cos."""
    x, y = concentric_disk(u[0], u[1])
    z = np.sqrt(np.maximum(1 - x * x - y * y, np.float32(1e-12)))
    s, t = basis(normal)
    return x * s + y * t + z * normal, np.float32(np.pi) / z


def uniform_sphere(u: np.ndarray) -> tuple[np.ndarray, np.float32]:
    """Directions (3, N) of pdf 1 / (4 pi), and their measure 4 pi."""
    x, y, below = cap(u[0], u[1], np.float32(2))
    return np.stack([x, y, 1 - below]), np.float32(4 * np.pi)


def linear(a: np.ndarray, b: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Points of [0, 1] whose density goes from ``a`` to ``b``, at least 0, on a line."""
    root = np.sqrt(a * a + u * (b * b - a * a))
    total = a + root
    return np.where(total > 0, np.minimum(u * (a + b) / np.where(total > 0, total, 1), 1), u)


class Bilinear:
    """A density over the unit square, bilinear between positive values (M,) at its corners."""

    def __init__(self, w00: np.ndarray, w10: np.ndarray, w01: np.ndarray, w11: np.ndarray) -> None:
        """w10 is the corner (1, 0)."""
        scale = 4 / (w00 + w10 + w01 + w11)
        self._corners = tuple(w * scale for w in (w00, w10, w01, w11))

    def sample(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (2, M), and their densities (M,)."""
        w00, w10, w01, w11 = self._corners
        v = linear(w00 + w10, w01 + w11, u[1])
        left, right = w00 + v * (w01 - w00), w10 + v * (w11 - w10)
        h = linear(left, right, u[0])
        return np.stack([h, v]), left + h * (right - left)

    def density(self, u: np.ndarray) -> np.ndarray:
        w00, w10, w01, w11 = self._corners
        left, right = w00 + u[1] * (w01 - w00), w10 + u[1] * (w11 - w10)
        return left + u[0] * (right - left)
