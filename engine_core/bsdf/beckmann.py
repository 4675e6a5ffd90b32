# SPDX-License-Identifier: GPL-3.0-or-later
"""Microfacets whose slopes are normally distributed (P. Beckmann and A. Spizzichino)."""

from __future__ import annotations

import numpy as np

from ..geometry.vectors import dot
from .microfacet import Microfacet

HALF_SQRT_PI = np.float32(np.sqrt(np.pi) / 2)
STEPS = 12
"""Of Newton's method: what is left in the tails, one slope in a million, is not seen."""


class Beckmann(Microfacet):
    """Masking is exact, not one of the usual rational fits."""

    @staticmethod
    def _area(cosine: np.ndarray, stretched: np.ndarray) -> np.ndarray:
        sine = np.sqrt(stretched)
        limit = np.minimum(cosine / np.maximum(sine, np.float32(1e-20)), 9)
        return _slopes_below(limit, cosine, sine) / (2 * HALF_SQRT_PI)

    @staticmethod
    def _density(square: np.ndarray, along: np.ndarray, slope: np.ndarray, widths: np.ndarray) -> np.ndarray:
        along_square = np.maximum(along * along, np.float32(1e-30))
        density = square / along_square
        density *= density
        density *= np.exp(-slope / along_square)
        density /= widths * np.float32(np.pi)
        return density

    @staticmethod
    def _sample_normal(viewer: np.ndarray, alpha: np.ndarray, u: np.ndarray) -> np.ndarray:
        """A visible normal by its slopes: one towards the viewer, with density (cos - x sin) exp(-x^2), and
        one across, which is normal. E. Heitz and E. d'Eon, "Importance Sampling Microfacet-Based BSDFs using
        the Distribution of Visible Normals", 2014; the equation is solved by Newton's method.
        """
        x, y, cosine = viewer[0] * alpha[0], viewer[1] * alpha[1], viewer[2]
        inverse = 1 / np.sqrt(x * x + y * y + cosine * cosine)
        x, y, cosine = x * inverse, y * inverse, cosine * inverse
        sine = np.sqrt(x * x + y * y)
        safe = np.maximum(sine, np.float32(1e-20))
        towards = _invert(u[1], cosine, sine, np.minimum(cosine / safe, 5))
        across = _invert(u[0], np.ones_like(sine), np.zeros_like(sine), np.full_like(sine, 5))
        cos, sin = np.where(sine > 0, x / safe, 1), y / safe
        m = np.empty_like(viewer)
        m[0] = (sin * across - cos * towards) * alpha[0]
        m[1] = (-cos * across - sin * towards) * alpha[1]
        m[2] = 1
        m /= np.sqrt(dot(m, m))
        return m


def _slopes_below(x: np.ndarray, cosine: np.ndarray, sine: np.ndarray) -> np.ndarray:
    """The integral of (cosine - s sine) exp(-s^2) over slopes s from -inf to ``x``."""
    # erf: M. Abramowitz and I. Stegun, 7.1.26; absolute error 1.5e-7.
    t = 1 / (1 + np.float32(0.3275911) * np.abs(x))
    series = t * (
        0.254829592
        + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * np.float32(1.061405429))))
    )
    gauss = np.exp(-x * x)
    tail = series * gauss
    return HALF_SQRT_PI * cosine * np.where(x < 0, tail, 2 - tail) + np.float32(0.5) * sine * gauss


def _invert(u: np.ndarray, cosine: np.ndarray, sine: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The slope below which lies the share ``u`` of those up to ``end``."""
    wanted = u * _slopes_below(end, cosine, sine)
    # From the mode, where the integral turns from convex to concave, all steps go the same way.
    x = -sine / (cosine + np.sqrt(cosine * cosine + 2 * sine * sine))
    for _ in range(STEPS):
        density = (cosine - x * sine) * np.exp(-x * x)
        x = x - (_slopes_below(x, cosine, sine) - wanted) / np.maximum(density, np.float32(1e-12))
        x = np.clip(x, -5, end)
    return x
