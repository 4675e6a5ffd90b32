# SPDX-License-Identifier: GPL-3.0-or-later
"""Which light a sample goes to.

The picture is parted into blocks of 16 x 16 pixels, aligned to the whole frame. A few pilot rays
through each block, whose points come from the block alone, find what is lit there; a light is then
chosen in proportion to its mean unshadowed irradiance at the pilots' hits, with a part for what
lights the whole frame and a part for all lights alike, so that none that could matter is ever missed. The
pilots do not enter the picture: the estimate stays unbiased, and it is the same for any tile.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .emitters import Emitters

BLOCK = 16
"""Edge of a block in pixels."""

PILOT_GRID = 4
"""Pilot rays a block, along each edge."""

# Parts of the mixture: the block's own pilots, those of the whole frame, and all lights alike.
_OWN, _AROUND, _ALIKE = 0.8, 0.15, 0.05

# Lights x points evaluated at once: keeps the temporary arrays within some 16 MB.
_CHUNK = 1 << 20


class LightChoice:
    """Discrete distributions over all lights of a scene, one for each of K blocks.

    pdf : (K, L) float32. cdf : (K, L) float32, inclusive; the last entry is 1.
    """

    def __init__(self, pdf: np.ndarray) -> None:
        """pdf : (K, L), rows sum to 1."""
        self.pdf = pdf.astype(np.float32)
        self.cdf = np.cumsum(pdf, axis=1).astype(np.float32)
        self.cdf[:, -1] = 1

    def choose(self, block: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lights (M * S,), their probabilities, and ``w`` stretched over the chosen interval.

        block : (M,) ascending rows of the table. w : (M, S) uniform in (0, 1).
        """
        light = np.empty(w.shape, np.intp)
        starts = np.flatnonzero(np.diff(block, prepend=-1))
        for start, stop in zip(starts, np.append(starts[1:], len(w)), strict=True):
            light[start:stop] = np.searchsorted(self.cdf[block[start]], w[start:stop], side="right")
        lights = self.cdf.shape[1]
        np.minimum(light, lights - 1, out=light)
        flat = (light + block[:, None] * lights).reshape(-1)
        pdf = self.pdf.reshape(-1).take(flat)
        stretched = w.reshape(-1) - self.cdf.reshape(-1).take(flat)
        stretched /= pdf
        stretched += 1
        np.clip(stretched, 0, np.float32(1 - 2.0**-24), out=stretched)
        return light.reshape(-1), pdf, stretched


def mean_irradiance(
    groups: Sequence[Emitters], position: np.ndarray, normal: np.ndarray, found: np.ndarray
) -> np.ndarray:
    """(K, L) mean unshadowed irradiance of every light over the points of each block; 0 without points.

    position, normal : (3, K, P) float32, P points a block. found : (K, P) bool, which of them are any.
    """
    blocks, points = found.shape
    lights = sum(len(group) for group in groups)
    total = np.zeros((blocks, lights))
    step = max(1, _CHUNK // (lights * points))
    # Each block is summed over its own points alone, in one order, so that its distribution is the
    # same whatever other blocks it is computed with.
    for start in range(0, blocks, step):
        part = slice(start, start + step)
        where = (position[:, part].reshape(3, -1), normal[:, part].reshape(3, -1))
        estimate = np.concatenate([group.irradiance(*where) for group in groups], axis=0)
        np.nan_to_num(estimate, copy=False, posinf=0, neginf=0)
        estimate = estimate.reshape(lights, -1, points) * found[part]
        total[part] = estimate.sum(axis=2).T
    return total / np.maximum(found.sum(axis=1), 1)[:, None]


def light_choice(irradiance: np.ndarray, overview: np.ndarray) -> LightChoice:
    """The mixture for (K, L) mean irradiances of blocks and (L,) the whole frame's."""
    lights = irradiance.shape[1]

    def normalised(rows: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
        total = rows.sum(axis=-1, keepdims=True)
        return np.where(total > 0, rows / np.where(total > 0, total, 1), otherwise)

    alike = np.full(lights, 1 / lights)
    around = normalised(overview, alike)
    own = normalised(irradiance, around)
    return LightChoice(_OWN * own + _AROUND * around + _ALIKE * alike)
