# SPDX-License-Identifier: GPL-3.0-or-later
"""Closures: what a material's shader nodes make of a surface point. Parameters and layers are Cycles'.

Fields are values (`values.Value`) or constants. A closure of None is black.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..bsdf import energy, fresnel
from ..bsdf.ashikhmin_shirley import AshikhminShirley
from ..bsdf.beckmann import Beckmann
from ..bsdf.diffuse import DiffuseTransmission, Lambert, OrenNayar
from ..bsdf.microfacet import GGX, DielectricGGX, MetalGGX
from ..bsdf.normals import radial_tangent, tangent_along, valid_reflection_normal
from ..geometry.vectors import dot, inverse_length
from .points import ShadingPoints
from .terms import SurfaceTerms
from .values import value_at

NEGLIGIBLE = 1e-5
"""Roughness, metal or coat of less than this is none."""


class Closure:
    """One shader node."""

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        """Adds what the surface does at the points, times ``weight``: (), (N,), (3, 1) or (3, N)."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Diffuse(Closure):
    """Lambertian, or Oren-Nayar with a roughness."""

    color: Any
    roughness: Any = 0.0
    normal: Any = None

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        if terms.wants_lobes:
            color = np.maximum(_given(self.color, points), 0)
            _diffuse(points, weight * color, color, _given(self.roughness, points), self.normal, terms)


@dataclass(frozen=True, eq=False)
class Translucent(Closure):
    """Lambertian on the far side."""

    color: Any
    normal: Any = None

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        if terms.wants_lobes:
            weight = _full(weight * np.maximum(_given(self.color, points), 0), points)
            normal, surface = _normal(self.normal, points, glossy=True)
            terms.add(DiffuseTransmission(weight, normal, points.towards_viewer, surface=surface))


@dataclass(frozen=True, eq=False)
class Transparent(Closure):
    """Lets light pass straight on."""

    color: Any = 1.0

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        terms.transmit(weight * np.maximum(_given(self.color, points), 0))


@dataclass(frozen=True, eq=False)
class Emission(Closure):
    """Radiance ``color * strength`` in all directions."""

    color: Any = 1.0
    strength: Any = 1.0

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        terms.emit(weight * _given(self.color, points) * _given(self.strength, points))


@dataclass(frozen=True, eq=False)
class Holdout(Closure):
    """A hole in the picture's alpha."""

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        terms.hold_out(weight.mean(axis=0) if np.ndim(weight) == 2 else weight)


@dataclass(frozen=True, eq=False)
class Mix(Closure):
    """``first`` where the factor is 0, ``second`` where it is 1."""

    factor: Any
    first: Closure | None
    second: Closure | None

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        factor = np.clip(_given(self.factor, points), 0, 1)
        for closure, share in ((self.first, 1 - factor), (self.second, factor)):
            if closure is not None and np.any(share):
                closure.shade(points, weight * share, terms)


@dataclass(frozen=True, eq=False)
class Add(Closure):
    """Both."""

    first: Closure | None
    second: Closure | None

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        for closure in (self.first, self.second):
            if closure is not None:
                closure.shade(points, weight, terms)


@dataclass(frozen=True, eq=False)
class Glossy(Closure):
    """Microfacets that reflect all of a colour.

    distribution : MULTI_GGX, with the light that facets reflect among each other, GGX, BECKMANN or
        ASHIKHMIN_SHIRLEY. rotation : of the tangent, in turns.
    """

    color: Any
    roughness: Any
    distribution: str = "MULTI_GGX"
    anisotropy: Any = 0.0
    rotation: Any = 0.0
    normal: Any = None
    tangent: Any = None

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        if not terms.wants_lobes:
            return
        color = np.maximum(_given(self.color, points), 0)
        normal, surface = _normal(self.normal, points, glossy=True)
        alpha = np.clip(_given(self.roughness, points), 0, 1) ** 2
        anisotropy = np.clip(_given(self.anisotropy, points), np.float32(-0.99), np.float32(0.99))
        tangent = None
        x = y = alpha
        if np.any(np.abs(anisotropy) > 1e-4):
            narrow, wide = 1 - np.abs(anisotropy), 1 / (1 - np.abs(anisotropy))
            x = alpha * np.where(anisotropy < 0, wide, narrow)
            y = alpha * np.where(anisotropy < 0, narrow, wide)
            tangent = _tangent(self.tangent, self.rotation, normal, points)
        weight = weight * color
        if self.distribution == "MULTI_GGX":
            facets = Facets(normal, points, x, y)
            weight = weight * (facets.darkening(color) / facets.energy)
        kind = {"BECKMANN": Beckmann, "ASHIKHMIN_SHIRLEY": AshikhminShirley}.get(self.distribution, GGX)
        terms.add(kind.of(_full(weight, points), normal, points.towards_viewer, (x, y), tangent, surface))


@dataclass(frozen=True, eq=False)
class Principled(Closure):
    """Layers: alpha, coat, emission, then a mixture of metal and of a dielectric on a diffuse base."""

    base_color: Any
    metallic: Any = 0.0
    roughness: Any = 0.5
    ior: Any = 1.5
    alpha: Any = 1.0
    normal: Any = None
    diffuse_roughness: Any = 0.0
    specular_ior_level: Any = 0.5
    specular_tint: Any = 1.0
    anisotropic: Any = 0.0
    anisotropic_rotation: Any = 0.0
    tangent: Any = None
    coat_weight: Any = 0.0
    coat_roughness: Any = 0.03
    coat_ior: Any = 1.5
    coat_tint: Any = 1.0
    coat_normal: Any = None
    emission_color: Any = 1.0
    emission_strength: Any = 0.0
    distribution: str = "MULTI_GGX"

    def shade(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        alpha = np.clip(_given(self.alpha, points), 0, 1)
        if np.any(alpha < 1):
            terms.transmit(weight * (1 - alpha))
            weight = weight * alpha
        strength = _given(self.emission_strength, points)
        if not terms.wants_lobes and not np.any(strength):
            return
        weight = self._coat(points, weight, terms)
        if np.any(strength):
            terms.emit(weight * _given(self.emission_color, points) * strength)
        if terms.wants_lobes:
            self._base(points, weight, terms)

    def _coat(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> np.ndarray:
        """Adds the coat; returns what it leaves of ``weight``."""
        amount = np.maximum(_given(self.coat_weight, points), 0)
        if not np.any(amount > NEGLIGIBLE):
            return weight
        ior = np.maximum(_given(self.coat_ior, points), 1)
        tint = np.maximum(_given(self.coat_tint, points), 0)
        width = np.clip(_given(self.coat_roughness, points), 0, 1) ** 2
        normal, surface = _normal(self.coat_normal, points, glossy=True)
        facets = Facets(normal, points, width, width)
        darkening = facets.darkening(fresnel.mean_dielectric(ior))
        f0 = fresnel.normal_reflectance(ior)
        if terms.wants_lobes:
            shares = _full(weight * amount * darkening / facets.energy, points)
            more = {"f0": _full(f0, points), "ior": _each(ior, points)}
            coat = DielectricGGX.of(
                shares, normal, points.towards_viewer, (width, width), None, surface, **more
            )
            terms.add(coat)
        weight = weight * _left(weight, amount * darkening * facets.albedo(f0, ior))
        if np.any(tint != 1):
            # Beer's law along the refracted ray, and the tint for one that is perpendicular.
            cosine = dot(points.towards_viewer, normal)
            cos_square = 1 - (1 - cosine * cosine) / (ior * ior)
            with np.errstate(over="ignore"):
                passed = tint ** (1 / np.sqrt(np.maximum(cos_square, np.float32(1e-8))))
            weight = weight * np.maximum(1 + amount * (np.minimum(passed, np.float32(1e6)) - 1), 0)
        return weight

    def _base(self, points: ShadingPoints, weight: np.ndarray, terms: SurfaceTerms) -> None:
        color = np.maximum(_given(self.base_color, points), 0)
        tint = np.maximum(_given(self.specular_tint, points), 0)
        metallic = np.clip(_given(self.metallic, points), 0, 1)
        normal, surface = _normal(self.normal, points, glossy=True)
        x = y = np.clip(_given(self.roughness, points), 0, 1) ** 2
        anisotropic = np.clip(_given(self.anisotropic, points), 0, 1)
        tangent = None
        if np.any(anisotropic > 0):
            aspect = np.sqrt(1 - np.float32(0.9) * anisotropic)
            x, y = np.minimum(x / aspect, 1), y * aspect
            tangent = _tangent(self.tangent, self.anisotropic_rotation, normal, points)
        place = (normal, points.towards_viewer, (x, y), tangent, surface)
        facets = Facets(normal, points, x, y)
        interreflect = self.distribution == "MULTI_GGX"

        if np.any(metallic > NEGLIGIBLE):
            f0 = np.minimum(color, 1)
            edge = fresnel.edge_tint(f0, np.minimum(tint, 1))
            share = weight * metallic
            if interreflect:
                share = share * (facets.darkening(fresnel.mean_metal(f0, edge)) / facets.energy)
            more = {"f0": _full(f0, points), "edge": _full(edge, points)}
            terms.add(MetalGGX.of(_full(share, points), *place, **more))
            weight = weight * (1 - metallic)
            if not np.any(weight):
                return

        given_ior = np.maximum(_given(self.ior, points), np.float32(1e-5))
        level = np.maximum(_given(self.specular_ior_level, points), 0)
        reflectance = fresnel.normal_reflectance(given_ior) * (2 * level)
        ior = fresnel.ior_of(reflectance)
        ior = np.where(level == np.float32(0.5), given_ior, np.where(given_ior < 1, 1 / ior, ior))
        if np.any(ior != 1):
            f0 = np.minimum(reflectance * tint, 1)
            darkening = np.float32(1)
            share = weight
            if interreflect:
                real = fresnel.normal_reflectance(ior)
                s = np.clip((fresnel.mean_dielectric(ior) - real) / (1 - real), 0, 1)
                darkening = facets.darkening(f0 + (1 - f0) * s)
                share = weight * (darkening / facets.energy)
            more = {"f0": _full(f0, points), "ior": _each(ior, points)}
            terms.add(DielectricGGX.of(_full(share, points), *place, **more))
            weight = weight * _left(weight, darkening * facets.albedo(f0, ior))

        roughness = _given(self.diffuse_roughness, points)
        _diffuse(points, weight * color, color, roughness, self.normal, terms)


class Facets:
    """What all of GGX' facets reflect together, seen from where the viewer is.

    energy : (N,) the share that leaves after one reflection.
    """

    def __init__(self, normal: np.ndarray, points: ShadingPoints, x: np.ndarray, y: np.ndarray) -> None:
        """x, y : () or (N,) widths of the slopes."""
        self._roughness = np.sqrt(np.sqrt(x * y))
        self._cosine = dot(points.towards_viewer, normal)
        self.energy = energy.reflected(self._roughness, self._cosine)

    def darkening(self, mean_reflectance: np.ndarray) -> np.ndarray:
        """How much of all light is left by reflections among facets, relative to those that lose nothing.

        C. Kulla and A. Conty, "Revisiting Physically Based Shading at Imageworks", 2017, appendix.
        """
        mean = energy.mean_reflected(self._roughness)
        # Colours above 1 gain by each reflection; they shall not gain without end.
        often = mean_reflectance * mean / np.maximum(1 - mean_reflectance * (1 - mean), np.float32(0.01))
        return self.energy + often * (1 - self.energy)

    def albedo(self, f0: np.ndarray, ior: np.ndarray) -> np.ndarray:
        """Of a dielectric, darkening aside. f0 : at normal incidence. ior : which curve it follows."""
        return f0 + (1 - f0) * energy.fresnel_share(self._roughness, self._cosine, ior)


def _left(weight: np.ndarray, albedo: np.ndarray) -> np.ndarray:
    """(N,) share of light that a layer with ``albedo`` leaves to those below: by its brightest channel."""
    if np.ndim(albedo) == 2:
        albedo = np.where(np.atleast_2d(weight) > 0, albedo, 0).max(axis=0)
    return np.clip(1 - albedo, 0, 1)


def _diffuse(points, weight, color, roughness, normal, terms) -> None:
    normal, surface = _normal(normal, points, glossy=False)
    weight = _full(weight, points)
    if np.any(roughness > NEGLIGIBLE):
        terms.add(OrenNayar.of(weight, color, roughness, normal, points.towards_viewer, surface))
    else:
        terms.add(Lambert(weight, normal, points.towards_viewer, surface=surface))


def _normal(value: Any, points: ShadingPoints, glossy: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """A lobe's normal (3, N), and the surface's if it is another.

    glossy : the normal must mirror the viewer upwards.
    """
    normal = points.normal
    if value is not None:
        normal = _given(value, points)
        scale = inverse_length(normal)
        normal = np.where(scale > 0, normal * scale, points.normal)
    if glossy:
        given = normal
        normal = points.remembered(
            ("mirrors upwards", id(value)),
            lambda: valid_reflection_normal(given, points.geometric, points.towards_viewer),
        )
    return normal, None if normal is points.normal else points.normal


def _tangent(value: Any, turn: Any, normal: np.ndarray, points: ShadingPoints) -> np.ndarray:
    if value is None:
        direction = radial_tangent(points.attributes("generated", 3))
        # Into the surface first: what a bent normal makes of that differs from what it makes of this.
        direction = direction - dot(direction, points.normal) * points.normal
    else:
        direction = _given(value, points)
    return tangent_along(direction, normal, _given(turn, points))


def _given(value: Any, points: ShadingPoints) -> np.ndarray:
    """A closure's input at the points; what is not finite counts as 0."""
    array = value_at(value, points)
    if not np.isfinite(array.sum()):
        array = np.where(np.isfinite(array), array, np.float32(0))
    return array


def _full(value: np.ndarray, points: ShadingPoints) -> np.ndarray:
    """A number or colour as (3, N)."""
    return _spread(value, (3, len(points)))


def _each(value: np.ndarray, points: ShadingPoints) -> np.ndarray:
    """A number as (N,)."""
    return _spread(value, (len(points),))


def _spread(value: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    spread = np.empty(shape, np.float32)
    spread[...] = value
    return spread
