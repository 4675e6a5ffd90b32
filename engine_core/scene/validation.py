# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks shared by the scene's dataclasses: every error names field, shape and value."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import SceneError


def _owner(instance: Any) -> str:
    kind, name = type(instance).__name__, getattr(instance, "name", "")
    return f'{kind} "{name}"' if name else kind


def fail(instance: Any, field: str, problem: str) -> SceneError:
    """The SceneError that names whose ``field`` has which ``problem``."""
    return SceneError(f"{_owner(instance)}: {field} {problem}")


def set_array(
    instance: Any,
    field: str,
    shape: tuple[int | None, ...],
    dtype: Any = np.float64,
    finite: bool = True,
) -> np.ndarray:
    """Replace a frozen dataclass' ``field`` by a read-only array of ``shape`` (None: any length)."""
    value = getattr(instance, field)
    try:
        array = np.asarray(value)
        if np.issubdtype(dtype, np.integer) and array.size and array.dtype != dtype:
            limits = np.iinfo(dtype)
            # Written so that NaN fails as well.
            if not (array.min() >= limits.min and array.max() <= limits.max):
                raise ValueError(f"values from {array.min()} to {array.max()}")
        array = np.asarray(array, dtype=dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise fail(instance, field, f"is no array of numbers ({error})") from None
    if array.ndim != len(shape) or any(
        n is not None and n != m for n, m in zip(shape, array.shape, strict=False)
    ):
        wanted = tuple("any" if n is None else n for n in shape)
        raise fail(instance, field, f"has shape {array.shape}, wanted {wanted}")
    if finite and not np.isfinite(array).all():
        bad = array[~np.isfinite(array)].flat[0]
        raise fail(instance, field, f"contains {bad} (shape {array.shape}); all values must be finite")
    if array.flags.writeable:
        array = array.view()
        array.flags.writeable = False
    object.__setattr__(instance, field, array)
    return array


def set_colour(instance: Any, field: str) -> np.ndarray:
    """Like `set_array` for an RGB triple; one number stands for grey."""
    if np.ndim(getattr(instance, field)) == 0:
        object.__setattr__(instance, field, np.full(3, getattr(instance, field), float))
    return set_array(instance, field, (3,))


def set_integer(instance: Any, field: str, low: int, high: int) -> int:
    """Replace ``field`` by an int in [low, high]; a fraction is cut off."""
    number = int(set_number(instance, field, low, high))
    object.__setattr__(instance, field, number)
    return number


def set_switch(instance: Any, field: str) -> bool:
    """Replace ``field`` by a bool."""
    value = getattr(instance, field)
    if np.ndim(value) != 0 or value not in (0, 1):
        raise fail(instance, field, f"is {value!r}, wanted True or False")
    object.__setattr__(instance, field, bool(value))
    return bool(value)


def set_number(
    instance: Any,
    field: str,
    low: float = -np.inf,
    high: float = np.inf,
    infinite: bool = False,
) -> float:
    """Replace ``field`` by a float in [low, high]."""
    value = getattr(instance, field)
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise fail(instance, field, f"is {value!r}, wanted a number") from None
    if np.isnan(number) or (np.isinf(number) and not infinite) or not low <= number <= high:
        raise fail(instance, field, f"is {number}, wanted a number in [{low:g}, {high:g}]")
    object.__setattr__(instance, field, number)
    return number
