# SPDX-License-Identifier: GPL-3.0-or-later
"""Lasers: beams of parallel light, up to the first surface, and the fog that they run through.

Docs: lasers.md. What is drawn of them are four parts, each an integral of its own:

    laser_in_fog.py       fog scatters light out of the beam, and then to the camera (thesis eq. 6.10)
    laser_on_surfaces.py  fog scatters light out of the beam onto surfaces
    laser_seen.py         the beam itself, where fog scatters it to the camera; and the spot where it ends
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.frame import Frame
from ..geometry.surfaces import ALL_CAST, NONE_CAST
from ..geometry.warps import basis
from ..scene import Laser, Scene
from . import phase
from .links import blockers_of, lights_fog
from .media import Media
from .shadows import Shadows

MOST = 64
"""Lasers of a scene."""

DEEPEST = 40.0
"""Optical depth at which a beam or a ray ends: what comes from beyond is less than 1e-17."""

THINNEST = 1e-5
"""Radius of a beam in the frame's units at least."""

BEFORE = 1e-5
"""Of a beam in the frame's units, which nothing blocks: a laser that touches a wall shines off it. Or what
single precision resolves there, if that is more."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of a beam in one mixture of media; lengths in the frame's units.

    start : (3,) float64 where it begins. distance : from the laser. direction : (3,) float64, unit.
    length : of the stretch. radius : of the beam.
    power : (3,) flux that enters it, but for fog. depth : (C, 1) optical depth of the fog before it.
    extinction : (C, 1). scattering : of each phase function, (3, 1) and g.
    inside : bits of the bodies that it lies in, as in `RayMedia`. blockers : what casts shadows in the light.
    behind : distance from the laser back to a surface, of the stretch that begins there; inf of others.
    """

    start: np.ndarray
    distance: float
    direction: np.ndarray
    length: float
    radius: float
    power: np.ndarray
    depth: np.ndarray
    extinction: np.ndarray
    scattering: list[tuple[np.ndarray, float]]
    inside: np.uint64
    blockers: int
    laser: Laser
    behind: float = np.inf

    def transmittance(self, v: np.ndarray) -> np.ndarray:
        """(C, N) of the beam's fog up to v (N,) from the stretch's beginning."""
        return np.exp(-(self.depth + self.extinction * v))


@dataclass(frozen=True, eq=False)
class Beam:
    """A whole beam in the frame's units: where it starts, and how far its light gets at most.

    power : (3,) flux. inside : bits of the bodies in which it starts.
    ends : (3, M) float64 points each, where some of its rays meet surfaces; apart from one another.
    """

    origin: np.ndarray
    direction: np.ndarray
    length: float
    radius: float
    power: np.ndarray
    inside: np.uint64
    ends: list[np.ndarray]
    blockers: int
    laser: Laser


class Lasers:
    """All lasers of a scene; shared by all threads.

    beams : one a laser. stretches : of all beams, where there is fog that scatters.
    messages : what is left out, a sentence each.
    """

    def __init__(self, beams: list[Beam], stretches: list[Stretch], messages: list[str]) -> None:
        self.beams, self.stretches, self.messages = beams, stretches, messages

    @staticmethod
    def of(scene: Scene, frame: Frame, media: Media | None, shadows: Shadows) -> Lasers | None:
        """The lasers of a scene; None if it has none that shines."""
        lasers = [light for light in scene.lights if isinstance(light, Laser)]
        lasers = [light for light in lasers if (light.power > 0).any() and not (light.power < 0).any()]
        messages, beams, stretches = [], [], []
        blockers = blockers_of(scene.lights)
        if len(lasers) > MOST:
            messages.append(f"There are {len(lasers)} lasers; all but the {MOST} most powerful are left out.")
            lasers.sort(key=lambda laser: -laser.power.sum())
        for laser in lasers[:MOST]:
            axis = -laser.light_to_world[:3, 2]
            largest = np.abs(axis).max()
            if not largest > 0:
                messages.append(f'Laser "{laser.name}" has a scale of 0 along its axis; it is left out.')
                continue
            axis = axis / largest
            number = blockers.index(laser.links.blockers)
            beam, parts = _traced(laser, axis / np.linalg.norm(axis), frame, media, shadows, number)
            beams.append(beam)
            if lights_fog(laser.linking, scene.volumes):
                stretches += parts
        return Lasers(beams, stretches, messages) if beams else None


def _traced(
    laser: Laser,
    direction: np.ndarray,
    frame: Frame,
    media: Media | None,
    shadows: Shadows,
    blockers: int,
) -> tuple[Beam, list[Stretch]]:
    """A laser's beam up to the first surface that blocks it, and its stretches in fog that scatters."""
    origin = (laser.light_to_world[:3, 3] - frame.origin) * frame.scale
    power = laser.power * frame.scale**2
    radius = max(laser.radius * frame.scale, THINNEST)
    row, along = origin.astype(np.float32)[None], direction.astype(np.float32)[None]
    length = laser.length * frame.scale
    ends, left = np.zeros(0), np.ones((3, 1))
    if blockers != NONE_CAST:
        ends, part = _met(shadows, origin, direction, length, blockers)
        left = np.concatenate([left, part], axis=1)
        if ends.size and not part[:, -1].any():
            length = float(ends[-1])
    inside, fog = np.uint64(0), None
    if media is not None:
        fog, inside = media.along(row, along, length), media.along(row, along, 0.0).state[0]
    # Beside its axis a beam may pass what blocks it there.
    whole = laser.length * frame.scale
    met = _ends(origin, direction, radius, whole, shadows, blockers)
    beam = Beam(origin, direction, whole, radius, power, inside, met, blockers, laser)
    if fog is None or not length > 0:
        return beam, []
    stretches = []
    cuts = np.concatenate([[0.0], ends, [np.inf]])
    for k in range(len(fog.ray)):
        components = [(s[:, None], g) for s, g in media.components(int(fog.mixture[k]))]
        extinction = media.extinction[:, fog.mixture[k], None]
        # Where light of every colour that is scattered has gone.
        attenuates = float(extinction.min() if extinction.min() > 0 else extinction.max())
        for low, high, share in zip(cuts, cuts[1:], left.T, strict=False):
            start, end = max(low, fog.start[k]), min(high, fog.end[k])
            depth = fog.depth[:, k, None] + extinction * (start - fog.start[k])
            end = min(end, start + max(DEEPEST - float(depth.min()), 0) / attenuates) if components else start
            if end > start and share.any():
                stretches.append(
                    Stretch(
                        origin + start * direction,
                        start,
                        direction,
                        end - start,
                        radius,
                        power * share,
                        depth,
                        extinction,
                        components,
                        fog.inside[k],
                        blockers,
                        laser,
                        np.inf if start > 0 else _behind(shadows, origin, direction),
                    )
                )
    return beam, stretches


def _ends(
    origin: np.ndarray,
    direction: np.ndarray,
    radius: float,
    length: float,
    shadows: Shadows,
    blockers: int,
) -> list[np.ndarray]:
    """`Beam.ends`, from rays about its axis and along its rim."""
    side, other = (np.ravel(a) for a in basis(direction[:, None]))
    met, points = [], []
    for ring, count in ((0.0, 1), (0.6, 8), (1.0, 32)):
        for angle in 2 * np.pi * np.arange(count) / count:
            start = origin + radius * ring * (np.cos(angle) * side + np.sin(angle) * other)
            # It shines on what does not block it, too.
            for which in {ALL_CAST, blockers}:
                distances, _ = _met(shadows, start, direction, length, which)
                met.append(distances)
                points.append(start[:, None] + distances * direction[:, None])
    met, points = np.concatenate(met), np.concatenate(points, axis=1)
    order = np.argsort(met)
    cuts = np.flatnonzero(np.diff(met[order]) > 4 * radius) + 1
    return [points[:, part] for part in np.split(order, cuts)] if met.size else []


def _met(
    shadows: Shadows, start: np.ndarray, direction: np.ndarray, length: float, blockers: int
) -> tuple[np.ndarray, np.ndarray]:
    """As `Shadows.met`, of a ray of a beam from ``start`` (3,)."""
    before = unblocked(start)
    row, along = (start + before * direction).astype(np.float32)[None], direction.astype(np.float32)[None]
    distances, part = shadows.met(row, along, length - before, blockers)
    return distances + before, part


def _behind(shadows: Shadows, origin: np.ndarray, direction: np.ndarray) -> float:
    """How far behind a laser a surface is; 0 of one that it touches."""
    before = unblocked(origin)
    row, along = (origin + before * direction).astype(np.float32)[None], -direction.astype(np.float32)[None]
    distances, _ = shadows.met(row, along, np.inf)
    return max(float(distances[0]) - before, 0.0) if distances.size else np.inf


def unblocked(start: np.ndarray) -> float:
    """How much of a beam from ``start`` (3,) nothing blocks, see `BEFORE`."""
    return max(BEFORE, 4 * float(np.finfo(np.float32).eps * np.abs(start).max()))


def scattered(components: list[tuple[np.ndarray, float]], less: np.ndarray, more: np.ndarray) -> np.ndarray:
    """(3, N) scattering coefficient times phase function, for half angles as in `phase.value`."""
    return sum(sigma * phase.value(less, more, g) for sigma, g in components)


def halves(cos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What `phase.value` wants of a cosine."""
    return np.maximum(0.5 - 0.5 * cos, 0), np.maximum(0.5 + 0.5 * cos, 0)
