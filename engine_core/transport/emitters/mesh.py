# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that emit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...geometry.triangles import OFFSET_ULPS
from ...geometry.vectors import dot, take
from ...scene import Linking
from .base import Emitters, area_to_solid_angle, vectors_to
from .mesh_pieces import Pieces
from .patches import BACK, Facing, Patches, facing_of
from .spherical import SphericalTriangle

# Triangles are near within this times their longest edge, and fill the half space to points of surfaces that
# are nearer to their plane than this times what they extend over.
_NEAR, _FILLS = 0.3, np.float32(0.02)


class MeshEmitters(Emitters):
    """Meshes with an emissive material, from both sides: by area, measure |cos| / d^2.

    A piece that is large for the shaded point is sampled by its solid angle; that over its area is the
    measure. A light is a cluster of neighbouring pieces of one material; ``w`` chooses among them, those
    first that show more of themselves to the point (see `Patches`), then by area.

    chooses : whether a light has several pieces, so that ``w`` matters.
    row : (E,) int32, the scene's triangle that each piece is, or is a part of.
    light_of : (E,) int, the light that it is of. corners : (E, 3, 3) float32.
    """

    is_mesh = True

    def __init__(
        self,
        radiance: Sequence[np.ndarray],
        pieces: Pieces,
        linking: Sequence[Linking] | None = None,
        offset: np.ndarray | None = None,
    ) -> None:
        """radiance : (3,) of each light. linking : of each, None for lights that are linked to all.
        offset : (T,) of the scene's triangles, as of `Triangles`; None for next to nothing.
        """
        corner, a, b = np.moveaxis(pieces.corners, 1, 0).copy()
        a -= corner
        b -= corner
        normal = np.cross(a, b)
        double_area = np.linalg.norm(normal, axis=1)
        self._corner, self._a, self._b = (np.ascontiguousarray(x.T, np.float32) for x in (corner, a, b))
        with np.errstate(invalid="ignore", divide="ignore"):
            normal = np.nan_to_num(normal.T / double_area)
        self._normal = normal.astype(np.float32)
        self._offset = np.zeros(len(pieces.row), np.float32) if offset is None else offset.take(pieces.row)
        self.row, self.corners, self._weights = pieces.row, pieces.corners.astype(np.float32), pieces.weights
        first, count = pieces.first, np.diff(pieces.first)
        self.chooses = bool(count.max() > 1)
        self.light_of = np.repeat(np.arange(len(count)), count)
        area_of = 0.5 * double_area
        area = np.bincount(self.light_of, area_of, minlength=len(count))
        linking = [Linking()] * len(count) if linking is None else linking
        super().__init__(np.asarray(radiance) * area[:, None], area, linking)
        self._area, self._area_of = area.astype(np.float32), area_of.astype(np.float32)
        # How far off a triangle counts as near, from its first corner (surely) and from its middle.
        third = (a + b) / 3
        longest = np.max([np.linalg.norm(edge, axis=1) for edge in (a, b, b - a)], axis=0)
        reach = np.max([np.linalg.norm(point - third, axis=1) for point in (0 * a, a, b)], axis=0)
        self._reach_of = reach.astype(np.float32)
        self._near_middle = ((reach + _NEAR * longest) ** 2).astype(np.float32)
        to_middle = np.linalg.norm(third, axis=1)
        self._near_corner = ((reach + _NEAR * longest + to_middle) ** 2).astype(np.float32)
        closed = pieces.side != 0
        of_pieces = (
            (corner + third).T, normal * np.where(closed, pieces.side, 1), area_of, reach,
            np.where(closed, BACK, 1.0),
        )  # fmt: skip
        self._patches = Patches(*of_pieces, first, pieces.code)
        lights, _ = facing_of(*of_pieces, self.light_of, len(count))
        self._facing = Facing(*lights)
        self._centre, self._reach = lights[0].astype(np.float32), lights[1].astype(np.float32)
        self.centre, self.reach = self._centre.astype(np.float64), lights[1]

    def facing(self, which: np.ndarray, vector: np.ndarray, along: np.ndarray | None = None) -> np.ndarray:
        """(...) what part of their area lights ``which`` show to points, ``vector`` (3, ...) from them, or to
        lines of directions ``along``, of which these are the nearest points."""
        shown, _ = self._facing.shown(which, vector, along)
        return shown

    def sample(self, which, position, normal, w, u):
        piece, gain = self._chosen(which, position, w)
        corner = vectors_to(self._corner, piece, position)
        root = np.sqrt(u[0])
        b1, b2 = 1 - root, root * u[1]
        to_light = corner + b1 * take(self._a, piece)
        to_light += b2 * take(self._b, piece)
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        measure = np.abs(dot(take(self._normal, piece), to_light))
        measure /= square * np.sqrt(square)
        near, seen = self._near(piece, corner, normal is None)
        if near.size:
            for out, values in zip(to_light, seen.sample(take(u, near)), strict=True):
                out[near] = np.where(seen.usable, values, out[near])
            by_angle = seen.solid_angle / self._area_of.take(piece.take(near))
            measure[near] = np.where(seen.usable, by_angle, measure[near])
        if gain is not None:
            measure *= gain
        measure *= self.lift(piece, to_light)
        return to_light, measure

    def lift(self, piece: np.ndarray, to_light: np.ndarray) -> np.ndarray:
        """Let vectors (3, M) to places on pieces (M,) end off these, so that these do not shadow themselves.
        Shortened by a part of the way, from afar they would end before a thin body's front, too.

        Returns (M,) bool, whether they are not from a piece's own plane, where rounding has them see it.
        """
        normal = take(self._normal, piece)
        height, gap = dot(normal, to_light), self._gap(piece, dot(to_light, to_light))
        normal *= np.copysign(gap, height)
        to_light -= normal
        return np.abs(height) > gap

    def _gap(self, piece: np.ndarray, square: np.ndarray) -> np.ndarray:
        """(M,) how far off pieces (M,) vectors to them end, which are the root of ``square`` long."""
        return np.maximum(np.sqrt(square) * np.float32(OFFSET_ULPS * 2.0**-24), self._offset.take(piece))

    def _near(
        self, piece: np.ndarray, corner: np.ndarray, precise: bool
    ) -> tuple[np.ndarray, SphericalTriangle | None]:
        """Lanes of ``piece`` (M,) that are near enough for their solid angle, and these as seen.

        corner : (3, M) vectors to the first corners. precise : for points in space, some of which come so
        near that a triangle fills the half space: in single precision a part of it would be lost.
        """
        near = np.flatnonzero(dot(corner, corner) < self._near_corner.take(piece))
        if near.size == 0:
            return near, None
        some, corner = piece.take(near), take(corner, near)
        b, c = corner + take(self._a, some), corner + take(self._b, some)
        middle = (corner + b + c) * np.float32(1 / 3)
        nearer = np.flatnonzero(dot(middle, middle) < self._near_middle.take(some))
        if nearer.size == 0:
            return nearer, None
        if nearer.size < near.size:
            near, corner, b, c = near.take(nearer), take(corner, nearer), take(b, nearer), take(c, nearer)
        height = np.abs(dot(take(self._normal, piece.take(near)), corner))
        fills = precise or (height < _FILLS * self._reach_of.take(piece.take(near))).any()
        kind = np.float64 if fills else np.float32
        return near, SphericalTriangle(*(x.astype(kind, copy=False) for x in (corner, b, c)))

    def _chosen(
        self, which: np.ndarray | None, position: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """(M,) pieces, and by how much their shares of a light's area exceed their chances; None for 1."""
        light = np.zeros(len(w), np.intp) if which is None else which
        if not self.chooses:
            return light, None
        return self._patches.choose(light, position, w)

    def piece(self, which: np.ndarray | None, position: np.ndarray, w: np.ndarray) -> np.ndarray:
        """(M,) pieces that `sample` takes, by what it is given."""
        return self._chosen(which, position, w)[0]

    def place_of(
        self, piece: np.ndarray, position: np.ndarray, to_light: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where samples of pieces (M,) lie, as `on_scene`. to_light : (3, M), what `sample` gave."""
        a, b = take(self._a, piece), take(self._b, piece)
        gap = position + to_light - take(self._corner, piece)
        aa, ab, bb = dot(a, a), dot(a, b), dot(b, b)
        scale = 1 / np.maximum(aa * bb - ab * ab, np.float32(1e-37))
        ga, gb = dot(gap, a), dot(gap, b)
        b1 = np.clip((bb * ga - ab * gb) * scale, 0, 1)
        b2 = np.clip((aa * gb - ab * ga) * scale, 0, 1 - b1)
        return self.on_scene(piece, b1, b2)

    def on_scene(
        self, piece: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows (M,) of the scene's triangles, and weights (M,) of their corners 1 and 2, of places on pieces
        that have weights u, v (M,)."""
        corner, one, other = np.moveaxis(self._weights.take(piece, axis=0), 1, 0)
        b1, b2 = (corner + u[:, None] * (one - corner) + v[:, None] * (other - corner)).T
        return self.row.take(piece), b1, b2

    def pdf_of_piece(
        self, piece: np.ndarray, position: np.ndarray, normal: np.ndarray | None, to_light: np.ndarray
    ) -> np.ndarray:
        """(M,) density per solid angle, given its light, of points on pieces (M,).

        to_light : (3, M), lifted.
        """
        light = self.light_of.take(piece)
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        cosine_d = np.abs(dot(take(self._normal, piece), to_light)) + self._gap(piece, square)
        density = area_to_solid_angle(square, cosine_d, self._area.take(light))
        near, seen = self._near(piece, vectors_to(self._corner, piece, position), normal is None)
        if near.size:
            share = self._area_of.take(piece.take(near)) / self._area.take(light.take(near))
            by_angle = share / np.maximum(seen.solid_angle, np.float32(1e-30))
            density[near] = np.where(seen.usable, by_angle, density[near])
        if self.chooses:
            density /= self._patches.gain(piece, position)
        return density

    def irradiance(self, position, normal, which=None):
        which = np.arange(len(self)) if which is None else which
        to_light = self._column(self._centre, which) - position[:, None, :]
        reach = self._column(self._reach, which)
        shown, square = self._facing.shown(which[:, None], -to_light)
        inverse = 1 / np.sqrt(square)
        size = np.minimum(reach * inverse, 1)
        estimate = np.clip((dot(to_light, normal[:, None, :]) * inverse + size) / (1 + size), 0, 1)
        estimate *= self._column(self._brightness, which)
        estimate *= shown
        estimate /= square
        return estimate
