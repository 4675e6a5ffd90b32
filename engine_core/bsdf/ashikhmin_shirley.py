# SPDX-License-Identifier: GPL-3.0-or-later
"""Cosine-power microfacets: M. Ashikhmin and P. Shirley, "An Anisotropic Phong BRDF Model", 2000."""

from __future__ import annotations

import numpy as np

from ..geometry.vectors import dot
from .lobe import at
from .microfacet import Microfacet


class AshikhminShirley(Microfacet):
    """D ~ cos^e without masking, e between the exponents 2 / a^2 - 2 of the two axes."""

    def _reflect(self, which, square, along, slope, widths, cos_viewer, cos_light, stretched):
        alpha = at(which, self.alpha)
        power = self._power(alpha)
        along_square = np.maximum(along * along, np.float32(1e-30))
        # cos^e = exp(-e ln(1 + tan^2) / 2), and e tan^2 / 2 = slope / r^2 - tan^2 is exact in narrow lobes.
        tan_square = np.maximum(square / along_square - 1, 0)
        ratio = np.log1p(tan_square) / np.maximum(tan_square, np.float32(1e-20))
        ratio[tan_square == 0] = 1
        pdf = np.exp((tan_square - slope / along_square) * ratio)
        pdf *= np.sqrt((power[0] + 1) * (power[1] + 1)) * np.float32(1 / (8 * np.pi))
        pdf /= np.maximum(np.sqrt(square) * np.float32(0.5), np.float32(1e-6))
        return pdf * cos_light / np.maximum(cos_light, cos_viewer), pdf

    @staticmethod
    def _area(cosine: np.ndarray, stretched: np.ndarray) -> np.ndarray:
        return cosine

    @staticmethod
    def _power(alpha: np.ndarray) -> np.ndarray:
        return 2 / (alpha * alpha) - 2

    @classmethod
    def _sample_normal(cls, viewer: np.ndarray, alpha: np.ndarray, u: np.ndarray) -> np.ndarray:
        power = cls._power(alpha)
        angle = np.float32(2 * np.pi) * u[0]
        x, y = np.cos(angle) / np.sqrt(power[0] + 1), np.sin(angle) / np.sqrt(power[1] + 1)
        inverse = 1 / np.sqrt(x * x + y * y)
        x, y = x * inverse, y * inverse
        exponent = power[0] * x * x + power[1] * y * y + 1
        # 1 / cos^2 - 1 of cos = v^(1 / exponent).
        tan = np.sqrt(np.expm1(np.log(np.maximum(1 - u[1], np.float32(1e-7))) * (-2 / exponent)))
        m = np.stack([x * tan, y * tan, np.ones_like(tan)])
        m /= np.sqrt(dot(m, m))
        return m
