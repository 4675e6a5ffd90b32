# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes: Blender's arrays, read once for all instances, without a Python loop over their elements."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..versions import flat_faces_split_normals
from .attributes import PER_INSTANCE, Corners, array, read_attributes


@dataclass(frozen=True)
class MeshData:
    """A mesh in its own space.

    vertices : (V, 3) float32.
    triangles : (T, 3) int32 into ``vertices``.
    normals : (N, 3) float32 shading normals, or None if all is flat.
    normal_indices : (T, 3) int32 into ``normals``.
    slots : the material slot of all triangles, or (T,) int32 of them.
    attributes : (T, 3 or 1, C) float32 by name, in the mesh's own space.
    placed : names of further ones that depend on where the mesh stands.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    normals: np.ndarray | None
    normal_indices: np.ndarray | None
    slots: Any
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    placed: tuple[str, ...] = ()

    def part(self, chosen: np.ndarray) -> MeshData:
        """The triangles that are ``chosen`` ((T,) bool), with no vertices but theirs."""
        used, triangles = np.unique(self.triangles[chosen], return_inverse=True)
        return replace(
            self,
            vertices=self.vertices[used],
            triangles=triangles.reshape(-1, 3).astype(np.int32),
            normal_indices=None if self.normal_indices is None else self.normal_indices[chosen],
            slots=self.slots[chosen] if np.ndim(self.slots) else self.slots,
            attributes={name: values[chosen] for name, values in self.attributes.items()},
        )


def read_mesh(mesh: Any, attributes: Collection[str] = ()) -> MeshData | None:
    """The faces of an evaluated Blender mesh, as triangles; None if it has none.

    attributes : names of those that its materials ask for.
    """
    mesh.calc_loop_triangles()
    if not len(mesh.loop_triangles):
        return None
    vertices = array(mesh.attributes["position"].data, "vector", np.float32, 3)
    corners = array(mesh.loop_triangles, "loops", np.int32, 3)
    triangles = array(mesh.attributes[".corner_vert"].data, "value", np.int32)[corners]
    slots: Any = 0
    material_index = mesh.attributes.get("material_index")
    if material_index is not None:
        faces = array(mesh.loop_triangle_polygons, "value", np.int32)
        slots = array(material_index.data, "value", np.int32)[faces]
        if (slots == slots[0]).all():
            slots = int(slots[0])

    normals, normal_indices = _normals(mesh, vertices, triangles, corners)
    found = {}
    if attributes:
        shading = None if normals is None else _unit(normals)[normal_indices]
        found = read_attributes(Corners(mesh, vertices, triangles, corners, shading), attributes)
    placed = tuple(name for name in PER_INSTANCE if name in attributes)
    return MeshData(vertices, triangles, normals, normal_indices, slots, found, placed)


def _unit(normals: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(lengths > 0, lengths, 1)


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
        return array(mesh.corner_normals, "vector", np.float32, 3), corners
    normals = array(mesh.vertex_normals, "vector", np.float32, 3)
    sharp_face = mesh.attributes.get("sharp_face")
    if sharp_face is None:
        return normals, triangles
    faces = array(mesh.loop_triangle_polygons, "value", np.int32)
    flat = np.flatnonzero(array(sharp_face.data, "value", bool)[faces])
    return _flatten(normals, triangles, flat, vertices, triangles)


def _has_sharp_edges(mesh: Any) -> bool:
    sharp = mesh.attributes.get("sharp_edge")
    return sharp is not None and bool(array(sharp.data, "value", bool).any())


def _flatten(
    normals: np.ndarray, indices: np.ndarray, flat: np.ndarray, vertices: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same normals, but for the ``flat`` triangles their own geometric ones."""
    a, b, c = (vertices[triangles[flat, k]] for k in range(3))
    indices = indices.copy()
    indices[flat] = (len(normals) + np.arange(len(flat), dtype=np.int32))[:, None]
    return np.concatenate([normals, np.cross(b - a, c - a)]), indices
