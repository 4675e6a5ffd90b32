# SPDX-License-Identifier: GPL-3.0-or-later
"""Normal maps: unit normals in world space, towards the viewer's side, as Cycles defines them."""

from __future__ import annotations

import numpy as np

from .arithmetic import cross, mix, saturate, unit
from .coordinates import NORMAL, OBJECT_TO_WORLD, normal_to_world, perpendicular
from .values import Attribute, Value, compute


def tangent_frame(layer: str) -> Attribute:
    """(7, N) in the object's space: tangent along u, its handedness, and the normal, not normalized."""
    return Attribute(f"tangent:{layer}", 7)


def uv_tangent(layer: str) -> Value:
    """(3, N) unit tangent along u of a UV map."""

    def tangent(frame: np.ndarray, matrix: np.ndarray, normal: np.ndarray) -> np.ndarray:
        return perpendicular(normal_to_world(matrix, frame[0:3]), normal)

    return compute(tangent, tangent_frame(layer), OBJECT_TO_WORLD, NORMAL)


def in_tangent_space(
    colour: np.ndarray,
    strength: np.ndarray,
    frame: np.ndarray,
    matrix: np.ndarray,
    surface: np.ndarray,
    back: np.ndarray,
) -> np.ndarray:
    """(3, N) from a map along the tangent, the bitangent and the normal of a `tangent_frame`."""
    x, y, z = 2 * colour - 1
    x, y, z = x * strength, y * strength, mix(saturate(strength), np.float32(1), z)
    tangent, sign, normal = frame[0:3], frame[3], frame[4:7]
    bent = normal_to_world(matrix, x * tangent + y * sign * cross(normal, tangent) + z * normal)
    return _facing(np.where(tangent.any(axis=0), bent, 0), surface, back)


def in_space(
    object_space: bool,
    colour: np.ndarray,
    strength: np.ndarray,
    matrix: np.ndarray,
    surface: np.ndarray,
    back: np.ndarray,
) -> np.ndarray:
    """(3, N) from a map in the object's or the world's space."""
    bent = 2 * colour - 1
    bent = normal_to_world(matrix, bent) if object_space else unit(bent)
    bent = _facing(bent, surface, back)
    return unit(mix(np.maximum(strength, 0), surface, bent))


def _facing(bent: np.ndarray, surface: np.ndarray, back: np.ndarray) -> np.ndarray:
    """``bent`` turned over where the back is seen; ``surface`` where it is nothing."""
    known = np.isfinite(bent).all(axis=0) & bent.any(axis=0)
    return np.where(known, np.where(back > 0, -bent, bent), surface)
