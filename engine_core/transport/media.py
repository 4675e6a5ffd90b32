# SPDX-License-Identifier: GPL-3.0-or-later
"""The fogs of a scene: which of them a ray runs through, and what they leave of its light.

Media are homogeneous within closed meshes, or everywhere, and add up where they overlap, as in Cycles.
Where a ray is inside of what is a set of bits, one a body. Optical depth is linear in it: what only asks for
the depth sums over bodies, and needs no order.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import numpy as np

from ..errors import RenderError
from ..geometry.boundaries import MOST, Boundaries
from ..geometry.frame import Frame
from ..geometry.joined_bodies import joined
from ..geometry.vectors import take
from ..scene import Scene, Volume
from ..shading.terms import LARGEST
from .phase import bounded

DIRECT = 12
"""Bodies, up to which a set of bits is the number of its mixture."""

_SLIVER = 4e-7
"""Of the distance: spans that are shorter are what rounding makes of coincident faces."""

_FOR_EVER = 1e300


@dataclass(eq=False)
class RayMedia:
    """The media along N rays, in K segments of one mixture each, sorted by ray, then distance.

    ray : (K,). start, end : (K,) float64 in the frame's unit lengths from the origin; ``end`` may be inf.
    inside : (K,) uint64, bit b if in body b. mixture : (K,) row of the tables of `Media`.
    depth : (C, K) float32 optical depth before the start.
    total : (C, N) float32 optical depth to the ray's end, inf included. state : (N,) uint64, inside of what.
    emission : (3, N) float32, the integral of transmittance times emission, or None if nothing glows.

    Of the segments those that neither attenuate nor emit are left out; and slivers, though not from depths.
    """

    ray: np.ndarray
    start: np.ndarray
    end: np.ndarray
    inside: np.ndarray
    mixture: np.ndarray
    depth: np.ndarray
    total: np.ndarray
    state: np.ndarray
    emission: np.ndarray | None


class Media:
    """All media of a scene, per unit length of the frame.

    grey : whether all extinction is grey; optical depths have C = 1 channel then, else 3.
    extinction : (C, R) of R mixtures. emission : (3, R). scattering : (G, 3, R) of phase functions whose
    anisotropy is (G,). Rows are what `RayMedia.mixture` says.
    emits : whether anything glows. bodies : how many closed meshes there are. convex : whether all of them
    are, so that between two points inside there is nothing to cross.
    """

    def __init__(
        self, boundaries: Boundaries, volumes: list[Volume], everywhere: Volume | None, scale: float
    ) -> None:
        """volumes : of each body. everywhere : what fills all space."""
        self._boundaries = boundaries
        self.bodies, self.convex = len(boundaries), boundaries.convex
        parts = [*volumes, Volume() if everywhere is None else everywhere]
        anisotropy = [bounded(volume.anisotropy) for volume in parts]
        self.anisotropy = np.unique(np.concatenate(anisotropy))
        scattering = np.zeros((len(parts), len(self.anisotropy), 3))
        for volume, g, rows in zip(parts, anisotropy, scattering, strict=True):
            np.add.at(rows, np.searchsorted(self.anisotropy, g), volume.scattering)
        extinction = np.array([volume.extinction for volume in parts])
        self.grey = bool((extinction == extinction[:, :1]).all())
        extinction = extinction[:, :1] if self.grey else extinction
        emission = np.array([volume.emission for volume in parts])
        self.emits = bool(emission.any())
        width = extinction.shape[1]
        # Of each body (B + 1, C + 3 + 3 G), the world's last.
        self._of_body = (
            np.concatenate([extinction, emission, scattering.reshape(len(parts), -1)], axis=1) / scale
        )
        self._extinction = self._of_body[:, :width]
        self._growing = Lock()
        self._sets = np.arange(2**self.bodies if self.bodies <= DIRECT else 1, dtype=np.uint64)
        self._row = {int(s): i for i, s in enumerate(self._sets)}
        self._fill()

    @staticmethod
    def of(scene: Scene, frame: Frame) -> Media | None:
        """The media of a scene; None if there are none that attenuate or emit."""

        def volume_of(index: int) -> Volume | None:
            volume = scene.volumes[index] if index >= 0 else None
            return volume if volume and (volume.extinction.any() or volume.emission.any()) else None

        meshes = [mesh for mesh in scene.meshes if len(mesh.triangles) and volume_of(mesh.volume)]
        everywhere = volume_of(scene.world.volume)
        if not meshes and everywhere is None:
            return None
        bodies = [(frame.positions(mesh.vertices), mesh.triangles) for mesh in meshes]
        volumes = [volume_of(mesh.volume) for mesh in meshes]
        if len(bodies) > MOST:
            # Where they are crowded, rays are traced through them longer than through as many that are apart.
            alike: dict[tuple, int] = {}
            kinds = [alike.setdefault(_content(volume), len(alike)) for volume in volumes]
            of_kind = dict(zip(kinds, volumes, strict=True))
            bodies, kinds = joined(bodies, kinds)
            volumes = [of_kind[kind] for kind in kinds]
        if len(bodies) > MOST:
            raise RenderError(
                f"{len(meshes)} meshes enclose volumes, of which {len(bodies)} are open, unlike others or "
                f"overlap some, more than {MOST}: close them, give them fewer different volumes, or join them"
            )
        return Media(Boundaries(bodies), volumes, everywhere, frame.scale)

    # -- tables ------------------------------------------------------------------------------------

    def _fill(self) -> None:
        bits = (self._sets[:, None] >> np.arange(self.bodies, dtype=np.uint64)) & np.uint64(1)
        table = (bits.astype(np.float64) @ self._of_body[:-1] + self._of_body[-1]).T
        width = self._extinction.shape[1]
        scattering = table[width + 3 :].reshape(len(self.anisotropy), 3, -1)
        self._fills = table[: width + 3].any(axis=0)
        # In one assignment, as other threads read it.
        self._tables = table[:width], table[width : width + 3], scattering

    @property
    def extinction(self) -> np.ndarray:
        return self._tables[0]

    @property
    def emission(self) -> np.ndarray:
        return self._tables[1]

    @property
    def scattering(self) -> np.ndarray:
        return self._tables[2]

    def components(self, mixture: int) -> list[tuple[np.ndarray, float]]:
        """Scattering coefficient (3,) and anisotropy of each phase function of a mixture, if it scatters."""
        of_mixture = zip(self.scattering[:, :, mixture], self.anisotropy, strict=True)
        return [(sigma, float(g)) for sigma, g in of_mixture if sigma.any()]

    def mixture_of(self, inside: np.ndarray) -> np.ndarray:
        """(K,) rows of the tables for sets of bits (K,)."""
        if self.bodies <= DIRECT:
            return inside.astype(np.intp)
        sets, which = np.unique(inside, return_inverse=True)
        with self._growing:
            new = [s for s in sets if int(s) not in self._row]
            if new:
                self._row |= {int(s): len(self._sets) + i for i, s in enumerate(new)}
                self._sets = np.append(self._sets, new)
                self._fill()
            rows = np.array([self._row[int(s)] for s in sets], np.intp)
        return rows.take(which.reshape(-1))

    def glowing(self) -> tuple[list[tuple[np.ndarray, float, float]], bool]:
        """The bodies that glow, as centre (3,) and radius of a ball around each and how bright it is from
        afar, about; and whether anything scatters outside of these.
        """
        width = self._extinction.shape[1]
        emission = self._of_body[:-1, width : width + 3].mean(axis=1)
        scatters = self._of_body[:, width + 3 :].any(axis=1)
        bodies = np.flatnonzero(emission)
        balls = [self._boundaries.balls[body] for body in bodies]
        radius = np.array([radius for _, radius in balls])
        bright = emission[bodies] * radius**3 / (1 + self._extinction.mean(axis=1)[bodies] * radius)

        def held(body: int) -> bool:
            centre, radius = self._boundaries.balls[body]
            return any(np.linalg.norm(centre - c) + radius <= 1.001 * r for c, r in balls)

        beyond = scatters[-1] or not all(held(body) for body in np.flatnonzero(scatters[:-1]))
        return [(*ball, float(b)) for ball, b in zip(balls, bright, strict=True)], bool(beyond)

    # -- along rays --------------------------------------------------------------------------------

    def optical_depth(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        reach: float | np.ndarray,
        inside: np.ndarray | None = None,
        clip: float = np.inf,
    ) -> np.ndarray:
        """(C, N) float32 optical depth of rays, inf where they run on in the world's medium for ever.

        origins, directions : (N, 3) float32, of any length, in which ``reach`` is measured, a number or (N,).
        inside : (N,) uint64, the bodies in which rays begin; None if unknown, which is enough but for meshes
            that are open.
        clip : how far bodies are met, as a camera's far plane hides them, though not the world's medium.
        """
        directions, reach = _broadcast(origins, directions, reach)
        n = len(origins)
        depth = np.zeros((self._extinction.shape[1], n))
        with np.errstate(over="ignore", invalid="ignore"):
            unit = _norm(directions)
            if self.bodies:
                spans = self._boundaries.spans(origins, directions, np.minimum(reach, clip), inside)
                # Finite, as 0 times it is 0.
                length = np.minimum((spans.end - spans.start) * unit.take(spans.ray), _FOR_EVER)
                for out, coefficients in zip(depth, self._extinction[:-1].T, strict=True):
                    out += np.bincount(spans.ray, coefficients.take(spans.body) * length, n)
            for out, coefficient in zip(depth, self._extinction[-1], strict=True):
                if coefficient > 0:
                    out += coefficient * (reach * unit)
            return depth.astype(np.float32)

    def met(self, origins: np.ndarray, directions: np.ndarray, end: float | np.ndarray) -> np.ndarray:
        """(N,) uint64, the bodies that rays run through before their ``end``; arguments as in `along`."""
        directions, end = _broadcast(origins, directions, end)
        met = np.zeros(len(origins), np.uint64)
        if self.bodies:
            spans = self._boundaries.spans(origins, directions, end, None)
            np.bitwise_or.at(met, spans.ray, _bits(spans.body))
        return met

    def along(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        end: float | np.ndarray,
        inside: np.ndarray | None = None,
        clip: float = np.inf,
    ) -> RayMedia:
        """What rays run through before their ``end``; arguments as in `optical_depth`."""
        n = len(origins)
        directions, end = _broadcast(origins, directions, end)
        ray, start, until, inside, state = self._stretches(origins, directions, end, inside, clip)
        mixture = self.mixture_of(inside)
        filled = np.flatnonzero(self._fills.take(mixture) & (until > start))
        if len(filled) < len(ray):
            ray, start, until, inside, mixture = (
                x.take(filled) for x in (ray, start, until, inside, mixture)
            )
        sigma = take(self.extinction, mixture)
        unit = _norm(directions).take(ray)
        start, until = start * unit, until * unit
        length = until - start
        with np.errstate(invalid="ignore", over="ignore"):
            own = sigma * length
            own[sigma == 0] = 0
        before = _sum_before(ray, own)
        total = np.stack([np.bincount(ray, channel, n) for channel in own])
        emission = None
        if self.emits:
            glow = take(self.emission, mixture)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                effective = np.where(sigma > 0, -np.expm1(-own) / sigma, length) * np.exp(-before)
                light = np.where(glow > 0, np.minimum(glow * effective, LARGEST), 0)
            emission = np.stack([np.bincount(ray, channel, n) for channel in light]).astype(np.float32)
        some = np.flatnonzero(length > _SLIVER * start)
        if len(some) < len(ray):
            ray, start, until, inside, mixture = (x.take(some) for x in (ray, start, until, inside, mixture))
            before = take(before, some)
        with np.errstate(over="ignore"):
            before, total = before.astype(np.float32), total.astype(np.float32)
        return RayMedia(ray, start, until, inside, mixture, before, total, state, emission)

    def _stretches(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        end: np.ndarray,
        inside: np.ndarray | None,
        clip: float,
    ) -> tuple[np.ndarray, ...]:
        """Stretches of rays: which (K,), from where to where (K,), inside of what (K,); and `RayMedia.state`.

        In lengths of the direction. Some may be outside of everything, or have no length.
        """
        n = len(origins)
        state, everywhere = np.zeros(n, np.uint64), np.arange(n)
        if self.bodies == 0:
            return everywhere, np.zeros(n), end, state, state
        spans = self._boundaries.spans(origins, directions, np.minimum(end, clip), inside)
        bits = _bits(spans.body)
        on = np.flatnonzero(spans.end >= end.take(spans.ray))
        np.bitwise_or.at(state, spans.ray.take(on), bits.take(on))
        if self.bodies == 1 and not self._fills[0]:
            order = np.argsort(spans.ray, kind="stable")
            return *(x.take(order) for x in (spans.ray, spans.start, spans.end, bits)), state
        ray = np.concatenate([everywhere, spans.ray, spans.ray])
        start = np.concatenate([np.zeros(n), spans.start, spans.end])
        changes = np.concatenate([np.zeros(n, np.uint64), bits, bits])
        order = _by_ray(ray, start)
        ray, start = ray.take(order), start.take(order)
        # Where spans end with their ray, bits need no new beginning.
        within = np.bitwise_xor.accumulate(changes.take(order))
        until = np.append(start[1:], 0)[: len(ray)]
        last = np.flatnonzero(np.append(ray[1:] != ray[:-1], True)[: len(ray)])
        until[last] = end.take(ray.take(last))
        return ray, start, until, within, state

    def seen(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        end: float | np.ndarray,
        inside: np.ndarray | None = None,
        clip: float = np.inf,
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Transmittance (3, N) of rays to their ends, and what media emit on the way (3, N), None for 0.
        Arguments as in `optical_depth`.
        """
        if self.emits:
            media = self.along(origins, directions, end, inside, clip)
            return self.transmittance(media.total), media.emission
        return self.transmittance(self.optical_depth(origins, directions, end, inside, clip)), None

    @staticmethod
    def transmittance(depth: np.ndarray) -> np.ndarray:
        """(3, N) of optical depths (C, N)."""
        return np.broadcast_to(np.exp(-depth), (3, depth.shape[1]))


def _content(volume: Volume) -> tuple:
    """What two volumes have in common that are the same."""
    arrays = volume.scattering, volume.absorption, volume.anisotropy, volume.emission
    return *(np.asarray(a, np.float64).tobytes() for a in arrays), volume.light_set


def _bits(body: np.ndarray) -> np.ndarray:
    """(K,) uint64 sets of one body each."""
    return np.left_shift(np.uint64(1), body.astype(np.uint64))


def _broadcast(
    origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Directions (N, 3) and reach (N,) float64 of N rays."""
    if len(directions) != len(origins):
        directions = np.ascontiguousarray(np.broadcast_to(directions, origins.shape))
    return directions, np.broadcast_to(np.asarray(reach, np.float64), len(origins))


def _norm(directions: np.ndarray) -> np.ndarray:
    """(N,) float64 lengths of (N, 3) directions."""
    x, y, z = directions.T.astype(np.float64)
    return np.sqrt(x * x + y * y + z * z)


def _by_ray(ray: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(K,) order of events by ray, then by where they are, which is at least 0, to float32's precision."""
    # Floats that are not negative sort like the integers of the same bits. One key takes an eighth of the
    # time of two; a stretch between events that it swaps has no length, or less.
    with np.errstate(over="ignore"):
        bits = at.astype(np.float32).view(np.uint32)
    return np.argsort(ray.astype(np.uint64) << np.uint64(32) | bits, kind="stable")


def _sum_before(ray: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(C, K) sums of ``values`` (C, K) of the same ray, which are side by side, before each."""
    before = np.zeros_like(values)
    rows = np.flatnonzero(ray[1:] == ray[:-1]) + 1
    # One after another: a difference of running sums would lose what a thick fog elsewhere adds to.
    while rows.size:
        first = rows[np.append(True, rows[1:] != rows[:-1] + 1)] if rows.size else rows
        before[:, first] = before[:, first - 1] + values[:, first - 1]
        rows = rows[np.append(False, rows[1:] == rows[:-1] + 1)]
    return before
