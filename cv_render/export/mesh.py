# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes: Blender's arrays, read once for all instances, without a Python loop over their elements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..versions import flat_faces_split_normals


@dataclass(frozen=True)
class MeshData:
    """A mesh in its own space.

    vertices : (V, 3) float32.
    triangles : (T, 3) int32 into ``vertices``.
    normals : (N, 3) float32 shading normals, or None if all is flat.
    normal_indices : (T, 3) int32 into ``normals``.
    slots : the material slot of all triangles, or (T,) int32 of them.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None
    normal_indices: np.ndarray | None
    slots: Any


def read_mesh(mesh: Any) -> MeshData | None:
    """The faces of an evaluated Blender mesh, as triangles; None if it has none."""
    mesh.calc_loop_triangles()
    if not len(mesh.loop_triangles):
        return None
    vertices = _array(mesh.attributes["position"].data, "vector", np.float32, 3)
    corners = _array(mesh.loop_triangles, "loops", np.int32, 3)
    triangles = _array(mesh.attributes[".corner_vert"].data, "value", np.int32)[corners]
    slots: Any = 0
    material_index = mesh.attributes.get("material_index")
    if material_index is not None:
        faces = _array(mesh.loop_triangle_polygons, "value", np.int32)
        slots = _array(material_index.data, "value", np.int32)[faces]
        if (slots == slots[0]).all():
            slots = int(slots[0])

    normals, normal_indices = _normals(mesh, vertices, triangles, corners)
    return MeshData(vertices, triangles, normals, normal_indices, slots)


def _normals(
    mesh: Any, vertices: np.ndarray, triangles: np.ndarray, corners: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Shading normals and their indices, as Cycles takes them.

    Of corners where something splits them, else of vertices; only among the latter can faces be flat.
    """
    if mesh.normals_domain == "FACE":
        return None, None
    if mesh.normals_domain == "CORNER" and (
        flat_faces_split_normals() or mesh.has_custom_normals or _has_sharp_edges(mesh)
    ):
        return _array(mesh.corner_normals, "vector", np.float32, 3), corners
    normals = _array(mesh.vertex_normals, "vector", np.float32, 3)
    sharp_face = mesh.attributes.get("sharp_face")
    if sharp_face is None:
        return normals, triangles
    faces = _array(mesh.loop_triangle_polygons, "value", np.int32)
    flat = np.flatnonzero(_array(sharp_face.data, "value", bool)[faces])
    return _flatten(normals, triangles, flat, vertices, triangles)


def _has_sharp_edges(mesh: Any) -> bool:
    sharp = mesh.attributes.get("sharp_edge")
    return sharp is not None and bool(_array(sharp.data, "value", bool).any())


def _flatten(
    normals: np.ndarray, indices: np.ndarray, flat: np.ndarray, vertices: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same normals, but for the ``flat`` triangles their own geometric ones."""
    a, b, c = (vertices[triangles[flat, k]] for k in range(3))
    indices = indices.copy()
    indices[flat] = (len(normals) + np.arange(len(flat), dtype=np.int32))[:, None]
    return np.concatenate([normals, np.cross(b - a, c - a)]), indices


def _array(collection: Any, attribute: str, dtype: Any, width: int = 1) -> np.ndarray:
    array = np.empty(len(collection) * width, dtype)
    collection.foreach_get(attribute, array)
    return array.reshape(-1, width) if width > 1 else array
