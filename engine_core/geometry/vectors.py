# SPDX-License-Identifier: GPL-3.0-or-later
"""Arithmetic of component-first vectors: arrays (3, ...)."""

from __future__ import annotations

import numpy as np


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Inner products of (3, ...) vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def length(a: np.ndarray) -> np.ndarray:
    """Lengths of (3, ...) vectors."""
    return np.sqrt(dot(a, a))


def take(a: np.ndarray, index: np.ndarray) -> np.ndarray:
    """``a[..., index]`` (index in range), several times faster than NumPy's own indexing."""
    return a.take(index, axis=-1, mode="clip")


def inverse_length(a: np.ndarray) -> np.ndarray:
    """1 / |a| of (3, N) float32 vectors, 0 for a null vector; safe from underflow of the square."""
    square = dot(a, a)
    with np.errstate(divide="ignore", over="ignore"):
        inverse = 1 / np.sqrt(square)
    tiny = ~((square > 1e-30) & (square < 1e30))
    if tiny.any():
        where = np.flatnonzero(tiny)
        largest = np.abs(a[:, where]).max(axis=0)
        safe = np.where(largest > 0, largest, 1)
        scaled = a[:, where] / safe
        length = np.sqrt(dot(scaled, scaled))
        inverse[where] = np.where(largest > 0, 1 / np.maximum(length * safe, 1e-37), 0)
    return inverse
