# SPDX-License-Identifier: GPL-3.0-or-later
"""Direct illumination as a staged function of primary space.

    first : (screen 2)            -> camera hits, and what is seen without another dimension
    rest  : (light 2, light choice 1) -> radiance reflected at those hits (one light needs no choice)

    L_o = integral over the lights of f L_e V cos cos' / d^2 dA      (thesis eq. 5.1)

Every light's map is in `emitters`; the choice among lights is one more dimension.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np

from ..geometry.frame import frame_of
from ..geometry.surfaces import SurfacePoints, Surfaces
from ..geometry.triangles import gather_triangles
from ..geometry.vectors import dot, take
from ..integration.sobol import hash_combine, unit_float
from ..scene import Scene
from .camera_rays import CameraRays
from .emitters import emitter_groups
from .light_choice import (
    CELL,
    PILOT_GRID,
    WEIGHED,
    CandidateLights,
    EveryLight,
    LightChoice,
    Lights,
    WeighedLights,
    mean_irradiance,
)

RGB, ALPHA, NORMAL = slice(0, 3), 3, slice(4, 7)
"""Channels of the integrand."""


@dataclass(frozen=True)
class Pixels:
    """B pixels of one tile, the integrand's bins.

    x, y : (B,) int, places in the whole frame.
    cell : (B,) int, ascending, the tile's cells of `light_choice`.
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
        return Pixels(self.x[part], self.y[part], self.cell[part])


@dataclass(eq=False)
class CameraHits:
    """The first stage's result for B x S camera rays.

    values : (C, B * S) what needs no further dimension: emission, background, alpha, normal.
    points : the M rays that hit a surface which light can fall on; ``points.lane`` says which.
    depth : (B * S,) along the view axis, scene units; inf where nothing was hit.
    cell : (M,) ascending rows of the tile's light choice; None where that knows no cells.
    """

    values: np.ndarray
    points: SurfacePoints
    depth: np.ndarray
    cell: np.ndarray | None

    @property
    def lane(self) -> np.ndarray | None:
        """(M,) ascending, the rays that hit; None if all did."""
        return self.points.lane


@dataclass(eq=False)
class Reflected:
    """Light samples that arrive: which (K,) of the N, more than once for several lights; radiance (3, K).

    shadow_rays : how many rays that took. non_finite : samples that were not finite, and count as 0.
    """

    which: np.ndarray
    radiance: np.ndarray
    shadow_rays: int
    non_finite: int


class DirectLight:
    """The integrand of a scene: rays, surfaces, emitters. Shared by all threads.

    messages : what of the scene is left out, one sentence each.
    rest_dimensions : 2 on a light, and 1 for the choice of a light or of a triangle of it.
    """

    screen_dimensions = 2

    def __init__(self, scene: Scene, transparent: bool = False, normals: bool = False) -> None:
        """transparent : the background has no radiance and alpha 0. normals : integrate them too."""
        frame = frame_of(scene)
        triangles, self.messages = gather_triangles(scene.meshes, frame)
        self._unscale = 1 / frame.scale
        self._rays = CameraRays(scene.camera, frame)
        self._surfaces = Surfaces(triangles)
        self.emitters, messages = emitter_groups(scene.lights, scene.world, scene.materials, triangles, frame)
        self.lights = Lights(self.emitters)
        self._weighed = WeighedLights(self.lights)
        self.messages += messages
        self.any_mesh = any(group.is_mesh for group in self.emitters)
        self.rest_dimensions = 3 if len(self.lights) > 1 or self.any_mesh else 2
        self.only_points = all(group.is_point for group in self.emitters)
        self.transparent = transparent or self._surfaces.any_holdout
        self.channels = 7 if normals else 4
        self._normals = normals
        self._transparent = transparent
        self._background = np.zeros(3, np.float32)
        if scene.world.visible_to_camera and not transparent:
            self._background = np.maximum(scene.world.radiance, 0).astype(np.float32)
        self._reflectance = np.array(
            [m.reflectance for m in scene.materials], np.float32
        ).T.copy() / np.float32(np.pi)
        self._emission = np.maximum([m.emission for m in scene.materials], 0).astype(np.float32).T.copy()
        self._emits = (
            bool(self._emission[:, np.unique(triangles.material)].any()) if len(triangles) else False
        )
        self._one_material = len(scene.materials) == 1
        self._light_number = np.min_scalar_type(len(self.lights))
        none = np.zeros((3, 0), np.float32)
        self._strength = np.concatenate([none] + [group.strength for group in self.emitters], axis=1)
        self._casts_shadow = np.concatenate(
            [np.zeros(0, bool)] + [group.casts_shadow for group in self.emitters]
        )

    # -- choosing among lights ---------------------------------------------------------------------

    def choice_of_cells(
        self, cell_x: np.ndarray, cell_y: np.ndarray, between: Callable[[], None] = lambda: None
    ) -> LightChoice | None:
        """The light choice of K cells of the picture, None for at most one light.

        cell_x, cell_y : (K,) numbered from the whole frame's corner. between : called now and then.
        """
        if len(self.lights) < 2:
            return None
        if len(self.lights) <= WEIGHED:
            return self._weighed
        return CandidateLights(self.lights, self._pilot_irradiance(cell_x, cell_y, between))

    def _pilot_irradiance(
        self, cell_x: np.ndarray, cell_y: np.ndarray, between: Callable[[], None]
    ) -> np.ndarray:
        """(K, L) irradiance at the hits of jittered pilot rays in each cell."""
        row, column = np.divmod(np.arange(PILOT_GRID**2), PILOT_GRID)
        step = np.float32(CELL / PILOT_GRID)
        pilot = np.arange(PILOT_GRID**2)
        across, up = (hash_combine(cell_x[:, None], cell_y[:, None], pilot, axis) for axis in (71, 72))
        u = np.stack([(column + unit_float(across)) * step, (row + unit_float(up)) * step])
        origins, directions = self._rays.rays(cell_x * CELL, cell_y * CELL, u)
        points, _ = self._surfaces.first_hit(origins, directions, self._rays.reach)
        found = np.zeros(across.shape, bool)
        position, normal = np.zeros((2, 3, *across.shape), np.float32)
        lanes = slice(None) if points.lane is None else points.lane
        found.reshape(-1)[lanes] = True
        position.reshape(3, -1)[:, lanes] = points.position
        normal.reshape(3, -1)[:, lanes] = points.normal
        return mean_irradiance(self.lights, position, normal, found, between)

    # -- the two stages ----------------------------------------------------------------------------

    def first(self, pixels: Pixels, u: np.ndarray) -> CameraHits:
        """Camera rays through (2, B, S) points of the pixels' unit squares."""
        origins, directions = self._rays.rays(pixels.x, pixels.y, u)
        n = len(origins)
        points, distance = self._surfaces.first_hit(origins, directions, self._rays.reach)
        lane = points.lane
        values = np.zeros((self.channels, n), np.float32)
        hit_all = lane is None
        lanes = slice(None) if hit_all else lane
        depth = np.full(n, np.inf, np.float32)
        depth[lanes] = distance
        if not hit_all:
            if self._background.any():
                values[RGB] = self._background[:, None]
                values[RGB, lane] = 0
            if not self._transparent:
                values[ALPHA] = 1
        values[ALPHA, lanes] = 1
        if self._emits:
            values[RGB, lanes] = take(self._emission, self._surfaces.triangles.material.take(points.triangle))
        if self._normals:
            values[NORMAL, lanes] = points.normal
        held = None
        if self._surfaces.any_holdout:
            holdout = np.broadcast_to(self._surfaces.triangles.holdout, len(self._surfaces.triangles))
            held = holdout[points.triangle]
            where = np.flatnonzero(held) if hit_all else lane[held]
            values[:, where] = 0
        for group in self.emitters:
            # What is infinitely far is behind everything, but beyond no clipping plane.
            limit = depth if group.at_infinity else np.minimum(depth, np.float32(self._rays.reach))
            seen = group.seen(origins, directions, limit)
            if seen is not None:
                values[RGB] += seen
        depth = (depth + np.float32(self._rays.clip_start)) * np.float32(self._unscale)
        if held is not None and held.any():
            points = _without(points, held)
        cell = None
        if len(self.lights) > WEIGHED:
            rows = np.repeat(pixels.cell, u.shape[2])
            cell = rows if points.lane is None else rows.take(points.lane)
        return CameraHits(values, points, depth, cell)

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
        if len(self.lights) == 0 or u.size == 0 or len(points) == 0:
            return Reflected(np.zeros(0, np.intp), np.zeros((3, 0), np.float32), 0, 0)
        split = u.shape[2] if lane is None else 1
        at = lane if split == 1 else np.repeat(np.arange(len(points)), split)
        order = None
        if len(self.lights) == 1:
            light = None
            position, normal = (a if at is None else take(a, at) for a in (points.position, points.normal))
            u = u.reshape(len(u), -1)
            # Only a mesh has a use for the third, its choice of a triangle.
            to_light, weight = self.emitters[0].sample(None, position, normal, u[-1], u[:2])
            at_infinity, is_mesh = self.emitters[0].at_infinity, self.emitters[0].is_mesh
        else:
            if lane is None:
                position, normal, cell = points.position, points.normal, hits.cell
            else:
                position, normal = take(points.position, lane), take(points.normal, lane)
                cell = None if hits.cell is None else hits.cell.take(lane)
            # Side by side, samples of one light run through the same code and towards the same place.
            if isinstance(choice, EveryLight):
                count, pdf = u[0].size, None
                order = np.tile(np.arange(count), len(self.lights))
                light = np.repeat(np.arange(len(self.lights)), count)
                w = u[-1].reshape(-1).take(order)
            else:
                light, pdf, w = choice.choose(position, normal, cell, u[2].reshape(-1, split))
                order = np.argsort(light.astype(self._light_number), kind="stable")
                light, pdf, w = light.take(order), pdf.take(order), w.take(order)
            at = order if at is None else at.take(order)
            position, normal = take(points.position, at), take(points.normal, at)
            to_light, weight, at_infinity, is_mesh = self._sample_sorted(
                light, position, normal, w, take(u[:2].reshape(2, -1), order)
            )
            if pdf is not None:
                weight /= pdf
        cosine = dot(normal, to_light)
        cosine /= np.sqrt(np.maximum(dot(to_light, to_light), np.float32(1e-37)))
        weight = weight * np.maximum(cosine, 0)
        lit = np.flatnonzero(weight)
        bad = lit.size
        if not np.isfinite(weight.sum()):
            lit = lit[np.isfinite(weight[lit])]
        bad -= lit.size
        if lit.size < weight.size:
            to_light, cosine, weight = take(to_light, lit), cosine.take(lit), weight.take(lit)
            at_infinity, is_mesh = (a if np.ndim(a) == 0 else a.take(lit) for a in (at_infinity, is_mesh))
            at = lit if at is None else at.take(lit)
            light = None if light is None else light.take(lit)
        elif at is None:
            at = lit
        visible = np.flatnonzero(self._visible(points, at, to_light, cosine, at_infinity, is_mesh, light))
        shadow_rays = at.size
        which = lit.take(visible)
        if order is not None:
            which = order.take(which)
        at, weight = at.take(visible), weight.take(visible)
        colour = self._strength if light is None else take(self._strength, light.take(visible))
        if self._one_material:
            radiance = (self._reflectance * colour) * weight
        else:
            material = self._surfaces.triangles.material.take(points.triangle.take(at))
            radiance = take(self._reflectance, material) * colour
            radiance *= weight
        return Reflected(which, radiance, shadow_rays, bad)

    def _sample_sorted(self, light, position, normal, w, u):
        """Samples of lights in ascending order, kind after kind."""
        n = len(light)
        to_light, weight = np.empty((3, n), np.float32), np.empty(n, np.float32)
        at_infinity, is_mesh = np.zeros((2, n), bool)
        cuts = np.searchsorted(light, self.lights.first)
        for group, start, low, high in zip(
            self.emitters, self.lights.first[:-1], cuts[:-1], cuts[1:], strict=True
        ):
            if low == high:
                continue
            part = slice(low, high)
            which = light[part] - start if len(group) > 1 else None
            to_light[:, part], weight[part] = group.sample(
                which, position[:, part], normal[:, part], w[part], u[:, part]
            )
            at_infinity[part] = group.at_infinity
            is_mesh[part] = group.is_mesh
        if len({group.at_infinity for group in self.emitters}) == 1:
            at_infinity = self.emitters[0].at_infinity
        if len({group.is_mesh for group in self.emitters}) == 1:
            is_mesh = self.emitters[0].is_mesh
        return to_light, weight, at_infinity, is_mesh

    def _visible(self, points, at, to_light, cosine, at_infinity, is_mesh, light):
        if self._casts_shadow.all():
            return self._surfaces.visible(points, at, to_light, cosine, at_infinity, is_mesh)
        casts = np.repeat(self._casts_shadow, len(at)) if light is None else self._casts_shadow.take(light)
        visible = ~casts
        lanes = np.flatnonzero(casts)
        if lanes.size:
            at_infinity, is_mesh = (a if np.ndim(a) == 0 else a.take(lanes) for a in (at_infinity, is_mesh))
            visible[lanes] = self._surfaces.visible(
                points, at.take(lanes), take(to_light, lanes), cosine.take(lanes), at_infinity, is_mesh
            )
        return visible


class DirectLightOverTile:
    """The integrand with one tile's light choice, and what its evaluation cost.

    check : called before every batch; may raise, to give up.
    camera_rays, shadow_rays, non_finite : counts so far.
    """

    staged = True

    def __init__(
        self,
        integrand: DirectLight,
        choice: LightChoice | EveryLight | None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self._integrand = integrand
        self._choice = choice
        self._check = check
        self.rest_dimensions = 2 if isinstance(choice, EveryLight) else integrand.rest_dimensions
        self._counting = Lock()
        self.camera_rays = self.shadow_rays = self.non_finite = 0

    def first(self, pixels: Pixels, u: np.ndarray) -> CameraHits:
        self._check()
        with self._counting:
            self.camera_rays += u[0].size
        return self._integrand.first(pixels, _inset(u))

    def rest(self, hits: CameraHits, lane: np.ndarray | None, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        reflected = self._integrand.rest(hits, lane, _inset(u), self._choice)
        with self._counting:
            self.shadow_rays += reflected.shadow_rays
            self.non_finite += reflected.non_finite
        return reflected.which, reflected.radiance


def _inset(u: np.ndarray) -> np.ndarray:
    """Points as float32 inside the open cube: nodes of a quadrature rule lie on its faces.

    There are poles, rims of lights and edges of pixels, whose limits from inside are what is meant.
    """
    if u.dtype == np.float32:
        return u
    return np.clip(u, 2.0**-24, 1 - 2.0**-24).astype(np.float32)


def _without(points: SurfacePoints, held: np.ndarray) -> SurfacePoints:
    """``points`` less those for which ``held`` (M,) is true."""
    keep = np.flatnonzero(~held)
    return SurfacePoints(
        keep if points.lane is None else points.lane[keep],
        points.triangle[keep],
        take(points.position, keep),
        take(points.geometric, keep),
        take(points.normal, keep),
        points.u[keep],
        points.v[keep],
        None if points.smooth is None else points.smooth[keep],
        None if points.flipped is None else points.flipped[keep],
    )
