# SPDX-License-Identifier: GPL-3.0-or-later
"""All triangles of a scene in a few arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..scene import Linking, Mesh
from .frame import Frame

# A shadow ray starts this many units in the last place of its triangle's largest coordinate above
# it: the rounding of the hit point, of Embree's own arithmetic and of the ray's direction together.
OFFSET_ULPS = 16.0


@dataclass(frozen=True, eq=False)
class Triangles:
    """Concatenated meshes, in the frame's units.

    vertices : (V, 3) float32.
    indices : (T, 3) int32.
    material : (T,) int32.
    offset : (T,) float32, how far a ray must start off the triangle to be safe from hitting it.
    smooth : (T,) int32, row of the triangle in ``normals``, -1 if flat; None if all are flat.
    normals : (S, 9) float32, the normal of corner 0 and the differences of corners 1 and 2 to it.
    terminator_offset : float32, scalar or (T,), Cycles' shadow terminator geometry offset.
    visible_to_camera, casts_shadow, holdout : (T,) bool, or a bool if all agree.
    light_set, shadow_set : (T,) int, or an int if all agree.
    linking : of each mesh.
    attributes : tables of what meshes have at their corners, by name.
    first : (M + 1,) int64, where each mesh begins.
    """

    vertices: np.ndarray
    indices: np.ndarray
    material: np.ndarray
    offset: np.ndarray
    smooth: np.ndarray | None
    normals: np.ndarray
    terminator_offset: np.ndarray
    visible_to_camera: np.ndarray | bool
    casts_shadow: np.ndarray | bool
    holdout: np.ndarray | bool
    light_set: np.ndarray | int
    shadow_set: np.ndarray | int
    linking: tuple[Linking, ...]
    attributes: dict[str, CornerTable]
    first: np.ndarray

    def __len__(self) -> int:
        return len(self.indices)

    def linked(self, triangle: np.ndarray) -> tuple[np.ndarray, list[Linking]]:
        """Of triangles (K,) the number of their meshes' linking, and all linkings by number."""
        number = {links: k for k, links in enumerate(dict.fromkeys(self.linking))}
        if len(number) == 1:
            return np.zeros(len(triangle), np.intp), list(number)
        of_mesh = np.array([number[links] for links in self.linking], np.intp)
        return of_mesh[np.searchsorted(self.first, triangle, side="right") - 1], list(number)

    def attribute(
        self, name: str, width: int, triangle: np.ndarray, u: np.ndarray, v: np.ndarray
    ) -> np.ndarray:
        """(width, N) float32 of an attribute at points of triangles (N,); 0 where a mesh has none.

        u, v : (N,) barycentric weights of corners 1 and 2.
        """
        if name not in self.attributes:
            return np.zeros((width, 1), np.float32)
        return self.attributes[name].at(width, triangle, u, v)


@dataclass(frozen=True, eq=False)
class CornerTable:
    """An attribute of some triangles.

    row : (T,) int32, row of each triangle, -1 where its mesh has none; None if row i is of triangle i.
    corners : (S, 3, C) float32, corner 0 and the differences of corners 1 and 2 to it, or (S, 1, C).
    """

    row: np.ndarray | None
    corners: np.ndarray

    def at(self, width: int, triangle: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        row = triangle if self.row is None else self.row.take(triangle)
        # Row -1 is the last one, whichever that is: it is put to 0 below.
        table = self.corners.take(row, axis=0, mode="wrap")
        value = np.zeros((width, len(triangle)), np.float32)
        for c in range(min(width, table.shape[2])):
            np.copyto(value[c], table[:, 0, c])
            if table.shape[1] == 3:
                value[c] += u * table[:, 1, c]
                value[c] += v * table[:, 2, c]
        if self.row is not None:
            value *= row >= 0
        return value


def gather_triangles(meshes: Sequence[Mesh], frame: Frame) -> tuple[Triangles, list[str]]:
    """The triangles of all ``meshes``, and a message for each mesh of which some had to be left out."""
    messages: list[str] = []
    parts = []
    for mesh in meshes:
        vertices = frame.positions(mesh.vertices)
        keep = _usable(mesh, vertices, messages)
        parts.append((mesh, vertices, keep))
    counts = [len(m.triangles) if keep is None else int(keep.sum()) for m, _, keep in parts]
    starts = np.cumsum([0] + [len(v) for _, v, _ in parts])

    def per_triangle(field: str, dtype: type) -> np.ndarray | bool | int | float:
        values = {getattr(mesh, field) for mesh, _, _ in parts}
        if len(values) == 1:
            return values.pop()
        return np.repeat(np.array([getattr(m, field) for m, _, _ in parts], dtype), counts)

    def select(array: np.ndarray, keep: np.ndarray | None) -> np.ndarray:
        return array if keep is None else array[keep]

    vertices = np.concatenate([v for _, v, _ in parts]) if parts else np.zeros((0, 3), np.float32)
    indices = np.zeros((sum(counts), 3), np.int32)
    material = np.zeros(sum(counts), np.int32)
    row = 0
    for (mesh, _, keep), start, count in zip(parts, starts, counts, strict=False):
        np.add(select(mesh.triangles, keep), start, out=indices[row : row + count], casting="unsafe")
        material[row : row + count] = select(np.broadcast_to(mesh.materials, len(mesh.triangles)), keep)
        row += count
    normals, smooth = _smooth_normals(parts, counts, select)
    size = np.abs(vertices).max(axis=1) if len(vertices) else np.zeros(0, np.float32)
    offset = np.maximum(size[indices[:, 0]], size[indices[:, 1]])
    np.maximum(offset, size[indices[:, 2]], out=offset)
    offset *= np.float32(OFFSET_ULPS * 2.0**-24)
    _tighten_offsets(vertices, indices, offset)
    triangles = Triangles(
        vertices,
        indices,
        material,
        offset,
        smooth,
        normals,
        np.asarray(per_triangle("terminator_offset", np.float32), np.float32),
        per_triangle("visible_to_camera", bool),
        per_triangle("casts_shadow", bool),
        per_triangle("holdout", bool),
        per_triangle("light_set", np.int16),
        per_triangle("shadow_set", np.int16),
        tuple(mesh.linking for mesh in meshes),
        _corner_tables(parts, counts, select),
        np.cumsum([0, *counts]),
    )
    return triangles, messages


def _tighten_offsets(vertices: np.ndarray, indices: np.ndarray, offset: np.ndarray) -> None:
    """Smaller offsets for triangles that reach far, such as a floor of kilometres.

    What rounding does to the distance from a plane is n . error: a coordinate counts only as far as the
    normal leans towards its axis, so that level ground has the offset of its height, not of its size.
    """
    # Typical vertices are 1 to 2 away: for all others the simple bound is small enough.
    row = np.flatnonzero(offset > 64 * OFFSET_ULPS * 2.0**-24)
    if row.size == 0:
        return
    corners = vertices[indices[row]].astype(np.float64)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.abs(np.cross(a, b))
    scale = normal.sum(axis=1, keepdims=True)
    # A normal's own rounding error in one axis grows with its smaller components.
    lean = normal / np.where(scale > 0, scale, 1)
    lean += np.sort(lean, axis=1)[:, :2].sum(axis=1, keepdims=True)
    lean = np.where(scale > 0, np.minimum(lean, 1), 1)
    bound = (lean * np.abs(corners).max(axis=1)).sum(axis=1) * (OFFSET_ULPS * 2.0**-24)
    offset[row] = np.minimum(offset[row], bound)


def _usable(mesh: Mesh, vertices: np.ndarray, messages: list[str]) -> np.ndarray | None:
    """Which triangles of ``mesh`` can be traced: (T,) bool, or None for all of them."""
    # One sum finds any NaN or Inf without an array of flags.
    if len(vertices) == 0 or (np.isfinite(vertices.sum()) and np.abs(vertices).max() < 1e17):
        return None
    good = (np.abs(vertices) < 1e17).all(axis=1)
    vertices[~good] = 0
    keep = good[mesh.triangles].all(axis=1)
    lost = len(keep) - int(keep.sum())
    if lost:
        messages.append(
            f'"{mesh.name}": {lost} of {len(keep)} triangles have a vertex that is not finite or too far '
            "away, and are left out; check its modifiers and its scale."
        )
    return keep


def _smooth_normals(parts, counts, select) -> tuple[np.ndarray, np.ndarray | None]:
    flat = [mesh.normals is None for mesh, _, _ in parts]
    rows = [
        select(mesh.normals, keep).reshape(-1, 9)
        for (mesh, _, keep), is_flat in zip(parts, flat, strict=True)
        if not is_flat
    ]
    if not rows:
        return np.zeros((0, 9), np.float32), None
    normals = np.concatenate(rows)
    if not np.isfinite(normals.sum()):
        normals[~np.isfinite(normals)] = 0
    normals[:, 3:6] -= normals[:, 0:3]
    normals[:, 6:9] -= normals[:, 0:3]
    smooth = np.empty(sum(counts), np.int32)
    row = triangle = 0
    for count, is_flat in zip(counts, flat, strict=True):
        if is_flat:
            smooth[triangle : triangle + count] = -1
        else:
            smooth[triangle : triangle + count] = np.arange(row, row + count, dtype=np.int32)
            row += count
        triangle += count
    return normals, smooth


def _corner_tables(parts, counts, select) -> dict[str, CornerTable]:
    tables = {}
    for name in sorted({name for mesh, _, _ in parts for name in mesh.attributes}):
        have = [(mesh.attributes.get(name), keep) for mesh, _, keep in parts]
        each = 3 if any(values is not None and values.shape[1] == 3 for values, _ in have) else 1
        width = max(values.shape[2] for values, _ in have if values is not None)
        size = sum(count for count, (values, _) in zip(counts, have, strict=True) if values is not None)
        if size == 0:
            continue
        corners = np.zeros((size, each, width), np.float32)
        row = None if size == sum(counts) else np.full(sum(counts), -1, np.int32)
        filled = triangle = 0
        for count, (values, keep) in zip(counts, have, strict=True):
            if values is not None:
                part = corners[filled : filled + count, :, : values.shape[2]]
                part[:] = select(values, keep)
                part[:, 1:] -= part[:, :1]
                if row is not None:
                    row[triangle : triangle + count] = np.arange(filled, filled + count, dtype=np.int32)
                filled += count
            triangle += count
        if not np.isfinite(corners.sum()):
            corners[~np.isfinite(corners)] = 0
        tables[name] = CornerTable(row, corners)
    return tables
