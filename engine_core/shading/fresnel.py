# SPDX-License-Identifier: GPL-3.0-or-later
"""How a surface looks from the side: the Fresnel and Layer Weight nodes."""

from __future__ import annotations

import numpy as np

from ..bsdf.fresnel import dielectric
from ..geometry.vectors import dot


def _cosine(towards_viewer: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return np.minimum(np.abs(dot(towards_viewer, normal)), 1)


def fresnel(ior: np.ndarray, normal: np.ndarray, towards_viewer: np.ndarray, back: np.ndarray) -> np.ndarray:
    """(N,) reflectance of a dielectric; seen from the back, of its inside."""
    ior = np.maximum(ior, np.float32(1e-5))
    cosine = _cosine(towards_viewer, normal)
    relative = np.where(back > 0, 1 / ior, ior)
    # Below the critical angle's cosine, reflection is total.
    total = relative * relative - 1 + cosine * cosine <= 0
    return np.where(total, 1, dielectric(cosine, relative))


def layer_fresnel(
    blend: np.ndarray, normal: np.ndarray, towards_viewer: np.ndarray, back: np.ndarray
) -> np.ndarray:
    ior = 1 / np.maximum(1 - blend, np.float32(1e-5))
    return fresnel(ior, normal, towards_viewer, back)


def facing(blend: np.ndarray, normal: np.ndarray, towards_viewer: np.ndarray) -> np.ndarray:
    """(N,) 0 where the surface faces the viewer, 1 at its rim."""
    blend = np.clip(blend, 0, np.float32(1 - 1e-5))
    exponent = np.where(blend < 0.5, 2 * blend, np.float32(0.5) / (1 - blend))
    return 1 - _cosine(towards_viewer, normal) ** exponent
