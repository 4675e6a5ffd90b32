# SPDX-License-Identifier: GPL-3.0-or-later
"""Expressions over surface points: what a node graph becomes.

A value is evaluated for a whole batch of points. Numbers are (N,), colours and vectors (3, N) float32; what
is the same everywhere is () or (3, 1), so that NumPy's broadcasting serves both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from .points import ShadingPoints


class Value:
    """An expression; its dataclass fields are its inputs, which are values or constants, and its options."""

    def evaluate(self, points: ShadingPoints) -> np.ndarray:
        """() or (N,) for a number, (3, 1) or (3, N) for a colour or vector."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class Computed(Value):
    """``function`` of the arrays that ``inputs`` are at the points; see `compute`."""

    function: Callable[..., np.ndarray]
    inputs: tuple[Any, ...]

    def evaluate(self, points: ShadingPoints) -> np.ndarray:
        return _quietly(self.function, [value_at(value, points) for value in self.inputs])


@dataclass(frozen=True, eq=False)
class OfSurface(Value):
    """What ``read`` finds in the points themselves, such as their normals."""

    read: Callable[[ShadingPoints], np.ndarray]

    def evaluate(self, points: ShadingPoints) -> np.ndarray:
        return self.read(points)


@dataclass(frozen=True, eq=False)
class Attribute(Value):
    """(width, N) of the meshes' attribute ``name``, zeros where a mesh has none."""

    name: str
    width: int = 3

    def evaluate(self, points: ShadingPoints) -> np.ndarray:
        return points.attributes(self.name, self.width)


def compute(function: Callable[..., np.ndarray], *inputs: Any) -> Value | np.ndarray:
    """``function`` of values and constants: an expression, or its result where all inputs are constant."""
    if any(isinstance(value, Value) for value in inputs):
        return Computed(function, inputs)
    return _quietly(function, [constant(value) for value in inputs])


def value_at(value: Any, points: ShadingPoints) -> np.ndarray:
    """``value``, an expression or a constant, at the points; each expression is evaluated only once."""
    if isinstance(value, Value):
        return points.remembered(id(value), lambda: value.evaluate(points))
    return constant(value)


def constant(value: Any) -> np.ndarray:
    """A number as (), a colour or vector as (3, 1)."""
    array = np.asarray(value, np.float32)
    return array[:, None] if array.shape == (3,) else array


def attributes_of(expression: Any) -> set[str]:
    """Names of the mesh attributes that a value or closure asks for."""
    names: set[str] = set()
    seen: set[int] = set()
    pending = [expression]
    while pending:
        item = pending.pop()
        if isinstance(item, tuple):
            pending += item
        elif is_dataclass(item) and id(item) not in seen:
            seen.add(id(item))
            if isinstance(item, Attribute):
                names.add(item.name)
            pending += [getattr(item, field.name) for field in fields(item)]
    return names


def _quietly(function: Callable[..., np.ndarray], inputs: list[np.ndarray]) -> np.ndarray:
    # What is not finite is as Cycles has it: no reason to warn anyone.
    with np.errstate(all="ignore"):
        return np.asarray(function(*inputs), np.float32)
