# SPDX-License-Identifier: GPL-3.0-or-later
"""Direct illumination as a staged function of primary space.

    first : (screen 2, lens 2 if it has a size) -> camera hits, what is seen without another dimension
    rest  : (light 2, light choice 1) -> radiance reflected at those hits (one light needs no choice)

    L_o = integral over the lights of f L_e V cos cos' / d^2 dA      (thesis eq. 5.1)

Every light's map is in `emitters`, every lobe's in `bsdf`; the choice among lights is one more dimension.
Lights and lobes are sampled at the same point of primary space and summed, weighed by the power heuristic
(thesis eq. 4.1, 5.4, 5.5), so that both together are one function, which polynomials follow.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from threading import Lock
from time import perf_counter

import numpy as np

from ..bsdf.diffuse import DiffuseTransmission, Lambert
from ..geometry.frame import frame_of
from ..geometry.surfaces import NONE_CAST, SurfacePoints, Surfaces
from ..geometry.triangles import gather_triangles
from ..geometry.vectors import dot, inverse_length, take
from ..scene import Scene
from ..shading.terms import LARGEST
from .camera_hits import ALPHA, NORMAL, RGB, CameraHits, CameraStage, Pixels, SomePixels
from .emitters import emitter_groups
from .glow_on_surfaces import GlowDirections
from .guide import Guide, GuidedPoints
from .highlights import Highlights
from .light_choice import WEIGHED, CandidateLights, EveryLight, LightChoice, WeighedLights
from .light_clusters import CELL, Clusters, clusters_of_cells, pilot_points
from .light_samples import LightSamples, SceneLights
from .links import Links, blockers_of, linked_emitters, linked_to_some_fogs
from .media import Media
from .shadows import Shadows
from .surface_shading import LobeGatherer, Slot, SurfaceShader

CAMERA, SHADOW, BSDF, CROSSING = "camera rays", "shadow rays", "BSDF rays", "transparent crossings"
"""Kinds of rays: into the scene, to sampled lights, along directions that lobes sampled, and on behind
transparent surfaces."""

NON_FINITE = "non-finite samples"

EVERY_POINT = 128
"""Lights up to which all are sampled at every hit, if none has a size: they need no net, and many spots light
few places, so that a choice among them costs as much as the rays that it saves."""

_AT_ONCE = 1 << 20
"""Samples of these, about."""

__all__ = [
    "ALPHA",
    "NORMAL",
    "RGB",
    "CameraHits",
    "DirectLight",
    "DirectLightOverTile",
    "Pixels",
    "Reflected",
    "SomePixels",
]


@dataclass(eq=False)
class Reflected:
    """Light samples that arrive: which (K,) of the N, more than once for several lights; radiance (3, K).

    counts : rays by kind that it took, and samples that were not finite, which count as 0.
    """

    which: np.ndarray
    radiance: np.ndarray
    counts: Counter[str] = field(default_factory=Counter)

    @staticmethod
    def joined(parts: Sequence[Reflected]) -> Reflected:
        if len(parts) == 1:
            return parts[0]
        return Reflected(
            np.concatenate([part.which for part in parts]),
            np.concatenate([part.radiance for part in parts], axis=1),
            sum((part.counts for part in parts), Counter()),
        )


NOTHING = Reflected(np.zeros(0, np.intp), np.zeros((3, 0), np.float32))


class DirectLight:
    """The integrand of a scene: rays, surfaces, emitters. Shared by all threads.

    messages : what of the scene is left out, one sentence each.
    screen_dimensions : 2 of a pixel, and 2 of a lens that has a size.
    rest_dimensions : 2 on a light, and 1 for the choice of a light or of a piece of it.
    only_points : no light has a size, and no fog glows.
    samples_every : no light is chosen: a hit gets one sample of each. channels, transparent,
        sees : as in `CameraStage`.
    media : the fogs of the scene, None for none.
    frame, shader, surfaces, stage, shadows : what else it is made of.
    reflects : whether light off any surface may be seen. shows : whether anything but depth may be.
    guide : of lights, and how surfaces are lit by these; None as long as nothing is learned.
    sampling : "mis", "light" or "bsdf". lambertian : all surfaces are.
    seconds : that building it took, by stage.
    """

    def __init__(
        self,
        scene: Scene,
        transparent: bool = False,
        normals: bool = False,
        sampling: str = "mis",
        crossings: int = 8,
    ) -> None:
        """transparent : the background has no radiance and alpha 0. normals : integrate them too.

        sampling : of what is not diffuse, "mis", "light" or "bsdf".
        crossings : how many transparent surfaces a ray may cross.
        """
        times = [perf_counter()]
        self.frame = frame = frame_of(scene)
        triangles, self.messages = gather_triangles([mesh for mesh in scene.meshes if mesh.surface], frame)
        self.media = Media.of(scene, frame)
        times.append(perf_counter())
        self.shader = shader = SurfaceShader(scene.materials, triangles, frame)
        transmits = shader.transmits
        times.append(perf_counter())
        of_triangle = transmits[triangles.material] if transmits.any() else None
        materials = shader.with_mean_emission(scene.materials)
        emitters = linked_emitters(scene.meshes, materials)
        blockers = blockers_of(scene.lights, emitters)
        self.surfaces = Surfaces(triangles, of_triangle, blockers)
        times.append(perf_counter())
        groups, messages = emitter_groups(scene.lights, scene.world, materials, triangles, frame, transmits)
        self.messages += messages
        linking = [links for group in groups for links in group.linking]
        self.messages += linked_to_some_fogs(scene.lights, emitters, scene.volumes)
        links = Links(linking, triangles, blockers, scene.volumes)
        self.lights = SceneLights(groups, shader, triangles, links)
        times.append(perf_counter())
        stages = ("triangles", "materials", "Embree", "emitters")
        self.seconds = dict(zip(stages, np.diff(times).tolist(), strict=True))
        self._glows = self.media is not None and self.media.emits
        self._glowing = GlowDirections(self.media) if self._glows else None
        self.chooses_piece = self.lights.chooses_piece
        self.only_points = self.lights.only_points and not self._glows
        self.stage = CameraStage(
            scene, frame, self.surfaces, shader, groups, transparent, normals, crossings, self.media
        )
        self.channels, self.transparent = self.stage.channels, self.stage.transparent
        self.sees = self.stage.sees
        self.lambertian = shader.lambertian
        self.shadows = Shadows(self.surfaces, shader, crossings, self.media)
        self._weighed = WeighedLights(self.lights, self.lights.links.kinds)
        self.sampling = sampling
        self.guide: Guide | None = None
        self.samples_every = self.only_points and 1 < len(self.lights) <= EVERY_POINT
        self.screen_dimensions = self.stage.dimensions
        self.rest_dimensions = 3 if len(self.lights) > 1 or self.chooses_piece else 2
        reflectance = np.array([m.reflectance for m in materials], np.float32).reshape(-1, 3)
        self._reflectance = reflectance.T / np.float32(np.pi)
        self._one_material = len(materials) == 1
        used = np.unique(triangles.material)
        self.reflects = len(self.lights) > 0 and not (
            shader.lambertian and not self._reflectance[:, used].any()
        )
        glows = self.media is not None and (self.media.emits or transparent)
        self.shows = bool(
            not shader.lambertian or self.reflects or self.sees or glows or self.transparent or normals
        )

    # -- choosing among lights ---------------------------------------------------------------------

    def choice_of_cells(
        self, cell_x: np.ndarray, cell_y: np.ndarray, between: Callable[[], None] = lambda: None
    ) -> LightChoice | EveryLight | None:
        """The light choice of K cells of the picture, None for at most one light.

        cell_x, cell_y : (K,) numbered from the whole frame's corner. between : called now and then.
        """
        if len(self.lights) < 2:
            return None
        if self.samples_every:
            return EveryLight()
        if len(self.lights) <= WEIGHED:
            return self._weighed
        kinds = self.lights.links.kinds.shape[1]
        return CandidateLights(self.lights, self._clusters(cell_x, cell_y, between), kinds)

    def _clusters(
        self, cell_x: np.ndarray, cell_y: np.ndarray, between: Callable[[], None]
    ) -> list[Clusters]:
        """Clusters of lights for each of K cells, from the hits of jittered pilot rays there."""
        u = pilot_points(cell_x, cell_y)
        if self.screen_dimensions == 4:
            u = np.concatenate([u, np.full_like(u, 0.5)])  # the lens' middle
        origins, directions = self.stage.rays.rays(cell_x * CELL, cell_y * CELL, u)
        points, _ = self.surfaces.first_hit(origins, directions, self.stage.rays.reach)
        found = np.zeros(u.shape[1:], bool)
        position, normal = np.zeros((2, 3, *found.shape), np.float32)
        lanes = slice(None) if points.lane is None else points.lane
        found.reshape(-1)[lanes] = True
        position.reshape(3, -1)[:, lanes] = points.position
        normal.reshape(3, -1)[:, lanes] = points.normal
        highlights = self._highlights_of_pilots(points, directions, found.size)
        links = self.lights.links
        if links.all_lit:
            return clusters_of_cells(self.lights, position, normal, found, between, highlights=highlights)
        kind = np.zeros(found.shape, np.intp)
        kind.reshape(-1)[lanes] = links.kind(points.triangle)
        return clusters_of_cells(self.lights, position, normal, found, between, kind, links.kinds, highlights)

    def _highlights_of_pilots(
        self, points: SurfacePoints, directions: np.ndarray, count: int
    ) -> Highlights | None:
        """Of what ``count`` pilot rays along ``directions`` see first, at ``points`` (M,)."""
        if self.shader.lambertian or len(points) == 0:
            return None
        lane = np.arange(count) if points.lane is None else points.lane
        if len(directions) > 1:
            directions = directions.take(lane, axis=0)
        viewer = np.broadcast_to(-directions.T, (3, len(lane)))
        gatherer = LobeGatherer()
        for rows, terms in self.shader.terms(points, viewer):
            lobes = [lobe for lobe in terms.lobes if not isinstance(lobe, DiffuseTransmission)]
            gatherer.add(lane if rows is None else lane.take(rows), lobes, None)
        return Highlights.of(gatherer.slots(None, count), count)

    # -- the two stages ----------------------------------------------------------------------------

    def first(self, pixels: Pixels, u: np.ndarray, reflects: bool = True) -> CameraHits:
        """As `CameraStage.hit`."""
        hits = self.stage.hit(pixels, u, reflects)
        if len(self.lights) > WEIGHED:
            rows = np.repeat(pixels.cell, u.shape[2])
            hits.cell = rows if hits.points.lane is None else rows.take(hits.points.lane)
        if self.guide is not None and reflects:
            corner = np.stack([pixels.x, pixels.y])
            hits.tiles = self.guide.tiles(*(corner[:, :, None] + u[:2]).reshape(2, -1))
        return hits

    def depth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(B,) float32 along the view axis, in the middle of pixels x, y (B,); inf where nothing was hit."""
        rays = self.stage.rays
        middle = np.full((rays.dimensions, len(x), 1), 0.5, np.float32)
        distance = self.surfaces.distance(*rays.rays(x, y, middle), rays.reach)
        distance = distance.astype(np.float32, copy=False)
        found = (distance + np.float32(rays.clip_start)) * np.float32(1 / self.frame.scale)
        return np.where(distance < rays.reach, found, np.float32(np.inf))

    def rest(
        self,
        hits: CameraHits,
        lane: np.ndarray | None,
        u: np.ndarray,
        choice: LightChoice | EveryLight | None,
    ) -> Reflected:
        """Reflected radiance at u (3, M, S), S points for each of the M hits.

        u : two dimensions on the light, and the choice if there is one; (3, N) for hits ``lane`` (N,).
        """
        points = hits.points
        if (len(self.lights) == 0 and not self._glows) or u.size == 0 or len(points) == 0:
            return NOTHING
        split = u.shape[2] if lane is None else 1
        u = u.reshape(len(u), -1)
        if split > 1:
            lane = np.repeat(np.arange(len(points) if hits.first is None else len(hits.first) - 1), split)
        if hits.first is None:
            return self._reflected(hits, lane, u, choice, split)
        # A ray that sees several points has all of them lit by the same sample.
        lane = np.arange(u.shape[1]) if lane is None else lane
        start = hits.first.take(lane)
        seen = hits.first.take(lane + 1) - start
        which = np.repeat(np.arange(len(lane)), seen)
        at = np.arange(len(which)) - np.repeat(np.cumsum(seen) - seen, seen) + start.take(which)
        reflected = self._reflected(hits, at, take(u, which), choice, 1)
        reflected.which = which.take(reflected.which)
        return reflected

    def _reflected(self, hits, at, u, choice, split) -> Reflected:
        """Light reflected at points ``at`` (K,), None for all in order; ``split`` samples in a row each."""
        count, step = u.shape[1], max(1, _AT_ONCE // max(len(self.lights), 1))
        if isinstance(choice, EveryLight) and count > step:
            at = np.arange(count) if at is None else at
            parts = []
            for low in range(0, count, step):
                some = slice(low, low + step)
                part = self._reflected(hits, at[some], u[:, some], choice, 1)
                part.which = part.which + low
                parts.append(part)
            return Reflected.joined(parts)
        if self._glows:
            glow = self._reflect_glow(hits, np.arange(u.shape[1]) if at is None else at, u[:2])
            return Reflected.joined([*glow, *self._lights_reflected(hits, at, u, choice, split)])
        return Reflected.joined(self._lights_reflected(hits, at, u, choice, split))

    def _lights_reflected(self, hits, at, u, choice, split) -> list[Reflected]:
        if len(self.lights) == 0:
            return []
        highlights = self._highlights(hits, choice)
        guided = None if hits.tiles is None else GuidedPoints(self.guide, hits.tiles, hits.points.lane)
        samples = self.lights.sample(hits.points, hits.cell, at, u, choice, split, highlights, guided)
        if hits.slots is None:
            return [self._reflect_lambertian(hits, samples)]
        parts = [self._reflect(hits, samples)]
        if not self.lights.only_points:
            at = np.arange(u.shape[1]) if at is None else at
            parts += [
                self._sample_lobe(hits, slot, at, u[:2], choice) for slot in hits.slots if self._samples(slot)
            ]
        return parts

    @staticmethod
    def _highlights(hits: CameraHits, choice: LightChoice | EveryLight | None) -> Highlights | None:
        """Of hits, where a choice asks for them."""
        if choice is None or isinstance(choice, EveryLight):
            return None
        if hits.highlights is None and hits.slots is not None:
            hits.highlights = Highlights.of(hits.slots, len(hits.points))
        return hits.highlights

    def _samples(self, slot: Slot) -> bool:
        """Whether directions are sampled by the lobe, too."""
        return slot.sampled and self.sampling != "light"

    def _reflect_lambertian(self, hits: CameraHits, samples: LightSamples) -> Reflected:
        points = hits.points
        to_light = samples.to_light
        cosine = dot(take(points.normal, samples.at), to_light)
        cosine /= np.sqrt(np.maximum(dot(to_light, to_light), np.float32(1e-37)))
        weight = samples.weight * np.maximum(cosine, 0)
        lit, bad = _finite(weight)
        if lit.size < weight.size:
            samples, cosine, weight = samples.take(lit), cosine.take(lit), weight.take(lit)
        arrive, passed, counts = self._arriving(points, samples, cosine, SHADOW, bad)
        at, weight = samples.at.take(arrive), weight.take(arrive)
        strength = self.lights.strength(points, samples, arrive)
        if self._one_material:
            radiance = (self._reflectance * strength) * weight
        else:
            material = self.surfaces.triangles.material.take(points.triangle.take(at))
            radiance = take(self._reflectance, material) * strength
            radiance *= weight
        if passed is not None:
            radiance *= passed
        if hits.throughput is not None:
            radiance *= take(hits.throughput, at)
        return Reflected(samples.which.take(arrive), radiance, counts)

    def _reflect(self, hits: CameraHits, samples: LightSamples) -> Reflected:
        """Light samples reflected by lobes of all kinds, weighed against sampling these."""
        points = hits.points
        unit = samples.to_light * inverse_length(samples.to_light)
        value = np.zeros_like(unit)
        density = None
        for slot in hits.slots:
            lanes, row = slot.of(samples.at)
            part, pdf = slot.lobe.evaluate(row, unit if lanes is None else take(unit, lanes))
            if self._samples(slot):
                if density is None:
                    density = self.lights.density(points, samples)
                there = density if lanes is None else density.take(lanes)
                share = _power(there, pdf) if self.sampling == "mis" else np.isinf(there)
                # A mirror shows no light that has no size, as in Cycles.
                part *= np.where(np.isinf(there) & slot.lobe.is_mirror(row), np.float32(0), share)
            if lanes is None:
                value += part
            else:
                value[:, lanes] += part
        value *= samples.weight
        lit, bad = _finite(value.max(axis=0))
        if lit.size < value.shape[1]:
            samples, unit, value = samples.take(lit), take(unit, lit), take(value, lit)
        cosine = dot(take(points.normal, samples.at), unit)
        arrive, passed, counts = self._arriving(points, samples, cosine, SHADOW, bad)
        value = take(value, arrive)
        value *= self.lights.strength(points, samples, arrive)
        if passed is not None:
            value *= passed
        return Reflected(samples.which.take(arrive), value, counts)

    def _sample_lobe(self, hits: CameraHits, slot: Slot, at: np.ndarray, u: np.ndarray, choice) -> Reflected:
        """Lights that directions sampled by a lobe meet: at points ``at`` (K,) by u (2, K)."""
        points = hits.points
        lanes, row = slot.of(at)
        if lanes is not None:
            at, u = at.take(lanes), take(u, lanes)
        direction = slot.lobe.sample(row, u)
        samples, radiance, density = self.lights.along(points, at, direction)
        if len(samples.at) == 0:
            return NOTHING
        direction = take(direction, samples.which)
        value, pdf = slot.lobe.evaluate(row.take(samples.which), direction)
        if self.sampling == "mis":
            if choice is not None and not isinstance(choice, EveryLight):
                highlights = self._highlights(hits, choice)
                density = density * self.lights.chance(points, samples, choice, hits.cell, highlights)
            value *= _power(pdf, density)
        value *= radiance
        value /= np.maximum(pdf, np.float32(1e-37))
        lit, bad = _finite(value.max(axis=0))
        samples, value, direction = samples.take(lit), take(value, lit), take(direction, lit)
        cosine = dot(take(points.normal, samples.at), direction)
        arrive, passed, counts = self._arriving(points, samples, cosine, BSDF, bad)
        value = take(value, arrive)
        if passed is not None:
            value *= passed
        which = samples.which.take(arrive)
        return Reflected(which if lanes is None else lanes.take(which), value, counts)

    def _reflect_glow(self, hits: CameraHits, at: np.ndarray, u: np.ndarray) -> list[Reflected]:
        """Light of glowing fog at points ``at`` (K,), from directions by u (2, K)."""
        points, slots = hits.points, hits.slots
        if slots is None:
            weight = take(self._reflectance, self.surfaces.triangles.material.take(points.triangle))
            weight *= np.float32(np.pi)
            if hits.throughput is not None:
                weight *= hits.throughput
            slots = [Slot(Lambert(weight, points.normal, points.normal), None, False)]
        parts = []
        for slot in slots:
            lanes, row = slot.of(at)
            which = np.arange(len(at)) if lanes is None else lanes
            there = at.take(which)
            direction, value = self._glowing.sample(
                slot.lobe, row, take(points.position, there), take(u, which)
            )
            parts.append(self._glow_along(points, which, there, direction, value))
        return parts

    def _glow_along(
        self,
        points: SurfacePoints,
        which: np.ndarray,
        at: np.ndarray,
        direction: np.ndarray,
        value: np.ndarray,
    ) -> Reflected:
        """Samples ``which`` (K,) of what glows along ``direction`` (3, K), reflected by ``value`` (3, K)."""
        lit, bad = _finite(value.max(axis=0))
        which, at, direction, value = which.take(lit), at.take(lit), take(direction, lit), take(value, lit)
        cosine = dot(take(points.normal, at), direction)
        origins, directions, _ = self.surfaces.shadow_rays(points, at, direction, cosine, True)
        value *= self.shadows.glow(origins, directions)
        return Reflected(which, value, Counter({BSDF: len(at), NON_FINITE: bad}))

    def _arriving(
        self, points: SurfacePoints, samples: LightSamples, cosine: np.ndarray, kind: str, bad: int
    ) -> tuple[np.ndarray, np.ndarray | None, Counter[str]]:
        """Which samples (J,) arrive, what part (3, J) of them (None: all), and the counts of `Reflected`.

        cosine : (K,) of the directions to the shading normals. kind : what the rays count as.
        bad : samples that were not finite.
        """
        blockers = self.lights.links.casting(samples.light)
        if np.ndim(blockers) == 0 and blockers != NONE_CAST:
            arrive, passed, crossings = self.shadows.arriving(points, samples, cosine, blockers)
            return arrive, passed, Counter({kind: len(cosine), CROSSING: crossings, NON_FINITE: bad})
        blockers = np.broadcast_to(blockers, cosine.shape)
        lanes = np.flatnonzero(blockers != NONE_CAST)
        arrive, passed, crossings = self.shadows.arriving(
            points, samples.take(lanes), cosine.take(lanes), blockers.take(lanes)
        )
        counts = Counter({kind: len(lanes), CROSSING: crossings, NON_FINITE: bad})
        part = np.ones((3, len(cosine)), np.float32)
        part[:, lanes] = 0
        part[:, lanes.take(arrive)] = 1 if passed is None else passed
        arrive = np.flatnonzero(part.any(axis=0))
        return arrive, None if passed is None else take(part, arrive), counts


def _finite(value: np.ndarray) -> tuple[np.ndarray, int]:
    """Which of (K,) values are finite and not 0, and how many are not finite."""
    lit = np.flatnonzero(value)
    bad = lit.size
    if not np.isfinite(value.sum()):
        lit = lit[np.isfinite(value[lit])]
    return lit, bad - lit.size


def _power(own: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Power heuristic (beta 2) of a technique with density ``own`` beside one with ``other`` (eq. 5.5)."""
    ratio = other / np.maximum(own, np.float32(1e-30))
    return 1 / (1 + ratio * ratio)


class DirectLightOverTile:
    """The integrand with one tile's light choice, and what its evaluation cost.

    check : called before every batch; may raise, to give up.
    seen, reflects : whether radiance is that of what is seen by itself, and of what is reflected.
    elsewhere : pixels of which what is seen by itself is left out all the same.
    counts : so far, rays by kind and what was not finite.
    """

    staged = True

    def __init__(
        self,
        integrand: DirectLight,
        choice: LightChoice | EveryLight | None,
        check: Callable[[], None] = lambda: None,
        seen: bool = True,
        reflects: bool = True,
        elsewhere: SomePixels | None = None,
    ) -> None:
        self._integrand = integrand
        self._choice = choice
        self._seen, self._reflects, self._elsewhere = seen, reflects, elsewhere
        self._check = check
        self.rest_dimensions = 2 if isinstance(choice, EveryLight) else integrand.rest_dimensions
        self._counting = Lock()
        self.counts = Counter(dict.fromkeys((CAMERA, SHADOW, BSDF, CROSSING, NON_FINITE), 0))

    def first(self, pixels: Pixels, u: np.ndarray) -> CameraHits:
        self._check()
        hits = self._integrand.first(pixels, _inset(u), self._reflects)
        with self._counting:
            self.counts[CAMERA] += u[0].size
            self.counts[CROSSING] += hits.crossings
        if self._seen:
            _bound(hits.values[RGB])
            if self._elsewhere is not None:
                left_out = self._elsewhere.holds(pixels)
                hits.values[RGB].reshape(3, len(pixels), -1)[:, left_out] = 0
        else:
            hits.values[RGB] = 0
        return hits

    def rest(self, hits: CameraHits, lane: np.ndarray | None, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self._check()
        reflected = self._integrand.rest(hits, lane, _inset(u), self._choice)
        with self._counting:
            self.counts.update(reflected.counts)
        _bound(reflected.radiance)
        return reflected.which, reflected.radiance


def _bound(radiance: np.ndarray) -> None:
    """Cuts radiance (3, N) whose squares and sums would overflow in what makes a picture of it."""
    if not -LARGEST <= radiance.min(initial=0) <= radiance.max(initial=0) <= LARGEST:
        np.nan_to_num(radiance, copy=False)
        np.clip(radiance, -LARGEST, LARGEST, out=radiance)


def _inset(u: np.ndarray) -> np.ndarray:
    """Points as float32 inside the open cube: nodes of a quadrature rule lie on its faces.

    There are poles, rims of lights and edges of pixels, whose limits from inside are what is meant.
    """
    if u.dtype == np.float32:
        return u
    return np.clip(u, 2.0**-24, 1 - 2.0**-24).astype(np.float32)
