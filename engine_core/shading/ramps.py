# SPDX-License-Identifier: GPL-3.0-or-later
"""Ramps: functions of a number given by a table of evenly spaced entries."""

from __future__ import annotations

import numpy as np

from .arithmetic import mix, saturate

ENTRIES = 256
"""Of every table, as in Cycles."""


def look_up(table: np.ndarray, interpolate: bool, x: np.ndarray) -> np.ndarray:
    """(C, ...) of ``table`` (C, ENTRIES) at x in [0, 1], held beyond; between entries linear, or stepped."""
    place = saturate(np.atleast_1d(x)) * np.float32(ENTRIES - 1)
    entry = np.minimum(np.nan_to_num(place).astype(np.int32), ENTRIES - 1)
    found = table.take(entry, axis=1)
    if not interpolate:
        return found
    following = table.take(np.minimum(entry + 1, ENTRIES - 1), axis=1)
    return mix(place - entry, found, following)


def look_up_beyond(table: np.ndarray, x: np.ndarray) -> np.ndarray:
    """`look_up`, but straight on beyond the ends."""
    ends = table[:, :1] - table[:, 1:2], table[:, -1:] - table[:, -2:-1]
    x = np.atleast_1d(x)
    below, above = np.maximum(-x, 0) * (ENTRIES - 1), np.maximum(x - 1, 0) * (ENTRIES - 1)
    return look_up(table, True, x) + ends[0] * below + ends[1] * above


def curves(
    table: np.ndarray, start: float, end: float, beyond: bool, factor: np.ndarray, value: np.ndarray
) -> np.ndarray:
    """Each component of ``value`` through its own row of ``table``, which spans [start, end]."""
    look = look_up_beyond if beyond else lambda row, x: look_up(row, True, x)
    x = np.atleast_2d((value - np.float32(start)) / np.float32(end - start))
    mapped = np.stack([look(table[k : k + 1], x[k])[0] for k in range(len(x))])
    return mix(factor, value, mapped.reshape(np.broadcast_shapes(value.shape)))
