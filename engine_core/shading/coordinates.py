# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinates: what a surface point says of itself, and how vectors are moved and turned."""

from __future__ import annotations

import numpy as np

from ..geometry.vectors import dot
from .arithmetic import as_vector, cross, divide, unit
from .values import Attribute, OfSurface, Value, compute

POSITION = Attribute("world")
"""In world space, not less `Scene.origin`."""

GENERATED = Attribute("generated")
OBJECT = Attribute("object")
OBJECT_TO_WORLD = Attribute("object_to_world", 9)
"""The columns of the object's matrix, without its translation."""

NORMAL = OfSurface(lambda points: points.normal)
GEOMETRIC = OfSurface(lambda points: points.geometric)
TOWARDS_VIEWER = OfSurface(lambda points: points.towards_viewer)
BACK = OfSurface(lambda points: points.back.astype(np.float32))


def uv(layer: str) -> Value:
    """(3, N) of a UV map, "" meaning the one that is active for renders."""
    return compute(lambda flat: as_vector(flat[0], flat[1], np.float32(0)), Attribute(f"uv:{layer}", 2))


def to_world(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A direction of the object's space, through ``matrix`` (9, ...)."""
    return matrix[0:3] * vector[0] + matrix[3:6] * vector[1] + matrix[6:9] * vector[2]


def to_object(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """The inverse of `to_world`; null where that has none."""
    x, y, z = matrix[0:3], matrix[3:6], matrix[6:9]
    cofactors = (cross(y, z), cross(z, x), cross(x, y))
    return divide(np.stack([dot(c, vector) for c in cofactors]), dot(x, cofactors[0]))


def normal_to_world(matrix: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """A normal of the object's space, unit: through the inverse transpose."""
    x, y, z = matrix[0:3], matrix[3:6], matrix[6:9]
    turned = cross(y, z) * normal[0] + cross(z, x) * normal[1] + cross(x, y) * normal[2]
    return unit(turned * np.sign(dot(x, cross(y, z))))


def normal_to_object(matrix: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """A world-space normal in the object's space, unit."""
    return unit(np.stack([dot(matrix[3 * k : 3 * k + 3], normal) for k in range(3)]))


def transform(matrix: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(3, ...) points through a constant (3, 4) matrix."""
    rows = matrix.astype(np.float32)
    return np.stack([r[0] * point[0] + r[1] * point[1] + r[2] * point[2] + r[3] for r in rows])


def reflection(towards_viewer: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Where a mirror would show what is seen."""
    return 2 * dot(normal, towards_viewer) * normal - towards_viewer


def rotation(euler: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns (3, ...) of the rotation about x, then y, then z, by angles (3, ...)."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(euler), np.cos(euler)
    return (
        np.stack([cy * cz, cy * sz, -sy]),
        np.stack([sy * sx * cz - cx * sz, sy * sx * sz + cx * cz, cy * sx]),
        np.stack([sy * cx * cz + sx * sz, sy * cx * sz - sx * cz, cy * cx]),
    )


def rotated(columns: tuple[np.ndarray, ...], vector: np.ndarray) -> np.ndarray:
    return columns[0] * vector[0] + columns[1] * vector[1] + columns[2] * vector[2]


def rotated_back(columns: tuple[np.ndarray, ...], vector: np.ndarray) -> np.ndarray:
    return np.stack([dot(column, vector) for column in columns])


def mapping(
    kind: str, vector: np.ndarray, location: np.ndarray, euler: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """The Mapping node: ``kind`` is "POINT", "TEXTURE" (its inverse), "VECTOR" or "NORMAL"."""
    columns = rotation(euler)
    if kind == "TEXTURE":
        return divide(rotated_back(columns, vector - location), scale)
    if kind == "NORMAL":
        return unit(rotated(columns, divide(vector, scale)))
    turned = rotated(columns, vector * scale)
    return turned + location if kind == "POINT" else turned


def rotate_about(
    invert: bool, vector: np.ndarray, centre: np.ndarray, axis: np.ndarray, angle: np.ndarray
) -> np.ndarray:
    """About an axis of any length through ``centre``, by Rodrigues' formula; not at all about a null axis."""
    v, k = vector - centre, unit(axis)
    c, s = np.cos(angle), np.sin(angle) * (-1 if invert else 1)
    turned = v * c + cross(*np.broadcast_arrays(k, v)) * s + k * dot(k, v) * (1 - c)
    return np.where(dot(k, k) > 0, turned + centre, vector)


def rotate_by_euler(invert: bool, vector: np.ndarray, centre: np.ndarray, euler: np.ndarray) -> np.ndarray:
    turn = rotated_back if invert else rotated
    return turn(rotation(euler), vector - centre) + centre


def radial_tangent(axis: str) -> Value:
    """(3, N) unit tangent about an axis of the object's texture space, as Cycles has it by default ("Z")."""

    def about(generated: np.ndarray, matrix: np.ndarray, normal: np.ndarray) -> np.ndarray:
        x, y, z = generated - np.float32(0.5)
        zero = np.zeros_like(x)
        around = {"X": (zero, -z, y), "Y": (-z, zero, x), "Z": (-y, x, zero)}[axis]
        return perpendicular(normal_to_world(matrix, np.stack(around)), normal)

    return compute(about, GENERATED, OBJECT_TO_WORLD, NORMAL)


def perpendicular(tangent: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The part of a tangent that lies in the surface, unit."""
    return cross(normal, unit(cross(tangent, normal)))
