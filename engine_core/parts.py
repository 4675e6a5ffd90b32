# SPDX-License-Identifier: GPL-3.0-or-later
"""What a picture is the sum of beside its surfaces: the light of fog and of lasers, an integral each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from .image.film import VOLUME
from .integration.inner_rules import InnerRule
from .integration.integrand import StagedIntegrand
from .scene import Scene
from .settings import Settings
from .transport.direct_light import DirectLight
from .transport.ray_rule import AlongRay, ScatteredAlongRay
from .transport.silhouettes import silhouettes
from .transport.single_scattering import SingleScattering


Map = Callable[[Callable, Iterable], list]

SHADOW_RAYS = 4
"""Of a camera ray, that together take as long as a sample of a surface."""


@dataclass(frozen=True, eq=False)
class Part:
    """One integral over every pixel.

    name, shows : for people; and which pass it belongs to (`image.film.VOLUME` or `LASER`).
    plain : a sample is one point of all its dimensions. plain_split : of the rest for each camera ray.
    at_nodes, rule : how a node of a control variate over the screen alone integrates the rest.
    sampled, split : an unbiased estimate of the same with little noise, for the residual.
    cost : of one of these, in units of `Settings.samples`.
    outlines : of a region of the picture and a map_ of the workers, (W, H) bool: pixels of no polynomial.
    """

    name: str
    shows: str
    plain: StagedIntegrand
    plain_split: int
    at_nodes: StagedIntegrand
    rule: InnerRule
    sampled: StagedIntegrand
    split: int
    cost: float
    outlines: Callable[[tuple[int, int, int, int], Map], np.ndarray]

    def counts(self) -> Counter[str]:
        """Rays by kind, and what was not finite, so far."""
        different = {id(integrand): integrand for integrand in (self.plain, self.at_nodes, self.sampled)}
        return sum((integrand.counts for integrand in different.values()), Counter())


def parts_of(
    scene: Scene, surfaces: DirectLight, settings: Settings, check: Callable[[], None]
) -> list[Part]:
    """The integrals that a scene has; none where there is neither fog nor a laser.

    check : called before every batch; may raise, to give up.
    """
    parts: list[Part] = []
    if surfaces.media is None:
        return parts
    scattering = SingleScattering(
        surfaces.frame,
        surfaces.media,
        surfaces.lights,
        surfaces.surfaces,
        surfaces.shader,
        surfaces.stage.rays,
        settings,
    )

    def outlines(region: tuple[int, int, int, int], map_: Map) -> np.ndarray:
        return silhouettes(scattering.rays, scattering.surfaces, region, map_)

    if scattering.sizeless.size:
        whole = ScatteredAlongRay(scattering, check=check)
        cost = max(1, whole.shadow_rays / SHADOW_RAYS)
        parts.append(
            Part("fog lit by points", VOLUME, whole, 1, whole, AlongRay(whole.shadow_rays), whole, 1, cost, outlines)
        )
    return parts
