# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays through the pixels of a camera."""

from __future__ import annotations

import numpy as np

from ..geometry.frame import Frame
from ..geometry.raytracer import FAR
from ..geometry.warps import (
    about_angle,
    concentric_disk,
    in_regular_polygon,
    polar_in_disk,
    regular_polygon,
    square_of_disk,
    square_of_polygon,
)
from ..scene import Camera

LIT = 0.75
"""Of a lens' points about a spot, those from which its cone is seen, about."""


DOUBLINGS = 8
"""Of the distance to what is in focus: what is nearer to that is as good as in focus."""

LINE, LINE_DOUBLINGS = 1e6, 20
"""Times its distance from the camera, after which a line's image is its vanishing point; and binary
logarithms of the distances from the camera at which it is cut."""


class CameraRays:
    """Maps (pixel, point in its unit square, point on a lens of some size) to a ray, in the frame's units.

    dimensions : 2 of a pixel, and 2 of a lens. right : (3,) unit, along the picture's rows.

    The direction's component along the view axis is 1, so that a distance along the ray *is* the
    depth. The box filter of one pixel is the whole reconstruction, as with Cycles' "Box".
    """

    def __init__(self, camera: Camera, frame: Frame) -> None:
        right, up, back = camera.camera_to_world[:3, :3].T
        left, right_edge, bottom, top = camera.viewplane
        self._perspective = camera.projection == "perspective"
        unit = 1.0 if self._perspective else frame.scale
        self._corner = right * (left * unit) + up * (bottom * unit)
        self._step_x = right * ((right_edge - left) * unit / camera.width)
        self._step_y = up * ((top - bottom) * unit / camera.height)
        self._forward = -back
        self.clip_start = float(camera.clip_start * frame.scale)
        length = (camera.clip_end - camera.clip_start) * frame.scale
        self.reach = float(min(length, FAR))
        self.dimensions = 4 if camera.aperture > 0 else 2
        self.right, self._up = right, up
        self._lens = camera.aperture * frame.scale, camera.blades, camera.blade_rotation % (2 * np.pi)
        self._narrowing = 1 / camera.aperture_ratio
        self._focus = np.float64(camera.focus_distance * frame.scale)

    def rays(self, x: np.ndarray, y: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions, (B * S, 3) float32 (one direction (1, 3) if orthographic, all in focus).

        x, y : (B,) pixels of the whole frame. u : (2 or 4, B, S) points of each pixel's unit square, and of
        the lens.
        """
        # Where the pixel begins needs float64: at 4K its float32 is worth only 2^-12 of a pixel.
        start = self._corner[:, None] + self._step_x[:, None] * x + self._step_y[:, None] * y
        if self._perspective:
            start = start + self._forward[:, None]
        start = start.astype(np.float32)
        step_x, step_y = self._step_x.astype(np.float32), self._step_y.astype(np.float32)
        points = np.empty((u[0].size, 3), np.float32)
        for i in range(3):
            value = u[0] * step_x[i]
            value += u[1] * step_y[i]
            value += start[i][:, None]
            points[:, i] = value.reshape(-1)
        if self.dimensions == 4:
            return self._through_lens(points, u[2:].reshape(2, -1))
        if self._perspective:
            return points * np.float32(self.clip_start), points
        points += (self._forward * self.clip_start).astype(np.float32)
        return points, self._forward.astype(np.float32)[None]

    def exactly(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins and directions (3, ...) float64 at places of the picture, in pixels; without a lens."""
        place = (a[(slice(None),) + (None,) * np.ndim(x)] for a in (self._corner, self._step_x, self._step_y))
        corner, step_x, step_y = place
        forward = self._forward[(slice(None),) + (None,) * np.ndim(x)]
        points = corner + step_x * x + step_y * y
        if self._perspective:
            points = points + forward
            return points * self.clip_start, points
        return points + forward * self.clip_start, np.broadcast_to(forward, points.shape)

    def image_of(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where positions (3, L) are in the picture: (2, L) float64 in pixels of the whole frame, and their
        depth (L,) along the view axis; without meaning where that is not above 0.
        """
        positions = np.asarray(positions, np.float64)
        depth = self._forward @ positions
        if self._perspective:
            with np.errstate(divide="ignore", invalid="ignore"):
                positions = positions / depth - self._forward[:, None]
        offset = positions - self._corner[:, None]
        steps = np.stack([self._step_x, self._step_y])
        return steps @ offset / np.square(steps).sum(axis=1)[:, None], depth

    def blur(self, depth: np.ndarray) -> np.ndarray:
        """Radii that a lens' rays through one point fill at depths along the view axis; in the frame."""
        return self._lens[0] * max(self._narrowing, 1) * np.abs(1 - depth / self._focus)

    def depth(self, positions: np.ndarray) -> np.ndarray:
        """(L,) of positions (3, L) along the view axis."""
        return self._forward @ np.asarray(positions, np.float64)

    def scale(self, positions: np.ndarray) -> np.ndarray:
        """(L,) pixels of a unit of the frame at positions (3, L) in front, along their shorter edge."""
        edge = np.sqrt(min(self._step_x @ self._step_x, self._step_y @ self._step_y))
        far = np.maximum(self.depth(positions), 1e-30) if self._perspective else np.ones(positions.shape[1])
        return 1 / (edge * far)

    def in_picture(
        self, positions: np.ndarray, radius: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(2, L) where balls of some radius (L,) are in the picture, in pixels of the whole frame. And what
        tells how far about that a pixel may see any of them, (L,) each: slant * unit * radius + blur, 1 / cos
        of the steepest rays, pixels of a unit of the frame where these are nearest, and pixels of the blur.
        Not finite next to the camera.
        """
        image, depth = self.image_of(positions)
        scale = self.scale(positions)
        unit = scale
        if self._perspective:
            unit = np.where(depth > radius, scale * depth / (depth - radius), np.inf)
        return image, self._slant(positions), unit, scale * self.blur(depth)

    def lens_scale(self, positions: np.ndarray) -> np.ndarray:
        """(L,) radii of the lens, about, that a unit of the frame at positions (3, L) is seen through."""
        away = np.abs(self.depth(positions) - self._focus)
        scale = self._slant(positions) * self._focus / (away * self._lens[0])
        return scale / min(self._narrowing, 1)

    def _slant(self, positions: np.ndarray) -> np.ndarray:
        """(L,) 1 / cos of the angle beside the view axis at which positions (3, L) are seen, at most."""
        lens = self._lens[0] * max(self._narrowing, 1)
        if self._perspective:
            depth = np.maximum(self.depth(positions), 1e-30)
            beside = np.square(positions).sum(axis=0) - np.square(depth)
            slope = lens / np.minimum(depth, self._focus) + np.sqrt(np.maximum(beside, 0)) / depth
        else:
            slope = lens / self._focus
        return np.sqrt(1 + np.square(slope)) * np.ones(positions.shape[1])

    def stations(self, start: np.ndarray, direction: np.ndarray, length: float, radius: float) -> np.ndarray:
        """Distances along a rod, from ``start`` (3,) on in a unit ``direction``, from where any of it is
        before the camera to its end: between them it is on one side of what is in focus, and its distances
        from that, from the camera and from the view axis at most double. None where it is behind the camera.
        """
        begin, slope = self._forward @ start, self._forward @ direction  # of NumPy, which divide by 0
        foot = -float(start @ direction)
        size = float(np.linalg.norm(start)) + radius + abs(self.clip_start)
        length = min(length, LINE * size)
        near = self.clip_start - radius
        doubled = size * 0.5 ** np.arange(-LINE_DOUBLINGS, LINE_DOUBLINGS)
        depth = self._focus * (
            1 + np.append(0, np.outer((-1, 1), 0.5 ** np.arange(-LINE_DOUBLINGS, 1 + DOUBLINGS)))
        )
        apart = np.zeros(0)
        if self._perspective:
            depth = np.append(depth, doubled)
            # From where it is nearest to the camera.
            beside = np.sqrt(max(start @ start - foot * foot, 0))
            apart = foot + np.outer((-1, 1), doubled[doubled > beside / 2]).ravel()
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            at = np.concatenate([(depth - begin) / slope, apart])
            limit = (near - begin) / slope
        first, last = 0.0, length
        if slope > 0:
            first = max(first, limit)
        elif slope < 0:
            last = min(last, limit)
        elif begin < near:
            return np.zeros(0)
        if not first < last:
            return np.zeros(0)
        return np.unique(np.concatenate([[first], at[(at > first) & (at < last)], [last]]))

    def seen_at(self, position: np.ndarray, x: np.ndarray, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(2, B, S) where a lens, its radius 1, sees a position (3,) in front of it, or (3, B), from places
        of pixels.

        x, y : (B,) pixels of the whole frame. u : (2, B, S) of their unit squares.
        """
        position = position.reshape(3, -1, 1)
        depth = np.tensordot(self._forward, position, 1)
        # What is in focus is seen from nowhere else.
        moved = 1 - depth / self._focus
        moved = np.copysign(np.maximum(np.abs(moved), 1e-9), moved)
        place = np.stack([x, y])[:, :, None] + u.astype(np.float64)
        at = np.empty(place.shape)
        for out, side, narrowing in zip(at, (self.right, self._up), (self._narrowing, 1), strict=True):
            seen = side @ self._corner + (side @ self._step_x) * place[0] + (side @ self._step_y) * place[1]
            seen = seen * depth if self._perspective else seen
            out[:] = (np.tensordot(side, position, 1) - seen) / (moved * self._lens[0] * narrowing)
        return at

    def lens_about(
        self, at: np.ndarray, v: np.ndarray, lit: tuple[float, float] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points (2, B, S) of the lens' unit square, spread in polar coordinates about places ``at`` of
        `seen_at`, (2, B, 1) or (2, B, S); and their weights (B, S). v : (2, B, S) uniform.

        lit : a direction of the lens, and an angle beside it, within which most are to be.
        """
        _, blades, rotation = self._lens
        u, more = v[0], 1.0
        if lit is not None:
            # From beside the lens there is but one direction to it.
            inside, even = np.clip(5 - 4 * np.hypot(*at), 0, 1), lit[1] / np.pi
            u, more = about_angle(u, *lit, even + np.maximum(LIT - even, 0) * inside)
        if blades < 3:
            *lens, weight = polar_in_disk(*at, u, v[1])
            return np.stack(square_of_disk(*lens)), weight * more
        *lens, weight = polar_in_disk(*at, u, v[1], blades, rotation)
        return np.stack(square_of_polygon(blades, rotation, *lens)), weight * more

    def on_lens(self, u: np.ndarray) -> np.ndarray:
        """(2, ...) points of the lens, its radius 1, at u (2, ...) of its unit square."""
        _, blades, rotation = self._lens
        return np.stack(concentric_disk(*u) if blades < 3 else regular_polygon(blades, rotation, *u))

    def square_of_lens(self, lens: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The inverse of `on_lens`: (2, ...), and whether they are on the lens at all."""
        _, blades, rotation = self._lens
        if blades < 3:
            u, inside = square_of_disk(*lens), (lens * lens).sum(axis=0) <= 1
        else:
            u = square_of_polygon(blades, rotation, *lens)
            inside = in_regular_polygon(blades, rotation, *lens)
        return np.clip(np.stack(u), 0, 1), inside

    @property
    def lens_area(self) -> float:
        """Of the lens, its radius 1."""
        blades = self._lens[1]
        return np.pi if blades < 3 else 0.5 * blades * np.sin(2 * np.pi / blades)

    def turns(self, position: np.ndarray) -> bool:
        """Whether a lens' rays pass a position (3,) on the other side than that at which they leave it."""
        return bool(self._forward @ position > self._focus)

    def _through_lens(self, points: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rays from points of the lens to where rays ``points`` (N, 3) through its middle are in focus."""
        radius, blades, rotation = self._lens
        x, y = concentric_disk(*u) if blades < 3 else regular_polygon(blades, rotation, *u)
        lens = np.outer(x * np.float32(radius * self._narrowing), self.right.astype(np.float32))
        lens += np.outer(y * np.float32(radius), self._up.astype(np.float32))
        if self._perspective:
            directions = points - lens / np.float32(self._focus)
            origins = lens
        else:
            directions = self._forward.astype(np.float32) - lens / np.float32(self._focus)
            origins = points + lens
        origins += directions * np.float32(self.clip_start)
        return origins, directions
