# SPDX-License-Identifier: GPL-3.0-or-later
"""The first stage of direct light: what camera rays see, one layer behind another, and its BSDF."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..bsdf.diffuse import DiffuseTransmission, Lambert
from ..geometry.frame import Frame
from ..geometry.surfaces import SurfacePoints, Surfaces
from ..geometry.vectors import take
from ..integration.sobol import hash_combine
from ..scene import Laser, Scene
from ..shading.terms import LARGEST
from .camera_rays import CameraRays
from .emitters import Emitters
from .highlights import Highlights
from .media import Media
from .surface_shading import LobeGatherer, Slot, SurfaceShader

RGB, ALPHA, NORMAL = slice(0, 3), 3, slice(4, 7)
"""Channels of the integrand."""


@dataclass(frozen=True)
class Pixels:
    """B pixels of one tile, the integrand's bins.

    x, y : (B,) int, places in the whole frame.
    cell : (B,) int, ascending, the tile's cells of `light_clusters`.
    """

    x: np.ndarray
    y: np.ndarray
    cell: np.ndarray

    def key(self) -> np.ndarray:
        """(B,) uint32, the same for a pixel in any tile and any border render."""
        return hash_combine(self.x, self.y)

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, part: slice | np.ndarray) -> Pixels:
        if isinstance(part, np.ndarray) and part.dtype != bool:
            return Pixels(self.x.take(part), self.y.take(part), self.cell.take(part))
        return Pixels(self.x[part], self.y[part], self.cell[part])


@dataclass(frozen=True, eq=False)
class SomePixels:
    """Some of the pixels of a region. which : (H, W) bool. corner : x0, y0 in the whole frame."""

    which: np.ndarray
    corner: tuple[int, int]

    def holds(self, pixels: Pixels) -> np.ndarray:
        """(B,) bool."""
        return self.which[pixels.y - self.corner[1], pixels.x - self.corner[0]]


@dataclass(eq=False)
class CameraHits:
    """The first stage's result for B x S camera rays.

    values : (C, B * S) what needs no further dimension: emission, background, alpha, normal.
    points : P surface points that light can fall on; ``points.lane`` says by which camera ray each is seen,
        ascending. A ray sees several where surfaces let it through, or scatter light to their far side.
    depth : (B * S,) along the view axis, scene units; inf where nothing was hit.
    cell : (P,) ascending rows of the tile's light choice; None where that knows no cells.
    slots : lobes of the BSDFs at the points; None if all are Lambertian.
    first : (M + 1,) where the points of each of M rays begin; None if each of the M has but one.
    crossings : rays that went on behind transparent surfaces.
    throughput : (3, P) what fog leaves of the light from the points; None for all. Slots have it already.
    highlights : of the points, once they are asked for; None as well if they are not glossy.
    tiles : of a `Guide`, about the rays; None where nothing is guided.
    """

    values: np.ndarray
    points: SurfacePoints
    depth: np.ndarray
    cell: np.ndarray | None
    slots: list[Slot] | None = None
    first: np.ndarray | None = None
    crossings: int = 0
    throughput: np.ndarray | None = None
    highlights: Highlights | None = None
    tiles: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def lane(self) -> np.ndarray | None:
        """(M,) ascending, the rays that hit; None if all did."""
        lane = self.points.lane
        return lane if self.first is None else lane.take(self.first[:-1])

    @property
    def normal(self) -> np.ndarray:
        """(3, M) shading normals where the rays hit first."""
        normal = self.points.normal
        return normal if self.first is None else take(normal, self.first[:-1])


class CameraStage:
    """Camera rays, and all that is known of a pixel without another dimension.

    dimensions : 2 of a pixel, and 2 of a lens.
    channels : of the values. transparent : whether alpha can be less than 1.
    sees : whether a camera ray may find radiance without a light sample.
    sees_elsewhere : whether it may outside of `images_of_lights`, too.
    """

    def __init__(
        self,
        scene: Scene,
        frame: Frame,
        surfaces: Surfaces,
        shader: SurfaceShader,
        emitters: Sequence[Emitters],
        transparent: bool,
        normals: bool,
        crossings: int,
        media: Media | None = None,
    ) -> None:
        """transparent : the background has no radiance and alpha 0. normals : integrate them too.

        crossings : how many transparent surfaces a ray may cross. media : the fogs between them.
        """
        self._media = media
        self.rays = CameraRays(scene.camera, frame)
        self.dimensions = self.rays.dimensions
        self._surfaces = surfaces
        self._shader = shader
        self._emitters = emitters
        self._unscale = 1 / frame.scale
        self._crossings = crossings
        self._clear_background = transparent
        self.transparent = transparent or surfaces.any_holdout or shader.any_holdout
        self.channels = 7 if normals else 4
        self._normals = normals
        self._lights_seen = any(group.any_visible for group in emitters)
        lasers = any(isinstance(light, Laser) for light in scene.lights)
        self._wants_lobes = len(emitters) > 0 or lasers or (media is not None and media.emits)
        self._background = np.zeros(3, np.float32)
        if scene.world.visible_to_camera and not transparent:
            self._background = np.maximum(scene.world.radiance, 0).astype(np.float32)
        materials = scene.materials
        emission = np.array([m.emission for m in materials]).reshape(-1, 3)
        self._emission = np.maximum(emission, 0).astype(np.float32).T.copy()
        used = np.unique(surfaces.triangles.material)
        self._emits = bool(self._emission[:, used].any())
        glows = self._emits or bool(shader.emits.any() or self._background.any())
        glows = glows or (media is not None and media.emits)
        self.sees = glows or self._lights_seen
        self.sees_elsewhere = glows or any(group.centre is None and group.any_visible for group in emitters)

    def hit(self, pixels: Pixels, u: np.ndarray, reflects: bool = True) -> CameraHits:
        """Camera rays through points (2, B, S) of pixels' unit squares; (4, B, S) with those of a lens.

        reflects : whether it is asked what surfaces reflect, which costs more than all else.
        """
        origins, directions = self.rays.rays(pixels.x, pixels.y, u)
        points, distance = self._surfaces.first_hit(origins, directions, self.rays.reach)
        values = np.zeros((self.channels, len(origins)), np.float32)
        lanes = slice(None) if points.lane is None else points.lane
        depth = np.full(len(origins), np.inf, np.float32)
        depth[lanes] = distance
        if self._normals:
            values[NORMAL, lanes] = points.normal
        if self._shader.lambertian:
            hits = self._lambertian(values, points, depth, origins, directions)
        else:
            wants_lobes = reflects and self._wants_lobes
            hits = self._shaded(values, points, depth, origins, directions, wants_lobes)
        hits.depth += np.float32(self.rays.clip_start)
        hits.depth *= np.float32(self._unscale)
        return hits

    def _lambertian(
        self,
        values: np.ndarray,
        points: SurfacePoints,
        depth: np.ndarray,
        origins: np.ndarray,
        directions: np.ndarray,
    ) -> CameraHits:
        """Hits where all surfaces are Lambertian, opaque, and emit the same everywhere."""
        lane = points.lane
        hit_all = lane is None
        lanes = slice(None) if hit_all else lane
        if not hit_all:
            if self._background.any():
                values[RGB] = self._background[:, None]
                values[RGB, lane] = 0
            if not self._clear_background:
                values[ALPHA] = 1
        values[ALPHA, lanes] = 1
        if self._emits:
            values[RGB, lanes] = take(self._emission, self._surfaces.triangles.material.take(points.triangle))
        held = self._held_out(points)
        if held is not None:
            where = np.flatnonzero(held) if hit_all else lane[held]
            values[:, where] = 0
            points = points.take(np.flatnonzero(~held))
        throughput = None
        if self._media is not None:
            passed, glow = self._media.seen(origins, directions, depth, clip=self.rays.reach)
            values[RGB] *= passed
            values[ALPHA] = 1 - (1 - values[ALPHA]) * passed.mean(axis=0)
            if glow is not None:
                values[RGB] += glow
            throughput = passed if points.lane is None else take(passed, points.lane)
        self._add_lights_seen(values[RGB], origins, directions, depth)
        return CameraHits(values, points, depth, None, throughput=throughput)

    def _held_out(self, points: SurfacePoints) -> np.ndarray | None:
        """(M,) bool, which of the points are on objects that are holdouts; None if none can be."""
        if not self._surfaces.any_holdout:
            return None
        holdout = np.broadcast_to(self._surfaces.triangles.holdout, len(self._surfaces.triangles))
        return holdout[points.triangle]

    def visible_lamps(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres (3, L) of lights at a finite distance that may be seen; radii (L,) of balls about these."""
        centre, reach = [np.zeros((3, 0))], [np.zeros(0)]
        for group in self._emitters:
            if group.centre is not None and (group.any_visible or group.is_mesh):
                which = slice(None) if group.is_mesh else group.visible
                centre.append(group.centre[:, which])
                reach.append(group.reach[which])
        return np.concatenate(centre, axis=1), np.concatenate(reach)

    def images_of_lights(self, window: tuple[int, int, int, int]) -> np.ndarray:
        """(W, H) bool, pixels in which a light at a finite distance may be seen: boxes about them.

        window : x0, y0, width, height in the whole frame.
        """
        x0, y0, *shape = window
        # At corners of boxes, so that sums over columns and rows count the boxes that a pixel is in.
        corners = np.zeros([n + 1 for n in shape], np.int64)
        for group in self._emitters:
            if group.centre is None or not (group.any_visible or group.is_mesh):
                continue
            which = slice(None) if group.is_mesh else group.visible
            offset = np.array(list(np.ndindex(2, 2, 2))).T[:, :, None] * 2.0 - 1
            corner = group.centre[:, None, which] + offset * group.reach[which]  # (3, 8, L)
            image, depth = self.rays.image_of(corner.reshape(3, -1))
            image, depth = image.reshape(2, *corner.shape[1:]), depth.reshape(corner.shape[1:])
            # All about the camera, or partly behind it, may be anywhere; what is all behind it is not seen.
            ahead, behind = depth.min(axis=0) > 0, depth.max(axis=0) < self.rays.clip_start
            low = np.where(ahead, image.min(axis=1) - (np.array([[x0], [y0]])), 0)
            high = np.where(ahead, image.max(axis=1) - (np.array([[x0], [y0]])), np.array([shape]).T)
            low, high = (
                np.clip(x, 0, np.array([shape]).T).astype(np.int64) for x in (np.floor(low), np.ceil(high))
            )
            high = np.where(behind, low, high)
            for x, y, sign in ((low, low, 1), (high, low, -1), (low, high, -1), (high, high, 1)):
                np.add.at(corners, (x[0], y[1]), sign)
        return corners.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0

    def _add_lights_seen(
        self, radiance: np.ndarray, origins: np.ndarray, directions: np.ndarray, depth: np.ndarray
    ) -> None:
        """Add the lights that camera rays see before ``depth`` (N,) to ``radiance`` (3, N)."""
        through = None
        if self._media is not None:

            def through(lane: np.ndarray, distance: np.ndarray | float) -> np.ndarray:
                along = origins.take(lane, axis=0), self._of(directions, lane)
                return self._media.seen(*along, distance, clip=self.rays.reach)[0]

        for group in self._emitters:
            if group.is_background and self._clear_background:
                continue
            # What is infinitely far is behind everything, but beyond no clipping plane.
            limit = depth if group.at_infinity else np.minimum(depth, np.float32(self.rays.reach))
            seen = group.seen(origins, directions, limit, through)
            if seen is not None:
                radiance += seen

    def _shaded(
        self,
        values: np.ndarray,
        points: SurfacePoints,
        depth: np.ndarray,
        origins: np.ndarray,
        directions: np.ndarray,
        wants_lobes: bool,
    ) -> CameraHits:
        """Hits of surfaces of all kinds: one layer behind another, as long as light passes straight on."""
        n = values.shape[1]
        radiance, alpha = values[RGB], values[ALPHA]
        gatherer, found, count = LobeGatherer(), [], 0
        ray, throughput, start = np.arange(n), None, np.zeros(n, np.float32)
        here, crossings = origins, 0
        fog = None
        if self._media is not None:
            fog = _FogBetween(self._media, origins, directions, self.rays.reach)
        for crossing in range(self._crossings + 1):
            last = crossing == self._crossings
            if crossing:
                crossings += len(ray)
                reach = np.float32(self.rays.reach) - start
                points, distance = self._surfaces.first_hit(here, self._of(directions, ray), reach)
            else:
                distance = depth.take(points.lane) if points.lane is not None else depth
            lane = np.arange(len(ray)) if points.lane is None else points.lane
            self._add_between(radiance, origins, directions, ray, throughput, start, lane, distance)
            missed = np.ones(len(ray), bool)
            missed[lane] = False
            arriving = throughput
            if fog is not None:
                end = np.full(len(ray), np.inf, np.float32)
                end[lane] = start.take(lane) + distance
                arriving = fog.cross(radiance, alpha, ray, end, throughput)
                fog.keep(lane)
            self._add_background(radiance, alpha, ray[missed], _at(arriving, missed))
            ray, start, throughput = ray.take(lane), start.take(lane) + distance, _at(throughput, lane)
            arriving = _at(arriving, lane)
            points.lane = ray
            found.append(points)
            if len(points) == 0:
                break
            viewer = np.broadcast_to(-self._of(directions, ray).T, (3, len(ray)))
            through = np.zeros((3, len(ray)), np.float32)
            opaque = np.ones(len(ray), np.float32)
            held = self._held_out(points)
            behind = []
            for rows, terms in self._shader.terms(points, viewer, wants_lobes):
                rows = np.arange(len(ray)) if rows is None else rows
                weight = _at(arriving, rows)
                if held is not None and held.any():
                    kept = (~held[rows]).astype(np.float32)
                    weight = kept * np.ones((3, 1), np.float32) if weight is None else weight * kept
                emission = np.maximum(terms.emission, 0)
                if emission.any():
                    radiance[:, ray.take(rows)] += emission if weight is None else emission * weight
                through[:, rows] = terms.transparency
                opaque[rows] = 1 - terms.holdout
                through_it = [lobe for lobe in terms.lobes if isinstance(lobe, DiffuseTransmission)]
                ahead = [lobe for lobe in terms.lobes if not isinstance(lobe, DiffuseTransmission)]
                gatherer.add(rows + count, ahead, weight)
                if through_it:
                    behind.append((rows, [_from_behind(lobe) for lobe in through_it], weight))
            count += len(points)
            for rows, lobes, weight in behind:
                found.append(points.take(rows).turned())
                gatherer.add(np.arange(count, count + len(rows)), lobes, weight)
                count += len(rows)
            if held is not None:
                opaque[held] = 0
                through[:, held] = 0
            np.clip(through, 0, None, out=through)
            shown = opaque - (0 if last else through)
            alpha[ray] += (shown if arriving is None else arriving * shown).mean(axis=0)
            on = np.flatnonzero(through.any(axis=0))
            if on.size == 0 or last:
                break
            throughput = take(through, on) if throughput is None else take(throughput * through, on)
            np.minimum(throughput, LARGEST, out=throughput)
            here = self._surfaces.beyond(points.take(on))
            ray, start = ray.take(on), start.take(on)
            if fog is not None:
                fog.keep(on)
        np.clip(alpha, 0, 1, out=alpha)  # surfaces may let more light through than there is
        hits = self._gathered(values, depth, gatherer, found, count)
        hits.crossings = crossings
        return hits

    def _gathered(
        self,
        values: np.ndarray,
        depth: np.ndarray,
        gatherer: LobeGatherer,
        found: Sequence[SurfacePoints],
        count: int,
    ) -> CameraHits:
        """The points that reflect at all, in the order of their rays."""
        reflects = gatherer.reflecting(count)
        if not reflects.any():
            none = np.zeros(0, np.intp)
            return CameraHits(values, found[0].take(none), depth, None, [])
        points = SurfacePoints.concatenate(found)
        order = np.flatnonzero(reflects)
        if len(found) > 1:
            order = order.take(np.argsort(points.lane.take(order), kind="stable"))
        renumbered = None
        if len(found) > 1 or len(order) < count:
            renumbered = np.full(count, -1, np.int32)
            renumbered[order] = np.arange(len(order), dtype=np.int32)
            points = points.take(order)
        slots = gatherer.slots(renumbered, len(points))
        first = np.flatnonzero(np.diff(points.lane, prepend=-1))
        if len(first) < len(points):
            return CameraHits(values, points, depth, None, slots, np.append(first, len(points)))
        if len(points) == values.shape[1]:
            points.lane = None
        return CameraHits(values, points, depth, None, slots)

    def _add_between(
        self,
        radiance: np.ndarray,
        origins: np.ndarray,
        directions: np.ndarray,
        ray: np.ndarray,
        throughput: np.ndarray | None,
        start: np.ndarray,
        lane: np.ndarray,
        distance: np.ndarray,
    ) -> None:
        """Add the lights that rays see between ``start`` and the next surface to ``radiance`` (3, N).

        ray : (K,) which of the N camera rays go on. lane : (M,) which of these hit, at ``distance`` (M,).
        """
        if not self._lights_seen:
            return
        end = np.full(len(ray), np.inf, np.float32)
        end[lane] = start.take(lane) + distance
        origins, directions = origins.take(ray, axis=0), self._of(directions, ray)
        seen = np.zeros((3, len(ray)), np.float32)
        self._add_lights_seen(seen, origins, directions, end)
        if throughput is not None:
            before = np.zeros_like(seen)
            self._add_lights_seen(before, origins, directions, start)
            seen -= before
            seen *= throughput
        radiance[:, ray] += seen

    def _add_background(
        self, radiance: np.ndarray, alpha: np.ndarray, ray: np.ndarray, throughput: np.ndarray | None
    ) -> None:
        """Add what rays (K,) of the N see that meet nothing any more."""
        if self._background.any():
            background = self._background[:, None]
            radiance[:, ray] += background if throughput is None else background * throughput
        if not self._clear_background:
            alpha[ray] += 1 if throughput is None else throughput.mean(axis=0)

    @staticmethod
    def _of(directions: np.ndarray, ray: np.ndarray) -> np.ndarray:
        return directions if len(directions) == 1 else directions.take(ray, axis=0)


class _FogBetween:
    """Fog between the layers that camera rays see: of a ray's light at each, and of the ray as a whole."""

    def __init__(self, media: Media, origins: np.ndarray, directions: np.ndarray, clip: float) -> None:
        """clip : as in `Media.optical_depth`."""
        self._media, self._origins, self._directions, self._clip = media, origins, directions, clip
        self._passed = np.ones((3, len(origins)), np.float32)
        self._glow = np.zeros((3, len(origins)), np.float32)

    def cross(
        self,
        radiance: np.ndarray,
        alpha: np.ndarray,
        ray: np.ndarray,
        end: np.ndarray,
        throughput: np.ndarray | None,
    ) -> np.ndarray:
        """Takes rays (K,) on to ``end`` (K,): adds what glows on the way, and alpha of what is absorbed.

        throughput : (3, K) of the layers alone, None for 1. Returns it with that of all fog before the end.
        """
        directions = CameraStage._of(self._directions, ray)
        origins = self._origins.take(ray, axis=0)
        passed, glow = self._media.seen(origins, directions, end, clip=self._clip)
        absorbed = self._passed - passed
        alpha[ray] += (absorbed if throughput is None else absorbed * throughput).mean(axis=0)
        if glow is not None:
            more = glow - self._glow
            radiance[:, ray] += more if throughput is None else more * throughput
            self._glow = glow
        self._passed = passed
        return passed if throughput is None else passed * throughput

    def keep(self, rows: np.ndarray) -> None:
        """Goes on with these of the rays."""
        self._passed, self._glow = take(self._passed, rows), take(self._glow, rows)


def _from_behind(lobe: DiffuseTransmission) -> Lambert:
    """What scatters light to the far side, as a reflector on that side."""
    surface = None if lobe.surface is None else -lobe.surface
    return Lambert(lobe.weight, -lobe.normal, lobe.towards_viewer, surface=surface)


def _at(throughput: np.ndarray | None, rows: np.ndarray) -> np.ndarray | None:
    """Columns of a throughput (3, K), which is None for 1; rows may be a mask."""
    return None if throughput is None else throughput[:, rows]
