# SPDX-License-Identifier: GPL-3.0-or-later
"""By how much more surfaces reflect some lights than others: quick estimates, for choosing among lights.

A glossy surface shows the one light that it mirrors, however many others light it more. GGX stands for
every glossy lobe, as wide along both axes as along the wider one; a light is its middle, and widens the lobe
by half the angle that it fills (so that half vectors to all of it are covered).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from ..bsdf.microfacet import Microfacet
from ..geometry.vectors import dot, take
from .surface_shading import Slot

BY_IRRADIANCE = np.float32(0.25)
"""The part of all chances that knows no lobes: what a surface mirrors may be hidden from it."""

_GRAZING = np.float32(1e-3)
"""The least cosine to a light: the BRDF is finite."""

_INV_PI = np.float32(1 / np.pi)


@dataclass(eq=False)
class _Glossy:
    """A lobe at M points, component first. normal, towards_viewer : (3, M). All else (M,).

    strength : reflected of all light, 0 where there is no such lobe. alpha : width of its slopes.
    cos_viewer : n.v. shadowed : A(v) - n.v (see `microfacet`).
    """

    normal: np.ndarray
    towards_viewer: np.ndarray
    strength: np.ndarray
    alpha: np.ndarray
    cos_viewer: np.ndarray
    shadowed: np.ndarray

    @staticmethod
    def of(lobe: Microfacet) -> _Glossy:
        reflectance = lobe.reflectance(None, lobe.cos_viewer)
        strength = lobe.weight if reflectance is None else lobe.weight * reflectance
        return _Glossy(
            lobe.normal, lobe.towards_viewer, strength.mean(axis=0), lobe.alpha.max(axis=0),
            lobe.cos_viewer, lobe.area - lobe.cos_viewer,
        )  # fmt: skip

    def take(self, rows: np.ndarray | slice) -> _Glossy:
        some = (getattr(self, field.name) for field in fields(self))
        if isinstance(rows, slice):
            return _Glossy(*(x[..., rows] for x in some))
        return _Glossy(*(take(x, rows) for x in some))

    def add_to(self, brdf: np.ndarray, direction: np.ndarray, spread: np.ndarray) -> None:
        """Adds the lobe to ``brdf`` (L, M), towards ``direction`` (3, L, M) of lights of a spread (L, M)."""
        lit = np.flatnonzero(self.strength)
        if lit.size == 0:
            return
        if lit.size < len(self.strength):
            some = np.zeros((len(brdf), lit.size), np.float32)
            self.take(lit).add_to(some, direction[..., lit], spread[:, lit])
            brdf[:, lit] += some
            return
        half = direction + self.towards_viewer[:, None, :]
        cos_light = np.maximum(dot(direction, self.normal[:, None, :]), _GRAZING)
        square = dot(half, half)
        along = cos_light + self.cos_viewer
        along *= along
        across = np.maximum(square - along, 0)
        # The square of the lobe's width.
        width = spread * spread
        width += self.alpha * self.alpha
        across /= width
        across += along
        square /= across
        square *= square
        width *= np.float32(4 * np.pi)
        # A(l) is this at least, and twice this at most.
        masking = np.maximum(cos_light, np.float32(0.5) * self.alpha)
        masking *= self.cos_viewer
        masking += cos_light * self.shadowed
        masking *= width
        square *= self.strength
        square /= masking
        brdf += square


@dataclass(eq=False)
class Highlights:
    """What M points reflect: diffuse (M,) a BRDF, and glossy lobes. shiny : (M,) bool, which have one."""

    diffuse: np.ndarray
    glossy: list[_Glossy]
    shiny: np.ndarray

    @staticmethod
    def of(slots: Sequence[Slot] | None, count: int) -> Highlights | None:
        """Of ``count`` points; None if all their lobes are smooth: irradiance serves those."""
        if slots is None or all(slot.lobe.smooth for slot in slots):
            return None
        diffuse, glossy = np.zeros(count, np.float32), []
        for slot in slots:
            rows = slice(None) if slot.row is None else np.flatnonzero(slot.row >= 0)
            lane = slice(None) if slot.row is None else slot.row.take(rows)
            if slot.lobe.smooth:
                diffuse[rows] += slot.lobe.weight.mean(axis=0)[lane] * _INV_PI
                continue
            lobe = _Glossy.of(slot.lobe)
            if slot.row is not None:
                # Where there is none, some lane of no strength.
                has = slot.row >= 0
                lobe = lobe.take(np.maximum(slot.row, 0))
                lobe.strength *= has
            glossy.append(lobe)
        return Highlights(diffuse, glossy, np.any([lobe.strength > 0 for lobe in glossy], axis=0))

    def take(self, rows: np.ndarray | slice) -> Highlights:
        return Highlights(self.diffuse[rows], [lobe.take(rows) for lobe in self.glossy], self.shiny[rows])

    def preference(
        self, irradiance: np.ndarray, direction: np.ndarray, spread: np.ndarray, around: np.ndarray
    ) -> np.ndarray:
        """(L, M) what the irradiance (L, M) of L lights is to be multiplied with; its sum stays the same.

        direction : (3, L, M) unit, to the lights' middles. spread : (L, M) sine of a quarter of the angle
        that they fill, about. around : which (A,) of them are all around.
        """
        brdf = np.empty_like(irradiance)
        brdf[:] = self.diffuse
        for lobe in self.glossy:
            lobe.add_to(brdf, direction, spread)
        if around.size:
            brdf[around] = self.diffuse + sum(lobe.strength for lobe in self.glossy) * _INV_PI
        # Row by row, so that the sums of a point are the same in any company.
        total, scale = np.zeros((2, brdf.shape[1]), np.float32)
        for light, part in zip(irradiance, brdf, strict=True):
            total += light * part
            scale += light
        known = (total > np.float32(1e-30)) & (total < np.float32(1e30))
        scale /= np.where(known, total, 1)
        known &= scale < np.float32(1e30)
        brdf *= np.where(known, (1 - BY_IRRADIANCE) * scale, 0)
        brdf += BY_IRRADIANCE
        if not known.all():
            brdf[:, ~known] = 1
        return brdf
