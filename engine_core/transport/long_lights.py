# SPDX-License-Identifier: GPL-3.0-or-later
"""How a ray passes a light that is longer than wide: a tube, a window's gap."""

from __future__ import annotations

import numpy as np

from ..geometry.vectors import dot


def past(
    core: np.ndarray, vector: np.ndarray, foot: np.ndarray, direction: np.ndarray, square: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of rays ``direction`` (3, ...) and stretches from -``core`` to ``core`` (3, ...) about lights' middles:
    squares (...) of their harmonic mean distance from the ray's line; which place (...), from -1 to 1, is the
    nearest, the middle if all are; and how far (...) along the ray a core reaches.

    vector : (3, ...) from the ray's origin to the middle. foot : (...) where along the ray it is nearest.
    square : (...) of its distance there, more than 0: that includes what softens it.

    What one point scatters into the whole ray falls as 1 / D (thesis eq. 6.5), so the mean of that is what
    all points do. Along a straight line it is the potential of a charged rod: by the distances of both ends
    and the length as the ray sees it,

        mean of 1 / D = 2 artanh(z) / (z (D1 + D2)),    z = length / (D1 + D2).
    """
    along = dot(core, direction)
    cross = dot(core, vector) - foot * along
    size = dot(core, core)
    half = np.maximum(size - along * along, 0)
    near = np.clip(-cross / np.maximum(half + 1e-4 * size, 1e-30), -1, 1)
    whole = square + half
    ends = np.sqrt(np.maximum(whole + 2 * cross, 1e-36)) + np.sqrt(np.maximum(whole - 2 * cross, 1e-36))
    z = np.clip(2 * np.sqrt(half) / ends, 1e-3, 1 - 1e-6)
    distance = 0.5 * ends * z / np.arctanh(z)
    return distance * distance, near, along
