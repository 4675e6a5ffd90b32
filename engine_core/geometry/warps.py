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
