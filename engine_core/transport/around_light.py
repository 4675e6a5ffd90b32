# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels about a light that the camera sees through fog, in polar coordinates about its image.

Near a light fog is as bright as 1 / D, D the distance of the light from the camera ray: integrable over a
pixel, and nothing that samples of equal density, or polynomials, would serve. With an angle phi and the
distance rho from the light's image, dx dy = rho drho dphi, and rho takes that away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..geometry.vectors import dot
from ..integration.integrand import StagedIntegrand
from .camera_hits import Pixels
from .camera_rays import CameraRays
from .light_choice_in_fog import AirLights
from .light_samples import SceneLights

HALF_WIDTH = 6
"""Of the block about a light's image, in pixels."""

BESIDE = 4 * HALF_WIDTH
"""Pixels from one light's image within which another's is too bright to be left to a few samples."""

CORE = 2
"""Half the width of what is close to it."""

NARROW = 16.0
"""Pixels across, below which a spot's beam is too narrow for nodes to be sure to see it."""

MARGIN = 1e-5
"""Of a cone's sine, so that rounding leaves nothing of it out."""

FARTHEST = 1e6
"""Pixels from the camera's axis, where a light's image is none."""


@dataclass(frozen=True, eq=False)
class Block:
    """The pixels about a light's image that are nearer to it than to that of any other light.

    light : its number. beside : numbers of lights whose images are not far. centre : (2,) of its own image.
    x, y : (B,) pixels of the whole frame. core : (B,) bool, which are close to it.
    """

    light: int
    beside: np.ndarray
    centre: np.ndarray
    x: np.ndarray
    y: np.ndarray
    core: np.ndarray


def blocks(
    rays: CameraRays, lights: SceneLights, numbers: np.ndarray, region: tuple[int, int, int, int]
) -> tuple[list[Block], np.ndarray]:
    """The blocks of lights ``numbers`` in a region (x0, y0, x1, y1), and (W, H) bool, pixels of any.

    None of those that are as large as that in the picture: no ray is so near that there was a peak.
    """
    x0, y0, x1, y1 = region
    owner, nearest = np.full((x1 - x0, y1 - y0), -1), np.full((x1 - x0, y1 - y0), np.inf)
    numbers = numbers[np.isfinite(lights.reach[numbers])]
    image, depth = rays.image_of(lights.centre[:, numbers])
    seen = (depth > rays.clip_start) & np.isfinite(image).all(axis=0)
    seen &= (np.abs(image) < 1e9).all(axis=0)
    for k in np.flatnonzero(seen):
        light = int(numbers[k])
        if lights.reach[light] > _beside(rays, lights, light, image[:, k]):
            continue
        low = np.floor(image[:, k]).astype(np.int64) - HALF_WIDTH
        xs, ys = (
            np.arange(max(lo, a), min(lo + 2 * HALF_WIDTH + 1, b))
            for lo, a, b in zip(low, (x0, y0), (x1, y1), strict=True)
        )
        if not (xs.size and ys.size):
            continue
        at = np.ix_(xs - x0, ys - y0)
        distance = np.hypot(xs[:, None] + 0.5 - image[0, k], ys + 0.5 - image[1, k])
        closer = distance < nearest[at]
        nearest[at] = np.where(closer, distance, nearest[at])
        owner[at] = np.where(closer, k, owner[at])
    found = []
    for k in np.unique(owner[owner >= 0]):
        x, y = np.nonzero(owner == k)
        core = nearest[x, y] < CORE + 0.5
        apart = np.abs(image - image[:, k : k + 1]).max(axis=0)
        beside = numbers[seen & (apart < BESIDE) & (np.arange(len(numbers)) != k)]
        found.append(Block(int(numbers[k]), beside, image[:, k], x + x0, y + y0, core))
    return found, owner >= 0


@dataclass(frozen=True, eq=False)
class Tamed:
    """What polynomials need not follow: light next to where it comes from.

    nearest, whole : (L,) distances of rays to lights, in the frame's units. Nodes take a ray to pass no
        nearer than the first, which pixels do that are not of a block; of a spot that begins as a narrow beam
        they see nothing there, and all of it from the second on. Both are 0 where there is no such thing in
        the picture.
    beams : (W, H) bool, pixels of the beams from there to there.
    """

    nearest: np.ndarray
    whole: np.ndarray
    beams: np.ndarray


@dataclass(frozen=True, eq=False)
class Wedge:
    """What a spot's beam covers of the picture: half planes that end in the line from the camera through the
    light are lines of it.

    centre : (2,) the light's image, in pixels of the whole frame. lit : as `polar` wants it.
    """

    centre: np.ndarray
    lit: tuple[float, float, float]

    @property
    def edges(self) -> np.ndarray:
        """(2, 2) unit directions, counter-clockwise."""
        angle = self.lit[0] + np.array(self.lit[1:])
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    @property
    def narrow(self) -> float:
        """How far from the light's image, in pixels, nodes are not sure to see it."""
        return NARROW / 2 / np.tan((self.lit[2] - self.lit[1]) / 2)

    def pixels(self, far: float, region: tuple[int, int, int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (B,) of a region that it touches up to so far from the image, and some next to it."""
        x0, y0, x1, y1 = region
        corners = np.array([(x, y) for x in (x0, x1) for y in (y0, y1)])
        half = (self.lit[2] - self.lit[1]) / 2
        length = min(far, np.hypot(*(corners - self.centre).T).max()) / np.cos(half) + 1
        triangle = self.centre + np.concatenate([np.zeros((1, 2)), length * self.edges])
        low, high = triangle[:, 1].min() - 1, triangle[:, 1].max() + 1
        rows = np.arange(max(y0, int(np.floor(low))), min(y1, int(np.ceil(high)) + 1))
        left, right = np.full(len(rows), np.inf), np.full(len(rows), -np.inf)
        bounds = np.stack([rows - 1, rows + 2])
        for (ax, ay), (bx, by) in zip(triangle, np.roll(triangle, 1, axis=0), strict=True):
            # Where an edge enters and leaves the band of rows, or ends in it.
            with np.errstate(divide="ignore", invalid="ignore"):
                t = np.clip(np.nan_to_num((bounds - ay) / (by - ay)), 0, 1)
            met = (min(ay, by) <= bounds[1]) & (max(ay, by) >= bounds[0])
            x = np.where(met, ax + t * (bx - ax), np.nan)
            left, right = np.fmin(left, np.fmin(*x)), np.fmax(right, np.fmax(*x))
            if ay == by:
                left = np.where(met, np.minimum(left, min(ax, bx)), left)
                right = np.where(met, np.maximum(right, max(ax, bx)), right)
        first = np.floor(np.clip(left - 1, x0, x1)).astype(np.int64)
        count = np.maximum(np.ceil(np.clip(right + 1, x0, x1)).astype(np.int64) - first, 0)
        x = np.arange(count.sum()) + np.repeat(first - np.cumsum(count) + count, count)
        return x, np.repeat(rows, count)

    def nearest(self, rays: CameraRays, lights: SceneLights, light: int, far: float) -> float:
        """A distance that all of its rays farther from the light's image than so many pixels keep from it."""
        angle = self.lit[0] + np.linspace(*self.lit[1:], 17)
        place = self.centre[:, None] + far * np.stack([np.cos(angle), np.sin(angle)])
        # The least may be between two of these places, but is no nearer than this.
        return 0.999 * float(_distances(rays, lights, light, place).min())


def wedges(rays: CameraRays, lights: SceneLights, cones: AirLights, numbers: np.ndarray) -> dict[int, Wedge]:
    """Of those of lights ``numbers`` that are spots before the camera, whose beams cover a part of the
    picture that is less than half pi wide. Of one with a size it begins behind the light.
    """
    found = {}
    for k in numbers[np.isfinite(lights.reach[numbers]) & cones.coned[numbers]].tolist():
        apex = (cones.apex if lights.reach[k] > 0 else lights.centre)[:, k]
        image, depth = rays.image_of(apex[:, None])
        if depth[0] > rays.clip_start and (np.abs(image) < FARTHEST).all():
            lit = _lit_from(rays, cones, k, apex)
            if lit is not None and lit[2] - lit[1] < np.pi / 2:
                found[k] = Wedge(image[:, 0], lit)
    return found


def tamed(
    rays: CameraRays,
    lights: SceneLights,
    beams: dict[int, Wedge],
    found: list[Block],
    region: tuple[int, int, int, int],
) -> Tamed:
    """Of the lights of blocks ``found`` in a region (x0, y0, x1, y1), and of spots' ``beams``."""
    x0, y0, x1, y1 = region
    nearest, whole = np.zeros((2, len(lights)))
    narrow = np.zeros((x1 - x0, y1 - y0), bool)
    for block in found:
        nearest[block.light] = _beside(rays, lights, block.light, block.centre)
    for k, beam in beams.items():
        x, y = beam.pixels(beam.narrow, region)
        if beam.narrow > HALF_WIDTH and x.size:
            whole[k] = beam.nearest(rays, lights, k, beam.narrow)
            narrow[x - x0, y - y0] = True
    return Tamed(nearest, whole, narrow)


def _beside(rays: CameraRays, lights: SceneLights, light: int, centre: np.ndarray) -> float:
    """How near rays pass a light at the edge of a block about its image ``centre`` (2,)."""
    beside = np.array([(-1, 1, 0, 0), (0, 0, -1, 1)]) * HALF_WIDTH
    return float(_distances(rays, lights, light, centre[:, None] + beside).min())


def _distances(rays: CameraRays, lights: SceneLights, light: int, place: np.ndarray) -> np.ndarray:
    """(N,) distances of a light to the rays through places (2, N) of the picture."""
    origin, direction = rays.exactly(*place)
    direction = direction / np.sqrt(dot(direction, direction))
    away = lights.centre[:, light, None] - origin
    away = away - direction * dot(away, direction)
    return np.sqrt(dot(away, away))


def lit_angles(
    rays: CameraRays, lights: SceneLights, cones: AirLights, light: int, sized: bool = False
) -> tuple[float, float, float] | None:
    """Between which directions in the picture, as `polar` wants them, its cone is seen; None for all, and for
    what has a size, unless it is ``sized``, which takes it for a point.
    """
    if not cones.coned[light] or lights.reach[light] > 0 and not sized:
        return None
    return _lit_from(rays, cones, light, lights.centre[:, light])


def _lit_from(
    rays: CameraRays, cones: AirLights, light: int, apex: np.ndarray
) -> tuple[float, float, float] | None:
    """The same of a cone's apex (3,).

    Half planes that end in the line from the camera through the apex are lines of the picture.
    """
    place = apex.astype(np.float64)
    centre, depth = rays.image_of(place[:, None])
    _, along = rays.exactly(*centre[:, 0])
    along = along / np.sqrt(dot(along, along))
    axis, cos = cones.axis[:, light].astype(np.float64), float(cones.cos[light])
    aside = axis - along * dot(axis, along)
    slope, sine = np.sqrt(dot(aside, aside)), np.sqrt(max(1 - cos * cos, 0)) + MARGIN
    if sine >= slope:
        return None
    aside, half = aside / slope, np.arcsin(sine / slope)
    turned = np.array([0, -half, half])
    lines = np.cos(turned) * aside[:, None] + np.sin(turned) * np.cross(along, aside)[:, None]
    # A line through the light has a line for an image, however long it is.
    image, _ = rays.image_of(place[:, None] + 0.5 * depth * lines)
    angle = np.arctan2(*(image - centre)[::-1])
    beside = np.remainder(angle[1:] - angle[0] + np.pi, 2 * np.pi) - np.pi
    return float(angle[0]), float(beside.min()), float(beside.max())


def peaks(
    rays: CameraRays,
    lights: SceneLights,
    beams: dict[int, Wedge],
    numbers: np.ndarray,
    region: tuple[int, int, int, int],
) -> tuple[list[Block], Tamed]:
    """Of lights ``numbers``, without size: tamed ones, and blocks that have all pixels of a region
    (x0, y0, x1, y1) that see more of the lights themselves. beams : of spots among them.

    Unlike `blocks`, these overlap: what the pixels have of all other lights is no business of theirs.
    """
    found = []
    nearest, whole = np.zeros((2, len(lights)))
    image, depth = rays.image_of(lights.centre[:, numbers])
    seen = (depth > rays.clip_start) & (np.abs(image) < FARTHEST).all(axis=0)
    seen &= np.isfinite(lights.reach[numbers])
    for k, centre in zip(numbers[seen].tolist(), image[:, seen].T, strict=True):
        beam = beams.get(k)
        far = HALF_WIDTH if beam is None else max(beam.narrow, HALF_WIDTH)
        x, y = _square(centre, HALF_WIDTH, region) if beam is None else beam.pixels(far, region)
        if not x.size:
            continue
        nearest[k] = _outside(rays, lights, k, centre, HALF_WIDTH)
        if far > HALF_WIDTH:
            whole[k] = beam.nearest(rays, lights, k, far)
        u, lit = np.full((2, len(x), 1), 0.5), None if beam is None else beam.lit
        rows = np.flatnonzero(polar(x - centre[0], y - centre[1], u, lit)[1])
        x, y = x.take(rows), y.take(rows)
        core = np.hypot(x + 0.5 - centre[0], y + 0.5 - centre[1]) < CORE + 0.5
        found.append(Block(k, numbers[:0], centre, x, y, core))
    return found, Tamed(nearest, whole, np.zeros((region[2] - region[0], region[3] - region[1]), bool))


def _square(
    centre: np.ndarray, half: float, region: tuple[int, int, int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (B,) of a region that a square about a place touches."""
    low, high = np.floor(centre - half).astype(int), np.floor(centre + half).astype(int) + 1
    columns, rows = (
        np.arange(max(first, a), min(last, b))
        for first, last, a, b in zip(low, high, region[:2], region[2:], strict=True)
    )
    x, y = np.meshgrid(columns, rows, indexing="ij")
    return x.ravel(), y.ravel()


def _outside(rays: CameraRays, lights: SceneLights, light: int, centre: np.ndarray, half: float) -> float:
    """A distance to a light, at which all rays outside of a square about its image pass it at least."""
    side = np.linspace(-half, half, 129)
    edge = np.full_like(side, half)
    place = np.concatenate([[side, edge], [side, -edge], [edge, side], [-edge, side]], axis=1)
    # The least may be between two of these places, but is no nearer than this.
    return 0.999 * float(_distances(rays, lights, light, centre[:, None] + place).min())


@dataclass(eq=False)
class _Weighted:
    """A first stage, and the weight of each of its points."""

    stage: Any
    weight: np.ndarray

    @property
    def values(self) -> np.ndarray | None:
        return self.stage.values

    @property
    def lane(self) -> np.ndarray | None:
        return self.stage.lane


class AroundLight:
    """An integrand over pixels, whose points are spread in polar coordinates about a place of the picture."""

    def __init__(
        self, integrand: StagedIntegrand, centre: np.ndarray, lit: tuple[float, float, float] | None = None
    ) -> None:
        """centre : (2,) float64, in pixels of the whole frame. lit : as in `polar`."""
        self._integrand, self._centre, self._lit = integrand, centre, lit
        self.rest_dimensions, self.staged = integrand.rest_dimensions, integrand.staged

    @property
    def counts(self):
        return self._integrand.counts

    def first(self, pixels: Pixels, u: np.ndarray) -> _Weighted:
        place, weight = polar(pixels.x - self._centre[0], pixels.y - self._centre[1], u, self._lit)
        return _Weighted(self._integrand.first(pixels, place), weight.ravel())

    def rest(
        self, stage: _Weighted, lane: np.ndarray | None, u: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        which, values = self._integrand.rest(stage.stage, lane, u)
        weight = stage.weight if stage.lane is None else stage.weight.take(stage.lane)
        weight = np.repeat(weight, u.shape[2]) if lane is None else weight.take(lane)
        return which, values * (weight if which is None else weight.take(which))


def polar(
    x: np.ndarray, y: np.ndarray, u: np.ndarray, lit: tuple[float, float, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Points of pixels whose corners are at (x, y) (B,), from the centre: in their unit squares, (2, B, S)
    float32, and weights (B, S); u (2, B, S) uniform.

    lit : an angle, and from where to where beside it (less than pi in all) there is light; None for all.
    """
    x, y = (np.asarray(a, np.float64)[:, None] for a in (x, y))
    inside = (x <= 0) & (x + 1 >= 0) & (y <= 0) & (y + 1 >= 0)
    towards = np.arctan2(y + 0.5, x + 0.5)
    corners = np.stack([np.arctan2(y + j, x + i) for i in (0, 1) for j in (0, 1)])
    turned = np.remainder(corners - towards + np.pi, 2 * np.pi) - np.pi
    low, high = np.where(inside, -np.pi, turned.min(axis=0)), np.where(inside, np.pi, turned.max(axis=0))
    if lit is not None:
        middle = np.remainder(lit[0] - towards + np.pi, 2 * np.pi) - np.pi
        low = np.where(inside, middle + lit[1], np.maximum(low, middle + lit[1]))
        high = np.where(inside, middle + lit[2], np.minimum(high, middle + lit[2]))
        high = np.maximum(low, high)
    angle = towards + low + u[0] * (high - low)
    cos, sin = np.cos(angle), np.sin(angle)
    entry, leave = np.zeros_like(angle), np.full_like(angle, np.inf)
    for corner, slope in ((x, cos), (y, sin)):
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = corner / slope, (corner + 1) / slope
        parallel = slope == 0
        near = np.where(parallel, -np.inf, np.minimum(first, second))
        far = np.where(parallel, np.inf, np.maximum(first, second))
        np.maximum(entry, near, out=entry)
        np.minimum(leave, far, out=leave)
    length = np.maximum(leave - entry, 0)
    radius = entry + u[1] * length
    place = np.stack([radius * cos - x, radius * sin - y])
    place = np.clip(place, 2.0**-24, 1 - 2.0**-24).astype(np.float32)
    # The distance of the point that is meant by its rounded coordinates.
    radius = np.hypot(place[0] + x, place[1] + y)
    return place, radius * length * (high - low)
