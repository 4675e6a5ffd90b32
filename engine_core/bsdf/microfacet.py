# SPDX-License-Identifier: GPL-3.0-or-later
"""Reflection off microfacets with height-correlated Smith masking; GGX with its Fresnel models.

Half vectors are not normalised: slopes are ratios of their components, which keep their digits in the
narrowest lobe where 1 - cos^2 would not. With h = v + l, r = n.h and the local slopes' square
(h_x / a_x)^2 + (h_y / a_y)^2 = slope, GGX is D = (h.h / (slope + r^2))^2 / (pi a_x a_y).

Masking is told by the projected area of the visible facets, A(v) = n.v (1 + Lambda(v)): normals are sampled
with density D(m) m.v / A(v), so the pdf of a reflected direction is D / (4 A(v)), and
f cos = D F n.l / (4 (n.l A(v) + n.v A(l) - n.v n.l)).

E. Heitz, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", JCGT 3(2), 2014.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from ..geometry.vectors import dot
from ..geometry.warps import TWO_PI, basis
from . import fresnel
from .lobe import Lobe, at

MIN_ALPHA = np.float32(1e-4)
"""A mirror's: half vectors in float32 resolve no narrower lobe."""


@dataclass(eq=False)
class Microfacet(Lobe):
    """alpha : (2, L) widths along X and Y, X = tangent. cos_viewer : (L,) n.v. area : (L,) A(v).

    tangent : (3, L) unit, perpendicular to the normal; None where the widths are equal.
    """

    alpha: np.ndarray
    cos_viewer: np.ndarray
    area: np.ndarray
    tangent: np.ndarray | None = field(default=None, kw_only=True)

    smooth = False

    @classmethod
    def of(
        cls,
        weight: np.ndarray,
        normal: np.ndarray,
        towards_viewer: np.ndarray,
        alpha: tuple[np.ndarray, np.ndarray],
        tangent: np.ndarray | None,
        surface: np.ndarray | None,
        **more: np.ndarray,
    ) -> Self:
        """alpha : two of () or (N,), equal if ``tangent`` is None. more : fields of subclasses."""
        widths = np.empty((2, weight.shape[1]), np.float32)
        widths[0], widths[1] = alpha
        np.clip(widths, MIN_ALPHA, 1, out=widths)
        cosine = dot(normal, towards_viewer)
        weight = weight * (cosine > 0)
        np.maximum(cosine, np.float32(1e-6), out=cosine)
        if tangent is None:
            stretched = widths[0] * widths[0] * np.maximum(1 - cosine * cosine, 0)
        else:
            across = dot(tangent, towards_viewer), dot(_cross(normal, tangent), towards_viewer)
            stretched = (widths[0] * across[0]) ** 2 + (widths[1] * across[1]) ** 2
        area = cls._area(cosine, stretched)
        return cls(
            weight, normal, towards_viewer, widths, cosine, area, tangent=tangent, surface=surface, **more
        )

    def is_mirror(self, which: np.ndarray | None) -> np.ndarray:
        return (at(which, self.alpha) <= MIN_ALPHA).all(axis=0)

    def filled(self, name: str) -> np.ndarray:
        return basis(self.normal)[0] if name == "tangent" else super().filled(name)

    def evaluate(self, which: np.ndarray | None, to_light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        normal, viewer = at(which, self.normal), at(which, self.towards_viewer)
        cos_viewer = at(which, self.cos_viewer)
        cos_light = np.maximum(dot(normal, to_light), 0)
        half = viewer + to_light
        square = dot(half, half)
        along = cos_light + cos_viewer
        if self.tangent is None:
            alpha = at(which, self.alpha[0])
            widths = alpha * alpha
            across = half - along * normal
            slope = dot(across, across) / widths
            stretched = widths * np.maximum(1 - cos_light * cos_light, 0)
        else:
            tangent, (x, y) = at(which, self.tangent), at(which, self.alpha)
            bitangent = _cross(normal, tangent)
            slope = (dot(tangent, half) / x) ** 2 + (dot(bitangent, half) / y) ** 2
            stretched = (dot(tangent, to_light) * x) ** 2 + (dot(bitangent, to_light) * y) ** 2
            widths = x * y
        value, pdf = self._reflect(which, square, along, slope, widths, cos_viewer, cos_light, stretched)
        reflectance = self.reflectance(which, np.sqrt(square) * np.float32(0.5))
        pdf *= cos_light > 0
        if self.surface is not None:
            value *= dot(at(which, self.surface), to_light) > 0
        weight = at(which, self.weight)
        return (weight if reflectance is None else reflectance * weight) * value, pdf

    def _reflect(self, which, square, along, slope, widths, cos_viewer, cos_light, stretched):
        """f cos (N,) of facets that reflect all, and the pdf.

        square : h.h. along : n.h. slope : as above. widths : a_x a_y. stretched : (a_x l_x)^2 + (a_y l_y)^2.
        """
        visible = at(which, self.area)
        density = self._density(square, along, slope, widths)
        density *= np.float32(0.25)
        pdf = density / visible
        masking = cos_light * (visible - cos_viewer)
        masking += cos_viewer * self._area(cos_light, stretched)
        density *= cos_light
        density /= masking
        return density, pdf

    def reflectance(self, which: np.ndarray | None, cosine: np.ndarray) -> np.ndarray | None:
        """Fresnel factor (3, N) for the cosine between half vector and light; None for 1."""
        return None

    def sample(self, which: np.ndarray | None, u: np.ndarray) -> np.ndarray:
        normal, viewer = at(which, self.normal), at(which, self.towards_viewer)
        if self.tangent is None:
            tangent, bitangent = basis(normal)
        else:
            tangent = at(which, self.tangent)
            bitangent = _cross(normal, tangent)
        local = np.stack([dot(tangent, viewer), dot(bitangent, viewer), at(which, self.cos_viewer)])
        m = self._sample_normal(local, at(which, self.alpha), u)
        along = 2 * dot(m, local)
        light = along * m - local
        return light[0] * tangent + light[1] * bitangent + light[2] * normal

    @staticmethod
    def _area(cosine: np.ndarray, stretched: np.ndarray) -> np.ndarray:
        """A(w) of directions w; stretched : (a_x w_x)^2 + (a_y w_y)^2."""
        raise NotImplementedError

    @staticmethod
    def _density(square: np.ndarray, along: np.ndarray, slope: np.ndarray, widths: np.ndarray) -> np.ndarray:
        """D of half vectors, an array of its own; arguments as in `_reflect`."""
        raise NotImplementedError

    @staticmethod
    def _sample_normal(viewer: np.ndarray, alpha: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Unit normals (3, N) in the local frame, where ``viewer`` (3, N) is too."""
        raise NotImplementedError


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


class GGX(Microfacet):
    """The distribution of Trowbridge and Reitz."""

    @staticmethod
    def _area(cosine: np.ndarray, stretched: np.ndarray) -> np.ndarray:
        return np.float32(0.5) * (cosine + np.sqrt(stretched + cosine * cosine))

    @staticmethod
    def _density(square: np.ndarray, along: np.ndarray, slope: np.ndarray, widths: np.ndarray) -> np.ndarray:
        slope += along * along
        slope += np.float32(1e-30)
        square = square / slope
        square *= square
        square /= widths * np.float32(np.pi)
        return square

    @staticmethod
    def _sample_normal(viewer: np.ndarray, alpha: np.ndarray, u: np.ndarray) -> np.ndarray:
        """J. Dupuy and A. Benyoub, "Sampling Visible GGX Normals with Spherical Caps", 2023."""
        x, y, z = viewer[0] * alpha[0], viewer[1] * alpha[1], viewer[2]
        inverse = 1 / np.sqrt(x * x + y * y + z * z)
        x, y, z = x * inverse, y * inverse, z * inverse
        height = (1 - u[1]) * (1 + z) - z
        radius = np.sqrt(np.maximum(1 - height * height, 0))
        angle = TWO_PI * u[0]
        m = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), np.maximum(z + height, 1e-20)])
        m[:2] *= alpha
        m /= np.sqrt(dot(m, m))
        return m


@dataclass(eq=False)
class DielectricGGX(GGX):
    """With the Fresnel curve of a dielectric stretched to begin at f0 (3, L). ior : (L,)."""

    f0: np.ndarray
    ior: np.ndarray

    def reflectance(self, which: np.ndarray | None, cosine: np.ndarray) -> np.ndarray:
        ior, f0 = at(which, self.ior), at(which, self.f0)
        real = fresnel.normal_reflectance(ior)
        s = fresnel.dielectric(cosine, ior)
        s -= real
        s /= 1 - real
        np.maximum(s, 0, out=s)
        value = (1 - f0) * s
        value += f0
        return value


@dataclass(eq=False)
class MetalGGX(GGX):
    """With the F82-tint Fresnel model. f0, edge : (3, L), see `fresnel.edge_tint`."""

    f0: np.ndarray
    edge: np.ndarray

    def reflectance(self, which: np.ndarray | None, cosine: np.ndarray) -> np.ndarray:
        return fresnel.metal(cosine, at(which, self.f0), at(which, self.edge))
