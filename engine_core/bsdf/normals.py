# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals that glossy lobes can have, and tangents for them."""

from __future__ import annotations

import numpy as np

from ..geometry.vectors import dot, inverse_length, take
from ..geometry.warps import basis


def valid_reflection_normal(
    normal: np.ndarray, geometric: np.ndarray, towards_viewer: np.ndarray
) -> np.ndarray:
    """``normal`` (3, N), lifted towards the ``geometric`` one where it mirrors the viewer below the surface.

    As in Cycles, the mirrored direction is put just above the surface. In the plane of both normals, with
    the geometric one as z and w = `towards_viewer`, n = (x, z) has to fulfil 2 (n.w) z - w_z = t, which
    squared becomes 4 a z^4 - 2 b z^2 + c = 0.
    """
    height = dot(towards_viewer, geometric)
    mirrored = 2 * dot(normal, towards_viewer) * dot(normal, geometric) - height
    lowest = np.minimum(np.float32(0.9) * height, np.float32(0.01))
    low = np.flatnonzero((mirrored < lowest) & (height > 0))
    if low.size == 0:
        return normal
    n, g, w = take(normal, low), take(geometric, low), take(towards_viewer, low)
    z, t = height.take(low), lowest.take(low)
    x = n - dot(n, g) * g
    x *= inverse_length(x)
    along = dot(w, x)
    a = along * along + z * z
    b = 2 * (a + z * t)
    root = np.sqrt(np.maximum(b * b - 4 * a * (t + z) ** 2, 0))
    square = np.clip(np.float32(0.25) * np.where(along < 0, b + root, b - root) / a, 0, 1)
    lifted = np.array(normal)
    lifted[:, low] = np.sqrt(1 - square) * x + np.sqrt(square) * g
    return lifted


def tangent_along(direction: np.ndarray, normal: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """(3, N) unit tangents: ``direction`` made perpendicular, and turned about the normal ``turn`` times."""
    across = direction - dot(direction, normal) * normal
    across *= inverse_length(across)
    # Of what is all but along the normal that left what was rounded off, in any direction.
    across -= dot(across, normal) * normal
    left = np.sqrt(dot(across, across))
    x = np.where(left > 0.5, across / np.maximum(left, np.float32(0.5)), basis(normal)[0])
    if not np.any(turn):
        return x
    angle = np.float32(2 * np.pi) * turn
    y = np.stack([normal[i - 2] * x[i - 1] - normal[i - 1] * x[i - 2] for i in range(3)])
    return np.cos(angle) * x + np.sin(angle) * y


def radial_tangent(generated: np.ndarray) -> np.ndarray:
    """Directions round the z axis through the middle of the texture space: ``generated`` (3, N) in [0, 1]."""
    return np.stack([0.5 - generated[1], generated[0] - 0.5, np.zeros_like(generated[0])])
