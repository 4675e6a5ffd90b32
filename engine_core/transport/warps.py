# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps from the unit square to disks, caps and hemispheres, and frames to place them in."""

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
