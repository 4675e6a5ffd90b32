# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays and the fog that they run through, in segments that surfaces end."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..geometry.raytracer import FAR
from ..geometry.surfaces import Surfaces
from ..geometry.vectors import take
from .camera_rays import CameraRays
from .media import RayMedia


@dataclass(eq=False)
class FogRays:
    """The first stage's result for N camera rays, M of which run through fog.

    values : None, as nothing is known without another dimension. lane : (M,) ascending; None for all N.
    origin, direction : (3, M) float64, unit directions.
    media : K segments, whose ``ray`` counts the M rays. first : (M + 1,) where those of each ray begin.
    through : (3, K) float32, what transparent surfaces before a segment leave of it; None for all.
    place : (2, M) of rays in the frame, in pixels; None where nothing wants it.
    tiles : of a `Guide` about them; None without one.
    crossings : rays that went on behind transparent surfaces.
    lit : of lights by number, (M,) bool, which rays are to get light of them; of those left out, all.
    """

    origin: np.ndarray
    direction: np.ndarray
    media: RayMedia
    first: np.ndarray
    lane: np.ndarray | None = None
    through: np.ndarray | None = None
    place: np.ndarray | None = None
    tiles: tuple[np.ndarray, np.ndarray] | None = None
    crossings: int = 0
    lit: dict[int, np.ndarray] = field(default_factory=dict)
    values: None = field(default=None, init=False)

    def __len__(self) -> int:
        return self.origin.shape[1]

    def lit_of(self, ray: np.ndarray | None) -> dict[int, np.ndarray]:
        """``lit`` of rays (N,), None for all."""
        return self.lit if ray is None else {number: some.take(ray) for number, some in self.lit.items()}

    def segments(self, ray: np.ndarray | None) -> tuple[np.ndarray | slice, np.ndarray]:
        """The segments of rays (N,), one ray after another, and which of these N each is of; None for all."""
        if ray is None:
            return slice(None), self.media.ray
        start = self.first.take(ray)
        count = self.first.take(ray + 1) - start
        which = np.repeat(np.arange(len(ray)), count)
        return np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + start.take(which), which


@dataclass(eq=False)
class Layers:
    """How far N camera rays get, in lengths of the direction: to the ``first`` surface, and in the end.

    behind : of each further layer the rays (R,), start and end (R,) there, and what reaches it (3, R).
    """

    first: np.ndarray
    reach: np.ndarray
    behind: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]


def fog_ends(surfaces: Surfaces, rays: CameraRays, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(N,) float32 how far camera rays (N, 3) get, in lengths of the direction. The world's fog goes on
    behind the camera's far plane, as it does in Cycles.
    """
    distance = surfaces.distance(origins, directions, rays.reach)
    if rays.reach < FAR:
        distance[distance >= np.float32(rays.reach)] = FAR
    return distance


def in_layers(
    media: RayMedia, layers: Layers, extinction: np.ndarray, directions: np.ndarray
) -> tuple[RayMedia, np.ndarray | None]:
    """Segments that end at surfaces, and what is left (3, K) of light from them; None for all."""
    if not layers.behind:
        return media, None
    unit = np.broadcast_to(np.sqrt((directions.astype(np.float64) ** 2).sum(axis=1)), len(layers.first))
    found = [(None, np.zeros(len(unit)), layers.first, np.ones((3, len(unit)), np.float32)), *layers.behind]
    parts, through = [], []
    number = np.empty(len(unit), np.intp)
    for ray, start, end, passed in found:
        number[:] = -1
        number[slice(None) if ray is None else ray] = np.arange(len(start))
        row = number.take(media.ray)
        start, end = ((x * (unit if ray is None else unit.take(ray))).take(row) for x in (start, end))
        start, end = np.maximum(start, media.start), np.minimum(end, media.end)
        rows = np.flatnonzero((row >= 0) & (end > start))
        part = taken(media, rows)
        skipped = start.take(rows) - part.start
        part.depth = (part.depth + take(extinction, part.mixture) * skipped).astype(np.float32)
        part.start, part.end = start.take(rows), end.take(rows)
        parts.append(part)
        through.append(take(passed, row.take(rows)))
    fields_ = ("ray", "start", "end", "inside", "mixture", "depth")
    joined = {name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in fields_}
    joined = replace(media, **joined)
    order = np.lexsort((joined.start, joined.ray))
    return taken(joined, order), take(np.concatenate(through, axis=1), order)


def taken(media: RayMedia, rows: np.ndarray) -> RayMedia:
    """Only segments ``rows``."""
    parts = {name: getattr(media, name).take(rows) for name in ("ray", "start", "end", "inside", "mixture")}
    return replace(media, **parts, depth=media.depth.take(rows, axis=1))
