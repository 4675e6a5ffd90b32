# SPDX-License-Identifier: GPL-3.0-or-later
"""Area lights: rectangles and ellipses that emit from one side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...geometry.frame import Frame
from ...geometry.vectors import dot, length, take
from ...geometry.warps import concentric_disk
from ...scene import AreaLight
from .base import FEW, Emitters, Sample, area_to_solid_angle, of, vectors_to
from .bounds import Bounds
from .spherical import SphericalEllipse, SphericalRectangle

# A rectangle nearer than its length over the root of this is sampled by solid angle; for others area will do.
# Where one map ends and the other begins is an edge in primary space, the fainter the smaller the light.
_SMALL = np.float32(0.02)

# An ellipse nearer than this many times its length: its map costs more.
_ELLIPSE_NEAR = np.float32(0.7)


# Of the width of a light, how far from a ray it seems to be that passes it as near as can be: with that, what
# its middle brings is what the light does (a strip brings 0.32, a square 0.44).
_THICKNESS = 0.35

# Tangent of half a spread below which that is not so.
_STRAIGHT = 0.5


class _Figures(NamedTuple):
    """Where M samples may lie: rectangles and ellipses, (3, M) or (3, 1) as seen from the shaded points.

    area : (M,) or (1,), of what is sampled. share : what part of the light that is, None for all of it.
    """

    centre: np.ndarray
    edge_x: np.ndarray
    edge_y: np.ndarray
    facing: np.ndarray
    area: np.ndarray
    ellipse: np.ndarray
    share: np.ndarray | None

    def take(self, rows: np.ndarray) -> _Figures:
        return _Figures(*(x if x is None or x.shape[-1] == 1 else take(x, rows) for x in self))


class AreaEmitters(Emitters):
    """Rectangles and ellipses, one-sided. Measure times the spread's grid, where there is one.

    Sampled by area, measure cos / d^2. What is large for the shaded point is sampled by its solid angle,
    which over its area is the measure: nothing peaks however near it is. A rectangle's directions follow the
    cosine at the shaded point as well, interpolated between its corners (as in pbrt-4), if it has a normal.
    Where a narrow spread lets only a part of a light reach the point, only the rectangle about that part is
    sampled.
    """

    is_flat = True

    def __init__(self, lights: Sequence[AreaLight], frame: Frame) -> None:
        rows = []
        for light in lights:
            axes = light.light_to_world[:3, :3]
            edges = [axes[:, k] * light.size[k] for k in range(2)]
            lengths = [np.linalg.norm(edge) for edge in edges]
            area = lengths[0] * lengths[1] * (np.pi / 4 if light.ellipse else 1)
            strength = light.power / np.pi * (1 if light.normalize else area) * frame.scale**2
            half = 0.5 * max(light.spread, 2e-3)
            open_grid = light.spread >= np.pi - 1e-5
            tan_half = np.inf if open_grid else np.tan(half)
            # Integral of cos (1 - tan / tan half) over the cone, divided by tan half (Cycles' own).
            normalise = 0 if open_grid else (1 / (tan_half - half) if half > 0.05 else 3 / half**3)
            facing = -axes[:, 2] / np.linalg.norm(axes[:, 2])
            rows.append((edges, facing, area * frame.scale**2, tan_half, normalise, strength))
        size = np.array([row[2] for row in rows])
        super().__init__(np.array([row[5] for row in rows]), size, [light.links for light in lights])
        self._centre = frame.positions([light.light_to_world[:3, 3] for light in lights]).T.copy()
        self._edge_x, self._edge_y = (
            np.array([row[0][k] * frame.scale for row in rows], np.float32).T.copy() for k in range(2)
        )
        self._facing = np.array([row[1] for row in rows], np.float32).T.copy()
        self._area = size.astype(np.float32)
        self._ellipse = np.array([light.ellipse for light in lights])
        self._tan_half = np.array([min(row[3], 1e30) for row in rows], np.float32)
        self._normalise = np.array([row[4] for row in rows], np.float32)
        self._any_grid = bool(self._normalise.any())
        self._length = np.stack([length(self._edge_x), length(self._edge_y)])
        self._reach = 0.5 * self._length.sum(axis=0)
        sheared = np.abs(dot(self._edge_x, self._edge_y)) > 1e-4 * self._length.prod(axis=0)
        # How far parts of a light are from its middle's plane, if it does not shine straight ahead.
        tilt = [np.abs(dot(self._facing, edge)) for edge in (self._edge_x, self._edge_y)]
        oblique = (tilt[0] > 1e-4 * self._length[0]) | (tilt[1] > 1e-4 * self._length[1])
        self._tilt = np.where(oblique, 0.5 * (tilt[0] + tilt[1]), 0).astype(np.float32)
        self.skewed = sheared = sheared | oblique
        # No solid angle, and no part, for what is no rectangle.
        reach = np.where(self._ellipse, _ELLIPSE_NEAR, 1 / np.sqrt(_SMALL))
        self._large = np.where(sheared, 0, self._length.max(axis=0) * reach).astype(np.float32)
        self._perhaps_large = np.where(sheared, 0, (self._large + self._reach) ** 2).astype(np.float32)
        self._narrow = (self._normalise > 0) & (self._tan_half < 0.8) & ~sheared
        self._any_narrow = bool(self._narrow.any())
        self._gridded = (self._normalise > 0) & ~sheared
        # Straight ahead, where no more is known of what a grid leaves.
        most = np.where((self._normalise > 0) & sheared, self._normalise * self._tan_half, 1)
        self._ahead = self._brightness * most.astype(np.float32)
        # Coordinates along the edges, which need not be perpendicular, from -1/2 to 1/2.
        x, y = self._edge_x.astype(np.float64), self._edge_y.astype(np.float64)
        xx, xy, yy = dot(x, x), dot(x, y), dot(y, y)
        inverse = 1 / np.maximum(xx * yy - xy * xy, 1e-300)
        self._across, self._up = (
            v.astype(np.float32) for v in ((yy * x - xy * y) * inverse, (xx * y - xy * x) * inverse)
        )
        self._sized = np.arange(len(lights))
        self.centre = self._centre.astype(np.float64)
        self.cone_axis = np.array([row[1] for row in rows]).T
        self.cone_cos = np.array([1 / np.hypot(1, row[3]) for row in rows])
        # What a rectangle's corners need is enough for the ellipse within.
        self.reach = 0.5 * np.maximum(length(x + y), length(x - y))
        # About squares that are moved along the longer edge.
        longer = np.where(xx > yy, x, y)
        longest, width = (
            length(longer),
            np.sqrt(np.maximum(xx * yy - xy * xy, 0)) / np.sqrt(np.maximum(xx, yy)),
        )
        part = 1 - width / longest
        # What shines straight ahead is as wide as it is, from wherever it is seen.
        narrow = self._tan_half < _STRAIGHT
        self.core = np.where((part > 1e-3) & ~narrow, 0.5 * part, 0) * longer
        self.thickness = np.where(narrow, self.reach, _THICKNESS * width)
        if len(lights) > FEW:
            reach = 0.5 * (np.abs(x) + np.abs(y))
            self._bounds = Bounds(self._centre - reach, self._centre + reach)
        self._visible = [i for i, light in enumerate(lights) if light.visible_to_camera]

    def _grid(self, which: np.ndarray | None, cosine: np.ndarray) -> np.ndarray:
        """The part of the light that a soft box's grid lets through at an angle (Cycles' "spread")."""
        tan = np.sqrt(np.maximum(1 - cosine * cosine, 0)) / np.maximum(cosine, np.float32(1e-12))
        normalise = of(self._normalise, which)
        part = np.maximum(of(self._tan_half, which) - tan, 0) * normalise
        return np.where(normalise > 0, part, np.float32(1))

    def falloff(self, which, cosine):
        return cosine * self._grid(which, cosine)

    def _figures(self, which: np.ndarray | None, position: np.ndarray) -> _Figures:
        edge_x, edge_y, facing = (of(t, which) for t in (self._edge_x, self._edge_y, self._facing))
        centre, area, ellipse = (
            vectors_to(self._centre, which, position),
            of(self._area, which),
            of(self._ellipse, which),
        )
        whole = _Figures(centre, edge_x, edge_y, facing, area, ellipse, None)
        if not self._any_narrow:
            return whole
        # The grid's cone about the foot of the perpendicular, and a square about that.
        length_x, length_y = (of(x, which) for x in self._length)
        radius = np.minimum(np.maximum(-dot(facing, centre), 0) * of(self._tan_half, which), np.float32(1e30))
        low_x, high_x = _part(-dot(edge_x, centre) / length_x, radius, 0.5 * length_x)
        low_y, high_y = _part(-dot(edge_y, centre) / length_y, radius, 0.5 * length_y)
        part_x, part_y = (high_x - low_x) / length_x, (high_y - low_y) / length_y
        cut = part_x * part_y * (length_x * length_y)
        use = of(self._narrow, which) & (cut > 0) & (cut < np.float32(0.999) * area)
        if not use.any():
            return whole
        centre = centre + (0.5 * (low_x + high_x) / length_x * use) * edge_x
        centre += (0.5 * (low_y + high_y) / length_y * use) * edge_y
        return _Figures(
            centre,
            edge_x * np.where(use, part_x, 1),
            edge_y * np.where(use, part_y, 1),
            np.broadcast_to(facing, centre.shape),
            np.where(use, cut, area),
            ellipse & ~use,
            np.where(use, cut / area, 1),
        )

    def _near(self, which: np.ndarray | None, figures: _Figures) -> np.ndarray:
        """Lanes whose light is large as seen from the point."""
        centre = figures.centre
        near = np.flatnonzero(dot(centre, centre) < of(self._perhaps_large, which))
        if near.size:
            some = figures.take(near)
            square = dot(some.facing, some.centre) ** 2
            for edge in (some.edge_x, some.edge_y):
                whole = length(edge)
                beyond = np.maximum(np.abs(dot(edge, some.centre)) / whole - 0.5 * whole, 0)
                square = square + beyond * beyond
            large = of(self._large, None if which is None else which.take(near))
            near = near[square < large * large]
        return near

    def sample(self, which, position, normal, w, u):
        figures = self._figures(which, position)
        near = self._near(which, figures)
        to_light, measure = self._sample_near(which, figures, near, normal, u)
        if self._any_grid:
            cosine = np.maximum(-dot(figures.facing, to_light), 0)
            cosine /= np.sqrt(np.maximum(dot(to_light, to_light), np.float32(1e-30)))
            measure *= self._grid(which, np.minimum(cosine, 1))
            if figures.share is not None and self._ellipse.any():
                measure *= self._inside(which, position, to_light)
        return to_light, measure

    def _sample_near(
        self,
        which: np.ndarray | None,
        figures: _Figures,
        near: np.ndarray,
        normal: np.ndarray | None,
        u: np.ndarray,
    ) -> Sample:
        """Samples without the grid, lanes ``near`` by solid angle where that can be."""
        if near.size == u.shape[1] and not self._ellipse.any():
            figure = SphericalRectangle(*figures[:4], normal)
            if figure.usable.all():
                to_light, density = figure.sample(u)
                return to_light, 1 / (density * of(self._area, which))
        to_light, measure = _by_area(figures, u)
        for lanes, figure in self._spherical(figures, near, normal):
            vector, density = figure.sample(take(u, lanes))
            if not figure.usable.all():
                use = np.flatnonzero(figure.usable)
                lanes, vector, density = lanes.take(use), take(vector, use), density.take(use)
            for out, values in zip(to_light, vector, strict=True):
                out[lanes] = values
            measure[lanes] = 1 / (density * of(self._area, None if which is None else which.take(lanes)))
        return to_light, measure

    def _spherical(
        self, figures: _Figures, near: np.ndarray, normal: np.ndarray | None
    ) -> Iterator[tuple[np.ndarray, SphericalRectangle | SphericalEllipse]]:
        """Maps of lanes ``near``, rectangles and ellipses apart."""
        if near.size == 0:
            return
        if self._ellipse.any():
            ellipse = np.broadcast_to(figures.ellipse, figures.centre.shape[1]).take(near)
            parts = ((SphericalRectangle, near[~ellipse]), (SphericalEllipse, near[ellipse]))
        else:
            parts = ((SphericalRectangle, near),)
        for kind, lanes in parts:
            if lanes.size:
                some = figures.take(lanes)
                yield lanes, kind(*some[:4], None if normal is None else take(normal, lanes))

    def _inside(self, which: np.ndarray | None, position: np.ndarray, to_light: np.ndarray) -> np.ndarray:
        """(M,) whether a point of an ellipse's rectangle is of the ellipse."""
        gap = to_light - vectors_to(self._centre, which, position)
        length_x, length_y = (of(x, which) for x in self._length)
        a = dot(of(self._edge_x, which), gap) / (length_x * length_x)
        b = dot(of(self._edge_y, which), gap) / (length_y * length_y)
        return ~of(self._ellipse, which) | (a * a + b * b <= np.float32(0.25001))

    def irradiance(self, position, normal, which=None):
        to_light = self._column(self._centre, which) - position[:, None, :]
        reach, area = self._column(self._reach, which), self._column(self._area, which)
        gain = self._column(self._ahead, which)
        rows = np.flatnonzero(of(self._gridded, which))
        if rows.size:
            number = rows if which is None else which.take(rows)
            if len(rows) == to_light.shape[1]:
                share, through, reach = self._through_grid(number, to_light, reach)
                gain, area = gain * through, area * share
            else:
                gain, reach, area = (
                    np.array(np.broadcast_to(a, to_light.shape[1:])) for a in (gain, reach, area)
                )
                some = to_light[:, rows]
                share, through, reach[rows] = self._through_grid(number, some, reach[rows])
                to_light[:, rows] = some
                gain[rows] *= through
                area[rows] *= share
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        inverse = 1 / np.sqrt(square)
        size = np.minimum(reach * inverse, 1)
        estimate = dot(to_light, normal[:, None, :])
        estimate *= inverse
        estimate += size
        estimate /= 1 + size
        np.clip(estimate, 0, 1, out=estimate)
        # A light's own plane can't be smoothed over: what lies behind all of it stays dark.
        height = -dot(self._column(self._facing, which), to_light)
        height += self._column(self._tilt, which)
        size *= np.float32(0.5)
        light = height * inverse
        light += size
        light /= 1 + size
        estimate *= np.clip(light, 0, 1, out=light)
        estimate *= height > np.float32(-1e-5) * reach
        estimate *= gain
        square += area * np.float32(1 / np.pi)
        estimate /= square
        return estimate

    def _through_grid(
        self, which: np.ndarray, to_light: np.ndarray, reach: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What lights ``which`` (L',) with a grid show of themselves to points (3, L', M) from their middles,
        which are overwritten by the vectors from there to the nearest place.

        Returns the part (L', M) of a light that is near enough to be seen, that times what the grid leaves of
        it in the mean, and how far it reaches (L', M) from the nearest place.
        """
        height = np.maximum(-dot(self._column(self._facing, which), to_light), 0)
        tan_half = self._column(self._tan_half, which)
        radius = np.minimum(height * tan_half, np.float32(1e30))
        edges = [self._column(edge, which) for edge in (self._edge_x, self._edge_y)]
        lengths = [np.maximum(self._column(long, which), np.float32(1e-30)) for long in self._length]
        feet = [-dot(edge, to_light) / long for edge, long in zip(edges, lengths, strict=True)]
        share, beside, within = (np.full(height.shape, start, np.float32) for start in (1, 0, 0))
        for edge, long, foot in zip(edges, lengths, feet, strict=True):
            at = np.clip(foot, -0.5 * long, 0.5 * long)
            low, high = _part(foot, radius, 0.5 * long)
            foot -= at
            foot *= foot
            beside += foot
            at /= long
            for axis in range(3):
                to_light[axis] += edge[axis] * at
            seen = np.maximum(high - low, 0)
            within += seen * seen
            # More than nothing, as there is light wherever the grid lets some through.
            share *= np.maximum(seen / long, np.float32(1e-6))
        # To the nearest place, and to what is seen in the mean: of a square .38 of its edge, of a line 1/4.
        inverse = 1 / np.maximum(height, np.float32(1e-30))
        most = np.maximum(tan_half - np.float32(1 - 1e-4) * np.sqrt(beside) * inverse, 0)
        mean = tan_half - np.sqrt(beside + np.float32(0.07) * within) * inverse
        gain = np.maximum(mean, np.float32(0.1) * most) * self._column(self._normalise, which)
        gain *= share
        return share, gain, 2 * np.minimum(reach, radius)

    def pdf(self, which, position, normal, to_light):
        figures = self._figures(which, position)
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        density = area_to_solid_angle(square, -dot(figures.facing, to_light), figures.area)
        for lanes, figure in self._spherical(figures, self._near(which, figures), normal):
            pdf = figure.pdf(take(to_light, lanes))
            use = np.flatnonzero(figure.usable)
            density[lanes.take(use)] = pdf.take(use)
        return density

    def _meet(self, light, position, directions):
        facing = take(self._facing, light)
        centre = take(self._centre, light) - position
        towards = -dot(directions, facing)
        front = towards > 0
        t = -dot(centre, facing) / np.where(front, towards, np.float32(1))
        gap = directions * t
        gap -= centre
        a, b = (np.abs(dot(gap, take(axis, light))) for axis in (self._across, self._up))
        half = np.float32(0.5)
        ellipse = self._ellipse.take(light)
        inside = np.where(ellipse, a * a + b * b <= half * half, (a <= half) & (b <= half))
        return t, front & (t > 0) & inside

    def _gain(self, light, position, directions):
        if not self._any_grid:
            return None
        return self._grid(light, np.clip(-dot(take(self._facing, light), directions), 0, 1))


def _part(foot: np.ndarray, radius: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The interval that (foot - radius, foot + radius) and (-half, half) share."""
    return np.maximum(foot - radius, -half), np.minimum(foot + radius, half)


def _by_area(figures: _Figures, u: np.ndarray) -> Sample:
    """Samples uniform in area, and their measures."""
    x, y = u[0] - np.float32(0.5), u[1] - np.float32(0.5)
    if figures.ellipse.any():
        dx, dy = concentric_disk(u[0], u[1])
        x, y = np.where(figures.ellipse, 0.5 * dx, x), np.where(figures.ellipse, 0.5 * dy, y)
    to_light = figures.centre + x * figures.edge_x
    to_light += y * figures.edge_y
    square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
    measure = np.maximum(-dot(figures.facing, to_light), 0)
    measure /= square * np.sqrt(square)
    if figures.share is not None:
        measure *= figures.share
    return to_light, measure
