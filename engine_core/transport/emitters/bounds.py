# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes about many lights, traced to find those that a ray might meet."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...geometry.raytracer import RayTracer

# Corner k lies at the upper end of axis i where bit i of k is set; faces turn outwards.
_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
_TRIANGLES = np.array([t for a, b, c, d in _FACES for t in ((a, b, c), (a, c, d))])

_STEP = np.float32(4e-7)
"""How far past a face a ray goes on, relative to the numbers that it is computed from."""


class Bounds:
    """Boxes a little larger than L lights, each by another bit so that no two faces coincide."""

    def __init__(self, low: np.ndarray, high: np.ndarray) -> None:
        """low, high : (3, L)."""
        low, high = (np.asarray(x, np.float64).T for x in (low, high))
        count = len(low)
        more = 1e-3 * (1 + (np.arange(count) * 0.6180339887) % 1)
        more = more * (high - low).max(axis=1) + 1e-6 * np.maximum(np.abs(low), np.abs(high)).max(axis=1)
        ends = np.stack([low - more[:, None], high + more[:, None]])
        corner = np.arange(8)
        vertices = np.stack([ends[corner >> axis & 1, :, axis] for axis in range(3)], axis=-1)
        indices = _TRIANGLES[None] + 8 * np.arange(count)[:, None, None]
        self._tracer = RayTracer(
            np.ascontiguousarray(vertices.transpose(1, 0, 2).reshape(-1, 3), np.float32),
            indices.reshape(-1, 3).astype(np.int32),
        )

    def crossed(
        self, position: np.ndarray, directions: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Rays (K,) and the boxes (K,) that they leave: in steps, all boxes of each ray once.

        position, directions : (3, N) float32, unit.
        """
        lane = np.arange(position.shape[1])
        origins, directions = (np.ascontiguousarray(x.T) for x in (position, directions))
        last, step = np.full(len(lane), -1), np.full(len(lane), _STEP)
        while lane.size:
            hits = self._tracer.closest_hit(origins, directions)
            met = np.flatnonzero(hits.triangle >= 0)
            lane, last, step = lane.take(met), last.take(met), step.take(met)
            origins, directions = origins.take(met, axis=0), directions.take(met, axis=0)
            normal, distance = hits.normal.take(met, axis=0), hits.distance.take(met)
            box = hits.triangle.take(met) // len(_TRIANGLES)
            leaves = np.flatnonzero(((normal * directions).sum(axis=1) > 0) & (box != last))
            if leaves.size:
                yield lane.take(leaves), box.take(leaves)
                last[leaves] = box.take(leaves)
            # Past the face by a few units in the last place of what it was computed from. A ray that grazes
            # it may meet it again and again: ever further then.
            scale = np.maximum(distance + np.abs(origins).max(axis=1), np.float32(1e-30))
            step = np.where(distance < 4 * step * scale, 2 * step, _STEP)
            origins = origins + directions * (distance + step * scale)[:, None]
