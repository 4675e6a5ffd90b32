# SPDX-License-Identifier: GPL-3.0-or-later
"""Instances: one mesh at many places becomes triangles in one array operation, its memory foreseen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ...engine_core import Mesh, RenderError
from ...engine_core.geometry.joined_bodies import apart
from ...engine_core.scene import Light, Linking
from .. import memory
from .mesh import MeshData

CHUNK = 1 << 20
"""Vertices placed at a time: bounds what float64 needs beside the result."""

TRACED_TRIANGLE_BYTES = 250
"""What a triangle takes beside the exported arrays: the ray tracer's copy and tree, the engine's tables."""

TRACER_BYTES = 100
"""What a triangle takes in each further ray tracer; each different group of blockers has one."""

MANY_BODIES = 16
"""Instances that enclose a volume, each as a mesh of its own: more of them are joined where they can be."""


class Looks(NamedTuple):
    """What decides how a mesh is seen: fields of `engine_core.Mesh`."""

    visible_to_camera: bool
    casts_shadow: bool
    holdout: bool
    terminator_offset: float
    light_set: int
    shadow_set: int
    linking: Linking


@dataclass
class Placed:
    """A mesh, how it is seen, and all the places where it stands.

    name : of the first object that has it.
    slots : (S,) int32, the scene's number of the material in each of the object's slots.
    volume, surface : as of `engine_core.Mesh`.
    matrices : a (4, 4) object-to-world matrix for each instance.
    """

    name: str
    mesh: MeshData
    looks: Looks
    slots: np.ndarray
    volume: int = -1
    surface: bool = True
    matrices: list[Any] = field(default_factory=list)

    @property
    def materials(self) -> np.ndarray:
        """() or (T,) int32: the scene's number of the material of one instance's triangles."""
        # An index beyond the slots means the last one, as in Cycles.
        return self.slots[np.clip(self.mesh.slots, 0, len(self.slots) - 1)]

    def bytes_needed(self, tracers: int = 0) -> int:
        """tracers : further ones, as `TRACER_BYTES` has it."""
        mesh, each = self.mesh, self.mesh.vertices.nbytes + self.mesh.triangles.nbytes
        each += len(mesh.triangles) * (
            TRACED_TRIANGLE_BYTES + TRACER_BYTES * tracers + 4 * np.ndim(mesh.slots)
        )
        if mesh.normals is not None:
            each += mesh.normals.nbytes + 3 * mesh.triangles.nbytes
        # Twice: exported, and in the engine's tables. A placed attribute is at most 9 numbers wide.
        each += 2 * sum(values.nbytes for values in mesh.attributes.values())
        each += 2 * 36 * len(mesh.triangles) * len(mesh.placed)
        return each * len(self.matrices)

    def meshes(self, origin: np.ndarray) -> list[Mesh]:
        """The engine's meshes, their positions less ``origin`` ((3,) float64).

        All instances in one; but each by itself if they enclose a volume, which adds up where they overlap.
        Of many, those that keep clear of each other share a mesh, as the engine follows some dozens.
        """
        sets = [self.matrices]
        if self.volume >= 0:
            sets = [[matrix] for matrix in self.matrices]
            if len(sets) > MANY_BODIES:
                sets = [[self.matrices[i] for i in some] for some in apart(self._boxes())]
        return [self._placed(matrices, origin) for matrices in sets]

    def _boxes(self) -> np.ndarray:
        """(I, 2, 3) lowest and highest coordinates of each instance."""
        vertices = self.mesh.vertices[np.isfinite(self.mesh.vertices).all(axis=1)].astype(np.float64)
        placed = (np.array(matrix, np.float64) for matrix in self.matrices)
        points = (vertices @ matrix[:3, :3].T + matrix[:3, 3] for matrix in placed)
        return np.stack([(p.min(axis=0), p.max(axis=0)) if len(p) else np.zeros((2, 3)) for p in points])

    def _placed(self, instances: list[Any], origin: np.ndarray) -> Mesh:
        matrices = np.array(instances, np.float64).reshape(-1, 4, 4)
        matrices[:, :3, 3] -= origin
        count, mesh = len(matrices), self.mesh
        mirrored = np.linalg.det(matrices[:, :3, :3]) < 0
        triangles = _repeated(mesh.triangles, count, len(mesh.vertices), mirrored)
        normals = None
        if mesh.normals is not None:
            table = _unit(_transformed(mesh.normals, _normal_matrices(matrices)))
            normals = table.take(_repeated(mesh.normal_indices, count, len(mesh.normals), mirrored), axis=0)
        materials = self.materials
        vertices = _transformed(mesh.vertices, matrices[:, :3])
        attributes = {name: _tiled(values, count, mirrored) for name, values in mesh.attributes.items()}
        if "world" in mesh.placed:
            attributes["world"] = (vertices + origin).astype(np.float32).take(triangles, axis=0)
        if "object_to_world" in mesh.placed:
            columns = matrices[:, :3, :3].transpose(0, 2, 1).reshape(-1, 1, 9).astype(np.float32)
            attributes["object_to_world"] = columns.repeat(len(mesh.triangles), axis=0)
        return Mesh(
            vertices=vertices,
            triangles=triangles,
            normals=normals,
            materials=np.tile(materials, count) if materials.ndim else materials,
            name=self.name,
            attributes=attributes,
            volume=self.volume,
            surface=self.surface,
            **self.looks._asdict(),
        )


def check_memory(groups: Sequence[Placed], lights: Sequence[Light] = ()) -> None:
    """Refuse to start what would not end well; the error names the object that takes most."""
    tracers = len({light.linking.blockers for light in lights} - {None})
    needed, available = sum(group.bytes_needed(tracers) for group in groups), memory.available()
    if needed <= available:
        return
    largest = max(groups, key=Placed.bytes_needed)
    count, triangles = len(largest.matrices), len(largest.mesh.triangles)
    raise RenderError(
        f"The triangles need {needed / 2**30:.1f} GiB of memory, {available / 2**30:.1f} GiB are free. "
        f'Most goes to object "{largest.name}" ({count:,} times {triangles:,} triangles): '
        "use fewer instances or a simpler mesh (Decimate modifier, or Simplify in Render properties)"
    )


def _transformed(points: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """(I * V, 3) float32: every one of (V, 3) ``points`` through every one of (I, 3, 3 or 4) ``matrices``."""
    points = np.asarray(points, np.float64)
    if matrices.shape[2] == 4:
        points = np.column_stack([points, np.ones(len(points))])
    result = np.empty((len(matrices), len(points), 3), np.float32)
    step = max(1, CHUNK // len(points))
    for start in range(0, len(matrices), step):
        part = matrices[start : start + step]
        products = part.reshape(-1, part.shape[2]) @ points.T
        result[start : start + step] = products.reshape(len(part), 3, -1).transpose(0, 2, 1)
    return result.reshape(-1, 3)


def _normal_matrices(matrices: np.ndarray) -> np.ndarray:
    """(I, 3, 3) inverse transposes, but for a positive factor: cofactors exist for singular matrices too."""
    x, y, z = (matrices[:, :3, k] for k in range(3))
    cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=2)
    return cofactors * np.where(np.linalg.det(matrices[:, :3, :3]) < 0, -1.0, 1.0)[:, None, None]


def _unit(normals: np.ndarray) -> np.ndarray:
    lengths = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    normals /= np.where(lengths > 0, lengths, np.float32(1))[:, None]
    return normals


def _repeated(indices: np.ndarray, count: int, step: int, mirrored: np.ndarray) -> np.ndarray:
    """(I * T, 3) int32: ``indices`` of each instance, moved on by ``step``, turned round if mirrored."""
    offsets = step * np.arange(count, dtype=np.int32)
    result = indices[None] + offsets[:, None, None]
    result[mirrored] = result[mirrored][:, :, ::-1]
    return result.reshape(-1, 3)


def _tiled(values: np.ndarray, count: int, mirrored: np.ndarray) -> np.ndarray:
    """(I * T, 3 or 1, C): an attribute of each instance, its corners as `_repeated` turns them."""
    result = np.tile(values[None], (count, 1, 1, 1))
    result[mirrored] = result[mirrored][:, :, ::-1]
    return result.reshape(-1, *values.shape[1:])
