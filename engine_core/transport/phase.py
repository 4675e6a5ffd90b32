# SPDX-License-Identifier: GPL-3.0-or-later
"""The phase function of Henyey and Greenstein: where fog scatters light to.

The angle is that between the directions of travel before and after, so that g > 0 scatters forwards. It is
given by the squared sine and cosine of its half, ``less`` = (1 - cos) / 2 and ``more`` = (1 + cos) / 2:
of these the denominator 1 + g^2 - 2 g cos is a sum without cancellation, however peaked the function.

L. G. Henyey, J. L. Greenstein, "Diffuse radiation in the galaxy", 1941.
"""

from __future__ import annotations

import numpy as np

from ..geometry.vectors import dot
from ..geometry.warps import TWO_PI, basis

LARGEST_G = 1 - 1e-4
"""Size that g is cut to: beyond, all light goes where no sample looks."""

ISOTROPIC = np.float32(0.25 / np.pi)
"""`value` for g = 0."""


def bounded(g: np.ndarray) -> np.ndarray:
    """``g`` within what the other functions take."""
    return np.clip(g, -LARGEST_G, LARGEST_G)


def half_angle(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``less`` and ``more`` (M,) of unit directions of travel (3, M)."""
    apart, together = after - before, after + before
    return dot(apart, apart) / 4, dot(together, together) / 4


def value(less: np.ndarray, more: np.ndarray, g: np.ndarray | float) -> np.ndarray:
    """Density per solid angle, 1/sr: what part of scattered light goes where, and the pdf of `sample`."""
    base = (1 - g) ** 2 * more
    base += (1 + g) ** 2 * less
    root = np.sqrt(base)
    root *= base
    return ((1 - g * g) / (4 * np.pi)) / root


def width(g: np.ndarray | float) -> np.ndarray | float:
    """Part of all directions that its peak fills, 1 over the integral of 4 pi `value`^2: by its Legendre
    series, over the sum of (2 l + 1) g^(2 l).
    """
    return (1 - g * g) ** 2 / (1 + g * g)


def sample(before: np.ndarray, g: np.ndarray | float, u: np.ndarray) -> np.ndarray:
    """Directions of travel after scattering (3, M), of unit directions before (3, M), for u (2, M)."""
    root = 1 - g + 2 * g * u[0]
    # Each end's own form of the inverse cdf: exact at both, and for g = 0, too.
    more = (1 + g) ** 2 * u[0] * (1 - g + g * u[0]) / (root * root)
    less = (1 - g) ** 2 * (1 - u[0]) * (1 + g * u[0]) / (root * root)
    sine = 2 * np.sqrt(np.maximum(less * more, 0))
    phi = TWO_PI * u[1]
    s, t = basis(before)
    return (sine * np.cos(phi)) * s + (sine * np.sin(phi)) * t + (more - less) * before
