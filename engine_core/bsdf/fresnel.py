# SPDX-License-Identifier: GPL-3.0-or-later
"""Fresnel reflectance: of dielectrics, exact, and of metals by the F82-tint model."""

from __future__ import annotations

import numpy as np


def dielectric(cosine: np.ndarray, ior: np.ndarray) -> np.ndarray:
    """Unpolarised reflectance towards a medium of relative index ``ior``; 1 where reflection is total.

    cosine : of incidence, in [0, 1].
    """
    g = np.sqrt(np.maximum(ior * ior - 1 + cosine * cosine, 0))
    plus = g + cosine
    plus += np.float32(1e-20)
    minus = g - cosine
    a = minus / plus
    # The divisor vanishes only with g at normal incidence, where there is no refraction at all.
    b = (cosine * plus - 1) / np.maximum(cosine * minus + 1, np.float32(1e-20))
    b *= b
    b += 1
    b *= np.float32(0.5)
    a *= a
    b *= a
    return np.minimum(b, 1, out=b)


def normal_reflectance(ior: np.ndarray) -> np.ndarray:
    """Reflectance at normal incidence."""
    r = (ior - 1) / (ior + 1)
    return r * r


def ior_of(normal_reflectance: np.ndarray) -> np.ndarray:
    """The index, at least 1, of a dielectric of this reflectance at normal incidence."""
    root = np.sqrt(np.clip(normal_reflectance, 0, np.float32(0.99)))
    return (1 + root) / (1 - root)


def mean_dielectric(ior: np.ndarray) -> np.ndarray:
    """The integral of 2 cos F over cos, by the fit of C. Kulla and A. Conty, "Revisiting Physically Based
    Shading at Imageworks", 2017."""
    inside = np.float32(0.997118) + ior * (0.1014 - ior * (0.965241 + ior * 0.130607))
    return np.where(ior < 1, inside, (ior - 1) / (4.08567 + np.float32(1.00071) * ior)).astype(np.float32)


EDGE_COSINE = 1 / 7
"""Where F82 tints, about 82 degrees."""


def edge_tint(f0: np.ndarray, tint: np.ndarray) -> np.ndarray:
    """b of F = Schlick - b cos (1 - cos)^6, so that F is ``tint`` times Schlick's at `EDGE_COSINE`.

    C. Kutz, M. Hasan and M. Edmondson, "Novel Aspects of the Adobe Standard Material", 2021.
    """
    s = 1 - EDGE_COSINE
    schlick = f0 + (1 - f0) * np.float32(s**5)
    return schlick * (1 - tint) * np.float32(1 / (EDGE_COSINE * s**6))


def mean_metal(f0: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The integral of 2 cos F over cos."""
    return f0 + (1 - f0) * np.float32(1 / 21) - b * np.float32(1 / 126)


def metal(cosine: np.ndarray, f0: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, N) from f0 and b (3, N) and the cosine (N,)."""
    s = np.maximum(1 - cosine, 0)
    power = s * s
    power *= power
    power *= s
    value = (1 - f0) * power
    value += f0
    power *= s
    power *= cosine
    value -= b * power
    return np.clip(value, 0, 1, out=value)
