# SPDX-License-Identifier: GPL-3.0-or-later
"""All lights of a scene as one: sampled, met by directions, and how likely either was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from ..geometry.raytracer import FAR, RayTracer
from ..geometry.surfaces import SurfacePoints
from ..geometry.triangles import Triangles
from ..geometry.vectors import dot, take
from .emitters import Emitters
from .guide import GuidedPoints
from .highlights import Highlights
from .light_choice import EveryLight, LightChoice
from .light_estimates import Lights
from .links import Links
from .surface_shading import SurfaceShader

_ULPS = np.float32(8 * 2.0**-24)
"""Of a place: what is less may be lost in it."""


@dataclass(eq=False)
class LightSamples:
    """K vectors to lights, from points that they may light.

    which : (K,) the sample of N that each belongs to. at : (K,) the point.
    light : (K,) number, ascending; None if there is but one.
    to_light : (3, K). weight : (K,) what strength, or radiance, times the cosine is multiplied with.
    chance : (K,) probability that the light was chosen, None for 1.
    at_infinity : (K,) bool, or a bool for all.
    w : (K,) the point of primary space that chose a piece of a mesh; None of what is no sample of a mesh.
    """

    which: np.ndarray
    at: np.ndarray
    light: np.ndarray | None
    to_light: np.ndarray
    weight: np.ndarray
    chance: np.ndarray | None
    at_infinity: np.ndarray | bool
    w: np.ndarray | None = None

    def take(self, rows: np.ndarray) -> LightSamples:
        def some(a):
            return a if a is None or np.ndim(a) == 0 else a.take(rows, axis=-1)

        return LightSamples(*(some(getattr(self, f.name)) for f in fields(self)))


class SceneLights(Lights):
    """Every light of a scene, numbered group after group.

    sized : (L,) bool, whether it has a size. of_world : (K,) numbers of those that shine from all around.
    links : what they are linked to.
    any_mesh : whether one is a mesh.
    only_points : whether none has a size.
    chooses_piece : whether one has several pieces, one of which must be chosen.
    """

    def __init__(
        self,
        groups: Sequence[Emitters],
        shader: SurfaceShader,
        triangles: Triangles,
        links: Links | None = None,
    ) -> None:
        """links : of all lights, None where each is linked to everything in the scene."""
        super().__init__(groups)
        self._shader = shader
        self._triangles = triangles
        self.any_mesh = any(group.is_mesh for group in groups)
        self.chooses_piece = any(group.is_mesh and group.chooses for group in groups)
        self.only_points = all(group.is_point for group in groups)
        counts = [len(group) for group in groups]
        self.of_world = np.flatnonzero(np.repeat(np.array([g.is_world for g in groups], bool), counts))
        self._at_infinity = np.repeat(np.array([group.at_infinity for group in groups], bool), counts)
        self.sized = self._of_groups("size", np.float64) > 0
        self.links = links or Links([of for group in groups for of in group.linking], triangles)
        self._strength = np.concatenate(
            [np.zeros((3, 0), np.float32)] + [group.strength for group in groups], axis=1
        )
        self._number = np.min_scalar_type(len(self))
        self._mesh = next((group for group in groups if group.is_mesh), None)
        self._tracer = self._varies = None
        if self._mesh is not None:
            self._varies = shader.varying_emission[triangles.material]
            # What does not is passed: whether it blocks what is behind it, shadow rays tell.
            in_all = self.links.cast_by_all(triangles, self.first[-2])
            self._blocks = np.broadcast_to(triangles.casts_shadow & in_all, len(triangles))
            self._any_varies = bool(self._varies[self._mesh.row].any())
            if not shader.lambertian:
                corners = self._mesh.corners.reshape(-1, 3)
                self._tracer = RayTracer(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
        self._has_tint = any(group.has_tint for group in groups) or bool(
            self._mesh is not None and self._any_varies
        )

    def _of_groups(self, field: str, dtype: type) -> np.ndarray:
        return np.concatenate([np.zeros(0, dtype)] + [getattr(group, field) for group in self.groups])

    # -- sampled -----------------------------------------------------------------------------------

    def sample(
        self,
        points: SurfacePoints,
        cell: np.ndarray | None,
        at: np.ndarray | None,
        u: np.ndarray,
        choice: LightChoice | EveryLight | None,
        split: int,
        highlights: Highlights | None = None,
        guided: GuidedPoints | None = None,
    ) -> LightSamples:
        """Samples for points ``at`` (K,) (None for all in order), ``split`` in a row at each.

        cell : of the points. u : (D, K): two dimensions on a light, and one to choose it or a piece of it.
        highlights : of the points; None if they are not glossy.
        guided : where on lights samples are, None for as often everywhere. Weights know of it, `density` does
            not: the power heuristic is right by whatever densities, if lights and lobes take the same.
        """
        samples = self._sample(points, cell, at, u, choice, split, highlights, guided)
        if not self.links.all_lit:
            samples.weight *= self.links.lit(samples.light, points.triangle.take(samples.at))
        return samples

    def _sample(self, points, cell, at, u, choice, split, highlights, guided) -> LightSamples:
        if len(self) == 1:
            position, normal = (a if at is None else take(a, at) for a in (points.position, points.normal))
            # Only a mesh has a use for the third, its choice of a piece.
            group = self.groups[0]
            place, gain = (u[:2], None) if guided is None else guided.stretched(0, at, u[:2])
            to_light, weight = group.sample(None, position, normal, u[-1], place)
            if gain is not None:
                weight = weight * gain
            which = np.arange(u.shape[1])
            return LightSamples(
                which,
                which if at is None else at,
                None,
                to_light,
                weight,
                None,
                group.at_infinity,
                u[-1] if group.is_mesh else None,
            )
        if isinstance(choice, EveryLight):
            count, chance = u.shape[1], None
            order = np.tile(np.arange(count), len(self))
            light = np.repeat(np.arange(len(self)), count)
            w = u[-1].take(order)
        else:
            rows = at if at is None or split == 1 else at[::split]
            position, normal = points.position, points.normal
            kind = None if self.links.all_lit else self.links.kind(points.triangle)
            if rows is not None and (split == 1 or len(rows) < len(points)):
                position, normal = take(position, rows), take(normal, rows)
                cell, kind, highlights = (x if x is None else x.take(rows) for x in (cell, kind, highlights))
            w = u[2].reshape(-1, split)
            light, chance, w = choice.choose(position, normal, cell, w, kind, highlights)
            # Side by side, samples of one light run through the same code and towards the same place.
            order = np.argsort(light.astype(self._number), kind="stable")
            light, chance, w = light.take(order), chance.take(order), w.take(order)
        at = order if at is None else at.take(order)
        position, normal = take(points.position, at), take(points.normal, at)
        place, gains = take(u[:2], order), {}
        for one in [] if guided is None else guided.gaining:
            part = slice(*np.searchsorted(light, [one, one + 1]))
            place[:, part], gains[part.start, part.stop] = guided.stretched(one, at[part], place[:, part])
        to_light, weight, at_infinity = self._sample_sorted(light, position, normal, w, place)
        for part, gain in gains.items():
            weight[slice(*part)] *= gain
        if chance is not None:
            weight /= chance
        w = w if self.any_mesh else None
        return LightSamples(order, at, light, to_light, weight, chance, at_infinity, w)

    def sample_in_space(
        self, light: np.ndarray | None, position: np.ndarray, u: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | bool]:
        """Samples of lights ``light`` (K,), ascending, from points (3, K) in space; None for the only light.

        u : (2, K) on the light. w : (K,) to choose among a mesh's pieces.
        Returns vectors (3, K), weights (K,) and `at_infinity`, as in `LightSamples`. Weight times
        `strength_in_space` is fluence, what all directions together bring of the light.
        """
        if light is None:
            group = self.groups[0]
            return *group.sample(None, position, None, w, u), group.at_infinity
        return self._sample_sorted(light, position, None, w, u)

    def met_in_space(
        self, light: np.ndarray | None, position: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where unit directions (3, K) from points (3, K) meet lights ``light`` (K,), ascending, none of them
        a mesh; None for the only one.

        Returns vectors (3, K), and what `strength_in_space` must be multiplied with to be radiance (K,), 0
        where the light is not met.
        """
        to_light, weight = np.empty(direction.shape, np.float32), np.empty(direction.shape[1], np.float32)
        for group, part, which in self._parts(light):
            unit = direction[:, part].astype(np.float32)
            distance, gain = group.met(which, position[:, part], unit)
            met = gain > 0
            to_light[:, part] = unit * np.where(met, distance, 1)
            weight[part] = np.where(met, gain, 0) / group.size[0 if which is None else which]
        return to_light, weight

    def _sample_sorted(self, light, position, normal, w, u):
        """Samples of lights in ascending order, kind after kind."""
        n = len(light)
        to_light, weight = np.empty((3, n), np.float32), np.empty(n, np.float32)
        at_infinity = np.zeros(n, bool)
        cuts = np.searchsorted(light, self.first)
        for group, start, low, high in zip(self.groups, self.first[:-1], cuts[:-1], cuts[1:], strict=True):
            if low == high:
                continue
            part = slice(low, high)
            which = light[part] - start if len(group) > 1 else None
            to_light[:, part], weight[part] = group.sample(
                which, position[:, part], None if normal is None else normal[:, part], w[part], u[:, part]
            )
            at_infinity[part] = group.at_infinity
        if len({group.at_infinity for group in self.groups}) == 1:
            at_infinity = self.groups[0].at_infinity
        return to_light, weight, at_infinity

    def strength(self, points: SurfacePoints, samples: LightSamples, rows: np.ndarray) -> np.ndarray:
        """(3, J) or (3, 1) strength of the lights of samples ``rows`` (J,), towards their points."""
        if not self._has_tint:
            return self._strength if samples.light is None else take(self._strength, samples.light.take(rows))
        samples = samples.take(rows)
        return self._tinted(samples.light, points.position, samples.at, samples.to_light, samples.w)

    def strength_in_space(
        self, light: np.ndarray | None, position: np.ndarray, to_light: np.ndarray, w: np.ndarray
    ) -> np.ndarray:
        """(3, K) or (3, 1) strength of what `sample_in_space` was given, and gave."""
        if not self._has_tint:
            return self._strength if light is None else take(self._strength, light)
        return self._tinted(light, position, None, to_light, w)

    def _tinted(
        self,
        light: np.ndarray | None,
        position: np.ndarray,
        at: np.ndarray | None,
        to_light: np.ndarray,
        w: np.ndarray | None,
    ) -> np.ndarray:
        """(3, K) strength of lights towards points ``at`` (K,) of all, where it varies with the direction."""
        strength = self._strength if light is None else take(self._strength, light)
        strength = np.array(np.broadcast_to(strength, to_light.shape))
        vectors = to_light
        for group, part, which in self._parts(light):
            to_light = vectors[:, part]
            if group.has_tint:
                strength[:, part] *= group.tint(which, to_light)
            elif group.is_mesh and self._any_varies:
                here = position[:, part] if at is None else take(position, at[part])
                triangle, u, v = group.place_of(group.piece(which, here, w[part]), here, to_light)
                size = group.size[0 if which is None else which].astype(np.float32)
                size = np.broadcast_to(size, len(triangle))
                rows = np.flatnonzero(self._varies.take(triangle))
                emission = self._emission(
                    triangle.take(rows), u.take(rows), v.take(rows), take(to_light, rows)
                )
                strength[:, part][:, rows] = emission * size.take(rows)
        return strength

    def _emission(
        self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray, to_light: np.ndarray
    ) -> np.ndarray:
        """(3, K) radiance of points of triangles against ``to_light``."""
        points = self._shader.points_on(triangle, u, v, -to_light)
        return self._shader.emission(points, -to_light)

    def _parts(self, light: np.ndarray | None):
        """The groups that ``light`` (K,) are of, which slice of these is theirs, and their numbers in it."""
        if light is None:
            yield self.groups[0], slice(None), None
            return
        cuts = np.searchsorted(light, self.first)
        for group, start, low, high in zip(self.groups, self.first[:-1], cuts[:-1], cuts[1:], strict=True):
            if low < high:
                part = slice(low, high)
                yield group, part, light[part] - start if len(group) > 1 else None

    def density(self, points: SurfacePoints, samples: LightSamples) -> np.ndarray:
        """(K,) pdf per solid angle with which sampling takes these samples, their lights' chance included.

        Infinite where a light has no size: nothing else meets it.
        """
        position, normal = take(points.position, samples.at), take(points.normal, samples.at)
        density = self._density(samples.light, position, normal, samples.to_light, samples.w)
        if samples.chance is not None:
            density *= samples.chance
        return density

    def density_in_space(
        self, light: np.ndarray | None, position: np.ndarray, to_light: np.ndarray, w: np.ndarray
    ) -> np.ndarray:
        """(K,) pdf per solid angle with which `sample_in_space` takes ``to_light`` (3, K).

        As in `density`, infinite where a light has no size.
        """
        return self._density(light, position, None, to_light, w)

    def _density(self, light, position, normal, to_light, w):
        density = np.empty(position.shape[1], np.float32)
        for group, part, which in self._parts(light):
            where = position[:, part], None if normal is None else normal[:, part], to_light[:, part]
            if group.is_mesh:
                density[part] = group.pdf_of_piece(group.piece(which, where[0], w[part]), *where)
            else:
                density[part] = group.pdf(which, *where)
        if not self.sized.all():
            density[~self.sized.take(0 if light is None else light)] = np.inf
        return density

    def chance(
        self,
        points: SurfacePoints,
        samples: LightSamples,
        choice: LightChoice,
        cell: np.ndarray | None,
        highlights: Highlights | None,
    ) -> np.ndarray:
        """(K,) probability with which a choice takes the lights of samples.

        cell : of the points, and their highlights, as in `sample`.
        """
        cell = None if cell is None else cell.take(samples.at)
        highlights = None if highlights is None else highlights.take(samples.at)
        position, normal = take(points.position, samples.at), take(points.normal, samples.at)
        kind = None if self.links.all_lit else self.links.kind(points.triangle.take(samples.at))
        return choice.pdf(samples.light, position, normal, cell, kind, highlights)

    # -- met ---------------------------------------------------------------------------------------

    def along(
        self, points: SurfacePoints, at: np.ndarray, direction: np.ndarray
    ) -> tuple[LightSamples, np.ndarray, np.ndarray]:
        """Lights of some size that unit directions (3, K) from points ``at`` (K,) meet, as samples.

        Returns the samples (J), ``which`` of them the number of the direction; their radiance (3, J); and
        the density (J,) with which `sample` would have taken them, but for the light's chance.
        """
        position, normal = take(points.position, at), take(points.normal, at)
        lanes, lights, vectors, radiances, densities = [], [], [], [], []
        for group, start in zip(self.groups, self.first[:-1], strict=True):
            if group.is_point:
                continue
            if group.is_mesh:
                # Off the triangle that they start from, which is not to meet itself.
                geometric, triangle = take(points.geometric, at), points.triangle.take(at)
                lift = (
                    np.copysign(self._triangles.offset.take(triangle), dot(geometric, direction)) * geometric
                )
                found = self._mesh_along(group, position, lift, normal, direction)
            else:
                found = self._group_along(group, position, normal, direction)
            for lane, light, to_light, radiance, density in found:
                lanes.append(lane)
                lights.append(light + start)
                vectors.append(to_light)
                radiances.append(radiance)
                densities.append(density)
        if not lanes:
            lanes, lights, densities = ([np.zeros(0, t)] for t in (np.intp, np.intp, np.float32))
            vectors = radiances = [np.zeros((3, 0), np.float32)]
        light = np.concatenate(lights)
        order = np.argsort(light, kind="stable")
        light, lane = light.take(order), np.concatenate(lanes).take(order)
        to_light = take(np.concatenate(vectors, axis=1), order)
        samples = LightSamples(
            lane, at.take(lane), light, to_light, None, None, self._at_infinity.take(light)
        )
        radiance = take(np.concatenate(radiances, axis=1), order)
        if not self.links.all_lit:
            radiance *= self.links.lit(light, points.triangle.take(samples.at))
        return samples, radiance, np.concatenate(densities).take(order)

    @staticmethod
    def _group_along(group: Emitters, position: np.ndarray, normal: np.ndarray, direction: np.ndarray):
        for hits in group.hits(position, direction):
            radiance = take(group.radiance, hits.light)
            if hits.gain is not None:
                radiance = radiance * hits.gain
            to_light = take(direction, hits.lane) * hits.distance
            which = hits.light if len(group) > 1 else None
            density = group.pdf(which, take(position, hits.lane), take(normal, hits.lane), to_light)
            yield hits.lane, hits.light, to_light, radiance, density

    def _mesh_along(
        self, group, position: np.ndarray, lift: np.ndarray, normal: np.ndarray, direction: np.ndarray
    ):
        """The first emissive triangle that each ray meets, and what is behind those that cast no shadow.

        lift : (3, K) how far off points at ``position`` (3, K) rays begin. A triangle of the scene that is
        cut counts once.
        """
        ray = np.arange(position.shape[1])
        travelled, step = np.zeros((2, len(ray)), np.float32)
        last = np.full(len(ray), -1)
        size, start = np.abs(position).max(axis=0), position + lift
        while ray.size:
            origins = np.ascontiguousarray((take(start, ray) + take(direction, ray) * travelled).T)
            hits = self._tracer.closest_hit(origins, np.ascontiguousarray(take(direction, ray).T), FAR)
            met = np.flatnonzero(hits.triangle >= 0)
            ray, travelled, step, last = (x.take(met) for x in (ray, travelled, step, last))
            piece = hits.triangle.take(met)
            triangle = group.row.take(piece)
            further = hits.distance.take(met)
            travelled += further
            new = np.flatnonzero(triangle != last)
            if new.size:
                yield self._met(
                    group, position, lift, normal, direction, ray.take(new), piece.take(new),
                    travelled.take(new), hits.u.take(met.take(new)), hits.v.take(met.take(new)),
                )  # fmt: skip
            # A ray may meet a triangle that it grazes again and again: ever further then, and by no step that
            # float32 rounds away.
            offset = np.maximum(self._triangles.offset.take(triangle), np.float32(1e-30))
            offset = np.maximum(offset, _ULPS * np.maximum(size.take(ray), travelled))
            step = np.where(further < 4 * step, 2 * step, offset)
            on = np.flatnonzero(~self._blocks.take(triangle))
            ray, travelled, step, last = (
                ray.take(on),
                (travelled + step).take(on),
                step.take(on),
                triangle.take(on),
            )

    def _met(self, group, position, lift, normal, direction, ray, piece, distance, u, v):
        """What `along` says of pieces (K,) that rays (K,) meet."""
        light = group.light_of.take(piece)
        to_light = take(lift, ray) + take(direction, ray) * distance
        off_it = group.lift(piece, to_light)
        density = group.pdf_of_piece(piece, take(position, ray), take(normal, ray), to_light)
        radiance = take(group.radiance, light) * off_it
        triangle, u, v = group.on_scene(piece, u, v)
        varies = np.flatnonzero(self._varies.take(triangle))
        if varies.size:
            radiance[:, varies] = off_it.take(varies) * self._emission(
                triangle.take(varies), u.take(varies), v.take(varies), take(to_light, varies)
            )
        return ray, light, to_light, radiance, density
