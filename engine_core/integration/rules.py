# SPDX-License-Identifier: GPL-3.0-or-later
"""Simpson's rule and the quadratic through its nodes; Gauss-Legendre points. All on [0, 1]."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

SIMPSON = np.array([1.0, 4.0, 1.0]) / 6.0
"""Weights of the nodes 0, 1/2, 1 (thesis eq. 4.3 in one dimension)."""


def lagrange(t: np.ndarray) -> np.ndarray:
    """(3, ...) the quadratics that are 1 at one of the nodes 0, 1/2, 1 and 0 at the others.

    The nodal form: as well conditioned as the values themselves, wherever the region lies.
    """
    t = np.asarray(t)
    out = np.empty((3, *t.shape), t.dtype)
    twice = t + t
    np.subtract(1, twice, out=out[2])  # 1 - 2t
    np.subtract(1, t, out=out[1])
    np.multiply(out[1], out[2], out=out[0])  # (1 - t)(1 - 2t)
    np.multiply(out[1], twice, out=out[1])
    out[1] += out[1]  # 4t (1 - t)
    np.multiply(out[2], t, out=out[2])
    np.negative(out[2], out=out[2])  # t (2t - 1)
    return out


TRAPEZOID = np.array([1.0, 0.0, 1.0]) / 2.0
"""The trapezoid rule's weights of the same nodes."""


@lru_cache(64)
def bin_means(count: int) -> np.ndarray:
    """(count, 3) exact means of the three `lagrange` quadratics over equal bins of [0, 1]."""
    edges = np.arange(count + 1) / count
    low, high = edges[:-1], edges[1:]
    mean = (low + high) / 2
    square = (low * low + low * high + high * high) / 3
    out = np.stack([1 - 3 * mean + 2 * square, 4 * (mean - square), 2 * square - mean], axis=1)
    out.setflags(write=False)
    return out


def gauss(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights (count,) of the Gauss-Legendre rule on [0, 1]; exact to degree 2 count - 1."""
    x, w = np.polynomial.legendre.leggauss(count)
    return (x + 1) / 2, w / 2


def tensor_weights(rules: list[np.ndarray]) -> np.ndarray:
    """(product of the sizes,) weights of a tensor grid, the last dimension fastest, from those along each."""
    weights = np.ones(1)
    for rule in rules:
        weights = np.multiply.outer(weights, rule).ravel()
    return weights


def weighted(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Sums (...) of values (..., n) times weights (n,).

    Not by ``@``: that is OpenBLAS's, which would share out these few numbers among threads of its own, on
    processors that are busy; it took 80 times as long.
    """
    return np.einsum("...n,n->...", values, weights)


def face_weights(dimensions: int) -> np.ndarray:
    """(3^dimensions,) Simpson's weights of a tensor grid."""
    return tensor_weights([SIMPSON] * dimensions)


def nested_rules(dimensions: int) -> np.ndarray:
    """(1 + D, 3^D) weights: Simpson's rule in all dimensions, then with the trapezoidal one in each."""
    rules = [
        [TRAPEZOID if d == trapezoid else SIMPSON for d in range(dimensions)]
        for trapezoid in range(-1, dimensions)
    ]
    return np.stack([tensor_weights(rule) for rule in rules])


def tensor_points(coordinates: list[np.ndarray]) -> np.ndarray:
    """(D, product of the sizes) points of a tensor grid in [0, 1]^D, the last dimension fastest."""
    return np.stack(np.meshgrid(*coordinates, indexing="ij")).reshape(len(coordinates), -1)


def grid_nodes(dimensions: int) -> np.ndarray:
    """(D, 3^D) nodes of the rule in the unit cube."""
    return tensor_points([np.array([0, 0.5, 1])] * dimensions)


def new_nodes(dimensions: int, split: int) -> np.ndarray:
    """(D, 2 * 3^(D-1)) nodes that halving in dimension ``split`` adds, in the parent's coordinates."""
    coordinates = [np.array([0, 0.5, 1])] * dimensions
    coordinates[split] = np.array([0.25, 0.75])
    return tensor_points(coordinates)


def halves(nodes: np.ndarray, new: np.ndarray, dimensions: int, split: int) -> tuple[np.ndarray, np.ndarray]:
    """Node values of both children, each (..., 3^D, N), from the parent's and from the ``new_nodes``'."""
    apart = (*nodes.shape[:-2], 3**split, -1, 3 ** (dimensions - 1 - split), nodes.shape[-1])
    p, n = nodes.reshape(apart), new.reshape(apart)
    low = np.concatenate([p[..., :1, :, :], n[..., :1, :, :], p[..., 1:2, :, :]], axis=-3)
    high = np.concatenate([p[..., 1:2, :, :], n[..., 1:, :, :], p[..., 2:, :, :]], axis=-3)
    return low.reshape(nodes.shape), high.reshape(nodes.shape)
