# SPDX-License-Identifier: GPL-3.0-or-later
"""Embree, through embreex: the only module that imports it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import RenderError

try:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene
except ImportError as error:  # reported by RayTracer, so that a scene without it can still be built
    _IMPORT_ERROR: ImportError | None = error
else:
    _IMPORT_ERROR = None

FAR = np.float32(1e37)

MANY = 1 << 20
"""Triangles above which no tuples are made of them: that would take more memory than the tree."""


@dataclass
class ClosestHits:
    """What Embree knows of each ray's first hit; rows of rays that met nothing have triangle -1.

    triangle : (N,) int32. distance : (N,) float32, in lengths of the direction.
    u, v : (N,) float32, barycentric weights of corners 1 and 2.
    normal : (N, 3) float32, geometric, not normalised, (v1 - v0) x (v2 - v0).
    """

    triangle: np.ndarray
    distance: np.ndarray
    u: np.ndarray
    v: np.ndarray
    normal: np.ndarray


class RayTracer:
    """Closest hits and visibility among triangles. Its methods release the GIL and may run in parallel."""

    def __init__(self, vertices: np.ndarray, indices: np.ndarray) -> None:
        """vertices : (V, 3) float32; indices : (T, 3) int32."""
        if _IMPORT_ERROR is not None:
            raise RenderError(
                "the ray tracer embreex is missing or does not load on this platform "
                f"({_IMPORT_ERROR}); install the CV Render package made for it"
            )
        self._scene = EmbreeScene(robust=True) if len(indices) else None
        if self._scene is not None:
            self._mesh = TriangleMesh(self._scene, vertices, _rows(indices))
            # The first ray builds the tree; later calls come from several threads.
            self.occluded(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), FAR)

    def closest_hit(
        self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray = FAR
    ) -> ClosestHits:
        """First hits of rays (N, 3) float32 within ``reach`` lengths of their direction.

        reach : one number, or (N,) float32.
        """
        if self._scene is None:
            n = len(origins)
            nothing = np.zeros(n, np.float32)
            return ClosestHits(
                np.full(n, -1, np.int32), nothing, nothing, nothing, np.zeros((n, 3), np.float32)
            )
        # An array would be overwritten.
        reach = reach.copy() if np.ndim(reach) else float(reach)
        hit = self._scene.run(origins, directions, dists=reach, output=True)
        return ClosestHits(hit["primID"], hit["tfar"], hit["u"], hit["v"], hit["Ng"])

    def distance(
        self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray = FAR
    ) -> np.ndarray:
        """(N,) float32 lengths of the direction to first hits; arguments as in `closest_hit`. ``reach`` where
        there is none.
        """
        # An array would be overwritten.
        reach = np.array(np.broadcast_to(reach, len(origins)), np.float32)
        if self._scene is None:
            return reach
        return self._scene.run(origins, directions, dists=reach, query="DISTANCE")

    def occluded(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        """(N,) bool: does anything lie within ``reach`` lengths of each ray's direction?

        reach : one number, or (N,) float32.
        """
        if self._scene is None:
            return np.zeros(len(origins), bool)
        return self._scene.run(origins, directions, dists=reach, query="OCCLUDED") >= 0


def _rows(indices: np.ndarray) -> np.ndarray:
    """(T,) tuples of indices (T, 3), if they are not `MANY`: embreex takes ``indices[i][k]`` one by one, and
    of each row of an array that would make an array.
    """
    if len(indices) > MANY:
        return indices
    return np.ascontiguousarray(indices, np.int32).view("i4, i4, i4").ravel().astype(object)
