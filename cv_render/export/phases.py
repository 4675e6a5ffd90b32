# SPDX-License-Identifier: GPL-3.0-or-later
"""The phase functions of Cycles as Henyey-Greenstein's of the same mean cosine."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ...engine_core.shading.values import compute

if TYPE_CHECKING:
    from .nodes import Node

LARGEST = 1 - 1e-3
"""Of an anisotropy, as in Cycles."""


def lobes(node: Node) -> Iterator[tuple[Any, Any]]:
    """(share, anisotropy) of each Henyey-Greenstein lobe that a volume node scatters with."""
    phase = getattr(node.options, "phase", "HENYEY_GREENSTEIN")  # a choice from 4.3 on
    if phase == "HENYEY_GREENSTEIN":
        yield 1.0, compute(held, *node.values("Anisotropy"))
        return
    node.tell(f"{_NAMES[phase]} is rendered as Henyey-Greenstein of the same mean cosine")
    if phase == "RAYLEIGH":
        yield 1.0, 0.0
    elif phase == "DRAINE":
        yield 1.0, compute(draine, *node.values("Anisotropy", "Alpha"))
    elif phase == "FOURNIER_FORAND":
        yield 1.0, compute(fournier_forand, *node.values("Backscatter", "IOR"))
    else:
        fit = compute(mie, *node.values("Diameter"))
        yield compute(lambda f: 1 - f[3], fit), compute(lambda f: held(f[0]), fit)
        yield compute(lambda f: f[3], fit), compute(lambda f: draine(f[1], f[2]), fit)


_NAMES = {"RAYLEIGH": "Rayleigh", "DRAINE": "Draine", "FOURNIER_FORAND": "Fournier-Forand", "MIE": "Mie"}


def held(g: np.ndarray) -> np.ndarray:
    return np.clip(g, -LARGEST, LARGEST)


def draine(g: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Mean cosine of Draine's phase function (B. T. Draine, Astrophysical Journal 598, 2003)."""
    g = held(g)
    return held(g * (1 + alpha * (3 + 2 * g * g) / 5) / (1 + alpha * (1 + 2 * g * g) / 3))


def fournier_forand(backscatter: np.ndarray, ior: np.ndarray) -> np.ndarray:
    """Mean cosine of Fournier and Forand's phase function (SPIE 2258, 1994), by the midpoint rule.

    backscatter : the part of the light that is turned by more than 90 degrees.
    """
    # Within the limits of Cycles' sockets; the integrand is steep where light goes straight on.
    b = np.clip(np.atleast_1d(np.float64(backscatter)), 1e-3, 0.499)
    n = np.clip(np.atleast_1d(np.float64(ior)), 1.001, 2.0)
    root, weight = ((np.arange(2000) + 0.5) / 2000)[:, None], 4.0
    s = root**4  # sin^2 of half the angle
    scale = 4 / (3 * (n - 1) ** 2)
    delta, d90, d180 = scale * s, scale / 2, scale
    v = -np.log(2 * b * (d90 - 1) + 1) / np.log(d90)
    power, away = delta**v, 1 - delta
    value = (v * away - (1 - power) + (delta * (1 - power) - v * away) / s) / (away**2 * power)
    cosine = 1 - 2 * s
    value += (d180**-v - 1) / (d180 - 1) / 4 * (3 * cosine**2 - 1)
    value = np.nan_to_num(value, posinf=0, neginf=0) * weight * root**3
    mean = (value * cosine).sum(axis=0) / value.sum(axis=0)
    return held(mean if np.ndim(backscatter) or np.ndim(ior) else mean[0])


def mie(diameter: np.ndarray) -> np.ndarray:
    """(4, ...) Henyey-Greenstein's g, Draine's g and alpha, and the latter's share.

    J. Jendersie, E. d'Eon, "An Approximate Mie Scattering Function for Fog and Cloud Rendering", 2023.

    diameter : of droplets, in micrometres.
    """
    d = np.clip(np.float64(diameter), 1e-6, None)
    log = np.log(d)
    tiny = (13.8 * d * d, 1.1456 * d * np.sin(9.29044 * d), 250.0, 0.252977 - 312.983 * d**4.3)
    turn = (log - 0.238604) * (log + 1.00667) / (0.507522 - 0.15677 * log)
    small = (
        0.862 - 0.143 * log**2,
        0.379685 * np.cos(1.19692 * np.cos(turn) + 1.37932 * log + 0.0625835) + 0.344213,
        250.0,
        0.146209 * np.cos(3.38707 * log + 2.11193) + 0.316072 + 0.0778917 * log,
    )
    medium = (
        0.0604931 * np.log(np.maximum(log, 1e-9)) + 0.940256,
        0.500411 - 0.081287 / (-2 * log + np.tan(log) + 1.27551),
        7.30354 * log + 6.31675,
        0.026914 * (log - np.cos(5.68947 * (np.log(np.maximum(log, 1e-9)) - 0.0292149))) + 0.3764,
    )
    large = (
        np.exp(-0.0990567 / (d - 1.67154)),
        np.exp(-2.20679 / (d + 3.91029) - 0.428934),
        np.exp(3.62489 - 8.29288 / (d + 5.52825)),
        np.exp(-0.599085 / (d - 0.641583) - 0.665888),
    )
    ranges = [d <= 0.1, d < 1.5, d < 5]
    fitted = zip(tiny, small, medium, large, strict=True)
    return np.stack([np.select(ranges, np.broadcast_arrays(*row, d)[:3], row[3]) for row in fitted])
