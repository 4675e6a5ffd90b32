# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffuse lobes: what light that is scattered below the surface leaves with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.vectors import dot
from .lobe import Lobe, at

INV_PI = np.float32(1 / np.pi)


class Lambert(Lobe):
    """cos / pi."""

    def evaluate(self, which: np.ndarray | None, to_light: np.ndarray) -> tuple[np.ndarray, None]:
        normal = at(which, self.normal)
        cosine = dot(normal, to_light)
        np.maximum(cosine, 0, out=cosine)
        cosine *= INV_PI
        if self.surface is not None:
            cosine *= bump_terminator(normal, at(which, self.surface), to_light)
        return at(which, self.weight) * cosine, None


class DiffuseTransmission(Lobe):
    """|cos| / pi on the far side."""

    def evaluate(self, which: np.ndarray | None, to_light: np.ndarray) -> tuple[np.ndarray, None]:
        normal = at(which, self.normal)
        cosine = dot(normal, to_light)
        np.minimum(cosine, 0, out=cosine)
        cosine *= -INV_PI
        if self.surface is not None:
            cosine *= bump_terminator(normal, at(which, self.surface), to_light)
        return at(which, self.weight) * cosine, None


@dataclass(eq=False)
class OrenNayar(Lobe):
    """Rough diffuse reflection with its interreflections.

    Single scattering: Y. Fujii's improved Oren-Nayar model, f = a + b s / t, whose albedo is closed form.
    Multiple scattering: what that loses, (1 - E_i)(1 - E_o), tinted by the albedo as in the OpenPBR
    specification: energy is conserved, and a white surface of any roughness reflects all.

    single : (2, L) a and b. multiple : (3, L) the second term, but for 1 - E of the light's direction.
    """

    single: np.ndarray
    multiple: np.ndarray

    @classmethod
    def of(
        cls,
        weight: np.ndarray,
        color: np.ndarray,
        roughness: np.ndarray,
        normal: np.ndarray,
        towards_viewer: np.ndarray,
        surface: np.ndarray | None,
    ) -> OrenNayar:
        """color : (3, 1) or (3, N) albedo. roughness : () or (N,) in [0, 1]. All else (3, N)."""
        sigma = np.clip(roughness, 0, 1)
        albedo = np.clip(color, 0, 1)
        a = 1 / (np.float32(np.pi) + sigma * np.float32(np.pi / 2 - 2 / 3))
        b = sigma * a
        viewer = _lost(b, np.maximum(dot(normal, towards_viewer), 0))
        # The mean of 1 - E over the hemisphere, from a pi = 1 - b (pi / 2 - 2 / 3).
        lost = b * np.float32(np.pi / 2 - 2 / 3 - (2 * np.pi - 5.6) / 3)
        tint = albedo * albedo * (INV_PI * (1 - lost)) / (1 - albedo * lost)
        # A quotient of two small numbers: all of it is proportional to b.
        multiple = tint * np.divide(viewer, lost, out=np.zeros_like(viewer), where=lost > 0)
        single = np.empty((2, weight.shape[1]), np.float32)
        single[0], single[1] = a, b
        multiple = np.broadcast_to(multiple, weight.shape)  # a grey albedo may be a number
        return cls(weight, normal, towards_viewer, single, multiple, surface=surface)

    def evaluate(self, which: np.ndarray | None, to_light: np.ndarray) -> tuple[np.ndarray, None]:
        normal, viewer = at(which, self.normal), at(which, self.towards_viewer)
        a, b = at(which, self.single)
        cosine = np.maximum(dot(normal, to_light), 0)
        cos_viewer = np.maximum(dot(normal, viewer), 0)
        value = at(which, self.multiple) * _lost(b, cosine)
        s = dot(to_light, viewer) - cosine * cos_viewer
        t = np.maximum(np.maximum(cosine, cos_viewer), np.float32(1e-30))
        value += a + b * np.where(s > 0, s / t, s)
        if self.surface is not None:
            cosine *= bump_terminator(normal, at(which, self.surface), to_light)
        value *= cosine
        value *= at(which, self.weight)
        return value, None


def _lost(b: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """1 - E, E the albedo of single scattering: E = pi a + b G(theta), and pi a = 1 - b (pi/2 - 2/3)."""
    sine = np.sqrt(np.maximum(1 - cosine * cosine, 0))
    # (1 - sin^3) / cos without its cancellation at normal incidence's far end, cos = 0.
    quotient = cosine * (1 + sine + sine * sine) / (1 + sine)
    g = sine * (np.arccos(np.minimum(cosine, 1)) - sine * cosine - np.float32(2 / 3) * (1 - quotient))
    return b * (np.float32(np.pi / 2 - 2 / 3) - g)


def bump_terminator(normal: np.ndarray, surface: np.ndarray, to_light: np.ndarray) -> np.ndarray:
    """(N,) factor for a bent normal: none of the light from the other side, and a soft way down to that.

    A. Conty Estevez et al., "A Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem",
    Ray Tracing Gems, 2019.
    """
    bend, light = dot(surface, normal), dot(surface, to_light)
    allowed = bend * light * dot(normal, to_light) >= 0
    bend, light = (np.maximum(c * c, np.float32(1e-12)) for c in (bend, light))
    alpha_square = np.clip(np.float32(0.125) * (1 / bend - 1), 0, 1)
    tan_square = np.maximum(1 / light - 1, 0)
    return allowed * (2 / (1 + np.sqrt(1 + alpha_square * tan_square)))
