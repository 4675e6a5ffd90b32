# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture in which nothing is below black, and of which what is seen is no brighter for that.

Noise about little light may be below zero. To cut it off there makes dark parts too bright, the more the
noisier they are. What is missing below is taken off what is above around it instead, in proportion:

    p_i' = p_i (1 - sum_j w_ij n_j / sum_k w_kj p_k),   p = max(f, 0), n = max(-f, 0),

so that the sum over pixels stays, as long as there is enough around.
"""

from __future__ import annotations

import itertools

import numpy as np

WEIGHTS = np.array([1, 2, 3, 2, 1], np.float32) / 9
"""Of pixels around, along each axis."""


def raise_negative(pixels: np.ndarray) -> None:
    """Change pixels (H, W, C) float32 in place so that none is below zero, and means over them stay."""
    if not pixels.min(initial=0) < 0:
        return
    reach, (height, width, channels) = len(WEIGHTS) // 2, pixels.shape
    # Of all numbers at once: several times faster than pixel by pixel.
    index = np.flatnonzero(pixels.reshape(-1) < 0) // channels
    y, x = np.divmod(index[np.diff(index, prepend=-1) > 0], width)
    missing = np.maximum(-pixels[y, x], 0)
    np.maximum(pixels, 0, out=pixels)
    # With a margin in which there is nothing.
    around = np.zeros((height + 2 * reach, width + 2 * reach, channels), np.float32)
    corner = y * around.shape[1] + x
    offsets = [
        (down * right, dy * around.shape[1] + dx)
        for (dy, down), (dx, right) in itertools.product(enumerate(WEIGHTS), repeat=2)
    ]
    inner = around[reach:-reach, reach:-reach]
    inner[:] = pixels
    rows, there = around.reshape(-1, channels), np.zeros_like(missing)
    for weight, offset in offsets:
        there += weight * rows.take(corner + offset, axis=0)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        part = np.where(there > 0, np.minimum(missing / there, np.finfo(np.float32).max), 0)
    rows[:] = 1
    for weight, offset in offsets:
        # Of one offset, no place is twice among these.
        rows[corner + offset] -= weight * part
    np.maximum(inner, 0, out=inner)
    pixels *= inner
