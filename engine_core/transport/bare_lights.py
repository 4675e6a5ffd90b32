# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights without size, and points of small ones, side by side: what whole rays of fog are lit by."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from .emitters import SphereEmitters
from .light_samples import SceneLights
from .media import Media

POINT, SPOT, SUN = range(3)
"""Kinds of lights."""

BARE, DISK, BALL = range(3)
"""Their shapes: without size, disks that face the fog, as suns of some angle are, and balls."""

_NEXT_LIGHT = np.array([[0.7548776662466927], [0.5698402909980532]])
"""What lights' points are apart by on one ray, so that their errors even out: R2 of M. Roberts, 2018."""


@dataclass(eq=False)
class BareLights:
    """L lights without size, or points of small ones: opposite ones side by side, of half the strength each.

    number : (L,) of the scene's lights, ascending.
    position : (3, L) float64; of suns the direction to them. strength : (3, L) float64.
    kind : (L,) `POINT`, `SPOT` or `SUN`. blockers : (L,) numbers, as of `Links`.
    axes : (3, 3, L) rows of the maps to spots' own spaces. below, sharpness : (L,) 1 - cosine of half the
        cone's angle, and 1 over the width of its edge in cosines.
    state : (L,) uint64, which fogs all of a light is in; without meaning for suns.
    shape, radius : (L,) `BARE`, `DISK` or `BALL`, and 0 of the first; of suns the sine of half their angle.
    lamp, opposite : (2, L) and (L,) bool, where on small ones their points are, of a ray that has its own at
        u: at u + lamp, modulo 1, or opposite to that.
    back : (L,) how far behind a spot, in its own space, the cone begins that holds all of its points' cones.
    nearest, whole : (L,) distance to the light at which a ray is taken to pass at least, and from which on it
        sees all of a spot's light (`around_light.Tamed`); 0 but for nodes.
    several : whether rays may have several pairs, as in `fog_lanes.GRAZING`.
    ahead : whether shadow rays must run towards lights, as what is clear may be so to one side alone.
    """

    number: np.ndarray
    position: np.ndarray
    strength: np.ndarray
    kind: np.ndarray
    blockers: np.ndarray
    axes: np.ndarray
    below: np.ndarray
    sharpness: np.ndarray
    state: np.ndarray
    shape: np.ndarray
    radius: np.ndarray
    lamp: np.ndarray
    opposite: np.ndarray
    back: np.ndarray
    nearest: np.ndarray
    whole: np.ndarray
    several: bool = True
    ahead: bool = False

    @staticmethod
    def of(scene: SceneLights, number: np.ndarray, media: Media) -> BareLights:
        """Lights ``number`` (L',) of a scene, ascending, none of which are areas."""
        sized = scene.sized.take(number)
        row = np.repeat(np.arange(len(number)), 1 + sized)
        opposite = np.append(False, row[1:] == row[:-1])[: len(row)]
        number, sized = number.take(row), sized.take(row)
        count = len(number)
        position, strength = np.zeros((2, 3, count))
        kind, axes = np.zeros(count, np.intp), np.zeros((3, 3, count))
        below, sharpness = np.zeros(count), np.ones(count)
        radius, shape, back = np.zeros(count), np.zeros(count, np.intp), np.zeros(count)
        for group, start, stop in zip(scene.groups, scene.first[:-1], scene.first[1:], strict=True):
            rows = np.flatnonzero((number >= start) & (number < stop))
            if rows.size == 0:
                continue
            here = number[rows] - start
            strength[:, rows] = group.strength[:, here]
            if group.at_infinity:
                position[:, rows], kind[rows] = group.axis[:, here], SUN
                radius[rows], shape[rows] = group.sine[here], np.where(group.size[here] > 0, DISK, BARE)
                continue
            position[:, rows] = group.centre[:, here]
            radius[rows] = group.reach[here]
            shape[rows] = np.where(
                radius[rows] == 0, BARE, BALL if isinstance(group, SphereEmitters) else DISK
            )
            if group.cone.any:
                cos = group.cone.cos[here].astype(np.float64)
                axes[:, :, rows], sharpness[rows] = group.cone.inverse[:, :, here], group.cone.sharpness[here]
                below[rows] = 1 - cos
                is_spot = cos > -1
                kind[rows[is_spot]] = SPOT
                largest = np.linalg.norm(axes[:, :, rows].transpose(2, 0, 1), 2, axis=(1, 2))
                sine = np.sqrt(np.maximum(1 - cos * cos, 1e-12))
                back[rows] = np.where(is_spot, largest * radius[rows] / sine, 0)
        strength[:, sized] /= 2
        state = np.zeros(count, np.uint64)
        if media.bodies and count:
            # An octahedron that holds the light.
            corners = np.concatenate([np.zeros((3, 1)), np.eye(3), -np.eye(3)], axis=1) * 3**0.5
            origins = position[:, None] + corners[:, :, None] * radius
            origins = np.ascontiguousarray(origins.reshape(3, -1).T, np.float32)
            inside = media.along(origins, np.eye(1, 3, dtype=np.float32), 1e-6).state
            state = np.bitwise_and.reduce(inside.reshape(-1, count), axis=0)
        blockers = scene.links.blockers[number]
        lamp = number * _NEXT_LIGHT % 1
        return BareLights(
            number, position, strength, kind, blockers, axes, below, sharpness, state,
            shape, radius, lamp, opposite, back, *np.zeros((2, count)),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.kind)

    def take(self, rows: np.ndarray) -> BareLights:
        parts = {f.name: getattr(self, f.name) for f in fields(self)}
        return BareLights(**{k: v if isinstance(v, bool) else v[..., rows] for k, v in parts.items()})
