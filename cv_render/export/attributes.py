# SPDX-License-Identifier: GPL-3.0-or-later
"""What materials ask of meshes beside their shape: UV maps, colours, coordinates, tangents."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...engine_core.shading.textures import longitude_latitude

PER_INSTANCE = ("world", "object_to_world")
"""Names of what depends on where a mesh is placed."""


@dataclass(frozen=True)
class Corners:
    """A mesh's triangles, as attributes are read for them.

    vertices : (V, 3) float32. triangles, loops : (T, 3) int32, vertices and corners of the mesh.
    normals : (T, 3, 3) shading normals, None if all is flat.
    """

    mesh: Any
    vertices: np.ndarray
    triangles: np.ndarray
    loops: np.ndarray
    normals: np.ndarray | None

    def read(self, name: str) -> np.ndarray | None:
        """(T, 3, C) float32 of the attribute that an expression calls ``name``; None if there is none."""
        kind, _, layer = name.partition(":")
        return _KINDS[kind](self, layer)


def read_attributes(corners: Corners, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Those of ``names`` that the mesh has in its own space."""
    found = {name: corners.read(name) for name in sorted(names) if name not in PER_INSTANCE}
    return {name: values for name, values in found.items() if values is not None}


def _object(corners: Corners, _layer: str) -> np.ndarray:
    return corners.vertices[corners.triangles]


def _generated(corners: Corners, _layer: str) -> np.ndarray:
    """Places in the texture space, before modifiers moved the vertices."""
    mesh = corners.mesh
    undeformed = array(mesh.vertices, "undeformed_co", np.float32, 3)
    centre, half = (np.array(v, np.float32) for v in (mesh.texspace_location, mesh.texspace_size))
    generated = (undeformed - centre) / np.where(half == 0, 1, 2 * half) + np.float32(0.5)
    return generated[corners.triangles]


def _uv(corners: Corners, layer: str) -> np.ndarray | None:
    layers = corners.mesh.uv_layers
    chosen = layers.get(layer) if layer else next((uv for uv in layers if uv.active_render), None)
    return None if chosen is None else array(chosen.uv, "vector", np.float32, 2)[corners.loops]


def _colour(corners: Corners, layer: str) -> np.ndarray | None:
    colours = corners.mesh.color_attributes
    name = layer or (colours[colours.render_color_index].name if len(colours) else "")
    return _generic(corners, name, width=4)


_FIELDS = {
    "FLOAT": ("value", 1),
    "INT": ("value", 1),
    "INT8": ("value", 1),
    "BOOLEAN": ("value", 1),
    "FLOAT2": ("vector", 2),
    "FLOAT_VECTOR": ("vector", 3),
    "FLOAT_COLOR": ("color", 4),
    "BYTE_COLOR": ("color", 4),  # read as scene linear
}
_TYPES = {"INT": np.int32, "INT8": np.int32, "BOOLEAN": bool}


def _generic(corners: Corners, name: str, width: int = 5) -> np.ndarray | None:
    """(T, 3 or 1, 5) red, green, blue, alpha and the one number that Cycles makes of them."""
    attribute = corners.mesh.attributes.get(name)
    if attribute is None or attribute.data_type not in _FIELDS:
        return None
    field, count = _FIELDS[attribute.data_type]
    values = array(attribute.data, field, _TYPES.get(attribute.data_type, np.float32), count)
    values = values.reshape(-1, count).astype(np.float32)
    full = np.ones((len(values), 5), np.float32)
    full[:, :3] = np.pad(values, ((0, 0), (0, 1))) if count == 2 else values[:, :3]
    if count == 4:
        full[:, 3] = values[:, 3]
    full[:, 4] = values[:, 0] if count < 3 else full[:, :3].mean(axis=1)
    return _on_corners(corners, full[:, :width], attribute.domain)


def _on_corners(corners: Corners, values: np.ndarray, domain: str) -> np.ndarray | None:
    if domain == "CORNER":
        return values[corners.loops]
    if domain == "FACE":
        return values[array(corners.mesh.loop_triangle_polygons, "value", np.int32)][:, None]
    if domain == "EDGE":
        values = _edges_on_vertices(corners, values)
    return values[corners.triangles] if domain in ("POINT", "EDGE") else None


def _edges_on_vertices(corners: Corners, values: np.ndarray) -> np.ndarray:
    """The mean over the edges of each vertex, as in Cycles."""
    ends = array(corners.mesh.edges, "vertices", np.int32, 2).ravel()
    count = len(corners.vertices)
    sums = [np.bincount(ends, np.repeat(column, 2), count) for column in values.T]
    return (np.stack(sums, axis=1) / np.maximum(np.bincount(ends, minlength=count), 1)[:, None]).astype(
        np.float32
    )


def _tangent_frame(corners: Corners, layer: str) -> np.ndarray | None:
    """(T, 3, 7) tangent along u, handedness, and normal; without any UV map, u is the longitude."""
    uv = _uv(corners, layer)
    positions = corners.vertices[corners.triangles]
    if uv is None and not layer and not len(corners.mesh.uv_layers):
        uv = np.moveaxis(longitude_latitude(np.moveaxis(positions, -1, 0)), 0, -1)
    if uv is None:
        return None
    flat = np.cross(positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0])
    normals = np.repeat(_unit(flat)[:, None], 3, axis=1) if corners.normals is None else corners.normals
    tangents, signs = tangents_along_u(positions, normals, uv)
    signs = np.repeat(signs[:, None, None], 3, axis=1)
    return np.concatenate([tangents, signs, normals], axis=2).astype(np.float32)


def tangents_along_u(
    positions: np.ndarray, normals: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3, 3) unit tangents and (T,) handedness of triangles, equal where corners are.

    The mean of the triangles around, weighted by their angles: M. Mikkelsen, "Simulation of Wrinkled Surfaces
    Revisited", 2008, whose tangent space normal maps are baked for.

    positions, normals : (T, 3, 3). uv : (T, 3, 2).
    """
    a, b = (positions[:, k] - positions[:, 0] for k in (1, 2))
    (ua, va), (ub, vb) = ((uv[:, k] - uv[:, 0]).T for k in (1, 2))
    area = ua * vb - va * ub
    sign = np.where(area > 0, np.float32(1), np.float32(-1))
    along_u = np.where(
        (area != 0)[:, None], (vb * sign)[:, None] * a - (va * sign)[:, None] * b, np.float32(0)
    )
    projected = _in_plane(np.repeat(along_u[:, None], 3, axis=1), normals)
    # The angle of each corner, as its normal sees it.
    to_next = _in_plane(np.roll(positions, -1, axis=1) - positions, normals)
    to_last = _in_plane(np.roll(positions, 1, axis=1) - positions, normals)
    angle = np.arccos(np.clip(_dot(to_next, to_last), -1, 1))

    same = np.broadcast_to(sign[:, None, None], uv[..., :1].shape)
    group = _fans(_welded(np.concatenate([positions, normals, uv, same], axis=2)))
    weighted = (projected * angle).reshape(-1, 3)
    sums = np.stack([np.bincount(group, column) for column in weighted.T], axis=1)
    sums[~sums.any(axis=1)] = (1, 0, 0)  # as Mikkelsen's code has it
    return _unit(sums)[group].reshape(positions.shape), sign


def _welded(corners: np.ndarray) -> np.ndarray:
    """(T, 3) a number for each of (T, 3, C) corners, the same for equal ones."""
    rows = np.ascontiguousarray(corners.reshape(-1, corners.shape[2]), np.float32)
    rows += np.float32(0)  # -0 is 0
    _, number = np.unique(rows.view(f"V{rows.itemsize * rows.shape[1]}").ravel(), return_inverse=True)
    return number.reshape(corners.shape[:2])


def _fans(vertex: np.ndarray) -> np.ndarray:
    """(3 T,) a number for each corner of (T, 3) vertices, the same where edges about a vertex join them."""
    start, end = vertex.ravel().astype(np.int64), np.roll(vertex, -1, axis=1).ravel().astype(np.int64)
    corner = np.arange(start.size)
    following = corner.reshape(-1, 3)[:, [1, 2, 0]].ravel()
    count = start.max() + 1
    edge, opposite = start * count + end, end * count + start
    order = np.argsort(edge, kind="stable")
    found = order[np.minimum(np.searchsorted(edge, opposite, sorter=order), corner.size - 1)]
    joined = edge[found] == opposite
    # An edge joins where it begins to where its opposite ends, and the other way round.
    at_start = np.where(joined, following[found], corner)
    at_end = np.empty_like(corner)
    at_end[following] = np.where(joined, found, following)
    group = corner
    while True:
        lowest = np.minimum(group, np.minimum(group[at_start], group[at_end]))
        lowest = lowest[lowest]
        if (lowest == group).all():
            return group
        group = lowest


def _in_plane(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Unit vectors, less what they have along the normals."""
    return _unit(vectors - normals * _dot(vectors, normals))


def _unit(vectors: np.ndarray) -> np.ndarray:
    lengths = np.sqrt(_dot(vectors, vectors))
    return vectors / np.where(lengths > 0, lengths, np.float32(1))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", a, b)[..., None]


_KINDS = {
    "object": _object,
    "generated": _generated,
    "uv": _uv,
    "color": _colour,
    "attribute": _generic,
    "tangent": _tangent_frame,
}


def array(collection: Any, attribute: str, dtype: Any, width: int = 1) -> np.ndarray:
    """(N,) or (N, width) of one attribute of a Blender collection."""
    values = np.empty(len(collection) * width, dtype)
    collection.foreach_get(attribute, values)
    return values.reshape(-1, width) if width > 1 else values
