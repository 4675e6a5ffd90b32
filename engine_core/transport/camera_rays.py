# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays through the pixels of a camera."""

from __future__ import annotations

import numpy as np

from ..geometry.frame import Frame
from ..geometry.raytracer import FAR
from ..geometry.warps import (
    about_angle,
    concentric_disk,
    polar_in_disk,
    regular_polygon,
    square_of_disk,
    square_of_polygon,
)
from ..scene import Camera

LIT = 0.75
"""Of a lens' points about a spot, those from which its cone is seen, about."""


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
        self._lens = camera.aperture * frame.scale, camera.blades, camera.blade_rotation
        self._narrowing = 1 / camera.aperture_ratio
        self._focus = camera.focus_distance * frame.scale

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

    def scale(self, positions: np.ndarray) -> np.ndarray:
        """(L,) pixels of a unit of the frame at positions (3, L) in front."""
        image, depth = self.image_of(positions)
        beside = 1e-3 * np.maximum(depth, 1e-30)
        moved, _ = self.image_of(positions + self.right[:, None] * beside)
        return np.abs(moved - image).max(axis=0) / beside

    def seen_at(self, position: np.ndarray, x: np.ndarray, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(2, B, S) where a lens, its radius 1, sees a position (3,) in front of it, from places of pixels.

        x, y : (B,) pixels of the whole frame. u : (2, B, S) of their unit squares.
        """
        depth = self._forward @ position
        # What is in focus is seen from nowhere else.
        moved = 1 - depth / self._focus
        moved = np.copysign(max(abs(moved), 1e-9), moved)
        place = np.stack([x, y])[:, :, None] + u.astype(np.float64)
        at = np.empty(place.shape)
        for out, side, narrowing in zip(at, (self.right, self._up), (self._narrowing, 1), strict=True):
            seen = side @ self._corner + (side @ self._step_x) * place[0] + (side @ self._step_y) * place[1]
            seen = seen * depth if self._perspective else seen
            out[:] = (side @ position - seen) / (moved * self._lens[0] * narrowing)
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
