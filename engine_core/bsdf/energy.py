# SPDX-License-Identifier: GPL-3.0-or-later
"""How much GGX reflects in all, tabulated over roughness and the viewer's cosine.

The tables are computed when first asked for. Nodes are Cycles' own, and so is the linear interpolation
between them, whose error is seen in pictures.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from . import fresnel

COARSE, FINE = 16, 32
"""Nodes along an axis of the tables in three dimensions, and in two or one."""

POINTS, STEP = 610, 377
"""Of the lattice, two Fibonacci numbers; it errs by 5e-4 at most, 1.6e-4 in the mean."""


def reflected(roughness: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Share of light, even from all sides, that facets of reflectance 1 send to the viewer once."""
    return _interpolated(_tables()[0], roughness, cosine)


def mean_reflected(roughness: np.ndarray) -> np.ndarray:
    """The integral of 2 cos `reflected` over cos."""
    return _interpolated(_tables()[1], roughness)


def fresnel_share(roughness: np.ndarray, cosine: np.ndarray, ior: np.ndarray) -> np.ndarray:
    """s of a dielectric's albedo f0 + (1 - f0) s, all facets' light being seen."""
    return _interpolated(_fresnel_table(), roughness, cosine, np.sqrt(np.abs((ior - 1) / (ior + 1))))


def _interpolated(table: np.ndarray, *place: np.ndarray) -> np.ndarray:
    """Multilinear, at coordinates in [0, 1], one for each of the table's axes."""
    index, parts = np.intp(0), []
    # From the last, so that those before keep their numbers.
    for axis in reversed(range(table.ndim)):
        size = table.shape[axis]
        x = np.clip(place[axis], 0, 1) * np.float32(size - 1)
        low = np.minimum(x.astype(np.intp), size - 2)
        part = x - low.astype(np.float32)
        if np.ndim(x) == 0:
            # What is the same everywhere is looked up but once.
            near, far = table.take(low, axis), table.take(low + 1, axis)
            table = near + part * (far - near)
        else:
            index = index + low * int(np.prod(table.shape[axis + 1 :]))
            parts.insert(0, part)
    flat = table.reshape(-1)
    strides = [int(np.prod(table.shape[axis + 1 :])) for axis in range(table.ndim)]

    def corner(axis: int, offset: int) -> np.ndarray:
        if axis == table.ndim:
            return flat.take(index + offset)
        near, far = corner(axis + 1, offset), corner(axis + 1, offset + strides[axis])
        return near + parts[axis] * (far - near)

    return corner(0, 0)


def _nodes(size: int) -> np.ndarray:
    return np.maximum(np.linspace(0, 1, size), 1e-4)


def _facets(roughness: np.ndarray, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shares (P,) of visible normals; (..., P) how much of each one's light is not masked; its cosine.

    The normals are those that `microfacet.GGX` samples, on one side of the viewer.
    """
    # A Fibonacci lattice; close to u = 1 lie the steepest facets, whose light is on the verge of the
    # horizon, so points crowd there.
    i = np.arange(POINTS)
    rest = (i + 0.5) / POINTS
    share = 2 * rest / POINTS
    u = 1 - rest * rest
    angle = i * STEP % POINTS * (np.pi / POINTS)
    alpha, cos = np.broadcast_arrays((roughness * roughness)[..., None], cosine[..., None])
    sine = np.sqrt(1 - cos * cos)
    x, z = alpha * sine, cos
    scale = 1 / np.sqrt(x * x + z * z)
    x, z = x * scale, z * scale
    height = (1 - u) * (1 + z) - z
    radius = np.sqrt(np.maximum(1 - height * height, 0))
    m = alpha * (x + radius * np.cos(angle)), alpha * radius * np.sin(angle), z + height
    inverse = 1 / np.sqrt(m[0] ** 2 + m[1] ** 2 + m[2] ** 2)
    towards = (m[0] * sine + m[2] * cos) * inverse
    out = 2 * towards * m[2] * inverse - cos

    def area(c: np.ndarray) -> np.ndarray:
        return (c + np.sqrt(c * c + alpha * alpha * (1 - c * c))) / 2

    seen, lit = area(cos), area(np.clip(out, 1e-9, 1))
    # G_2 / G_1
    return share, np.where(out > 0, seen * out / (out * seen + cos * lit - cos * out), 0), towards


def _albedo(roughness: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    share, seen, _ = _facets(roughness, cosine)
    return seen @ share


@cache
def _tables() -> tuple[np.ndarray, np.ndarray]:
    """(FINE, FINE) of roughness and cosine, and (FINE,) the mean."""
    rough = _nodes(FINE)[:, None]
    directional = _albedo(rough, _nodes(FINE)[None])
    x, share = np.polynomial.legendre.leggauss(12)
    x = (x + 1) / 2
    mean = (_albedo(rough, x[None]) * x * share).sum(-1)
    return directional.astype(np.float32), mean.astype(np.float32)


@cache
def _fresnel_table() -> np.ndarray:
    """(COARSE, COARSE, COARSE) of roughness, cosine and z = F0^(1/4).

    The mean over visible normals. Those that reflect below the surface count as black; masking does not.
    """
    nodes = _nodes(COARSE)
    share, seen, cosine = _facets(nodes[:, None], nodes[None])
    share = share * (seen > 0)
    table = np.empty((COARSE,) * 3, np.float32)
    # An index of exactly 1 reflects nothing, not even where the cosine is 0.
    table[..., 0] = 0
    for k, z in enumerate(np.minimum(nodes, 0.99)[1:], 1):
        ior = fresnel.ior_of(z**4)
        real = fresnel.normal_reflectance(ior)
        table[..., k] = (share * np.maximum(fresnel.dielectric(cosine, ior) - real, 0)).sum(-1) / (1 - real)
    return table
