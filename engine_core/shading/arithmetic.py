# SPDX-License-Identifier: GPL-3.0-or-later
"""Arithmetic of nodes: what Math, Vector Math, Map Range and their like compute, as Cycles defines it.

Numbers are () or (N,), vectors (3, 1) or (3, N). Nothing divides by zero: such a quotient is 0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry.vectors import dot, length


def divide(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(b != 0, a / b, np.float32(0))


def power(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a^b; x^0 is 1, any other power of 0 is 0, and so is a root of a negative number."""
    undefined = (a == 0) | ((a < 0) & (b != np.trunc(b)))
    return np.where(b == 0, np.float32(1), np.where(undefined, np.float32(0), np.power(a, b)))


def wrap(value: np.ndarray, high: np.ndarray, low: np.ndarray) -> np.ndarray:
    """``value`` moved by whole ranges into [low, high)."""
    span = high - low
    return np.where(span != 0, value - span * np.floor((value - low) / span), low)


def mix(factor: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Linear from a to b, exact at both ends."""
    return (1 - factor) * a + factor * b


def clip(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Into [low, high], and ``high`` where these are the wrong way round."""
    return np.minimum(np.maximum(value, low), high)


def clip_range(value: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Into the range between a and b, whichever is larger."""
    return clip(value, np.minimum(a, b), np.maximum(a, b))


def saturate(value: np.ndarray) -> np.ndarray:
    return np.clip(value, 0, 1)


def unit(a: np.ndarray) -> np.ndarray:
    """(3, ...) at length 1; a null vector stays one."""
    return divide(a, length(a))


def as_vector(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """(3, 1) or (3, N) of three numbers."""
    return np.stack(np.broadcast_arrays(*np.atleast_1d(x, y, z)))


def replicated(number: np.ndarray) -> np.ndarray:
    """(3, 1) or (3, N) with a number in each component."""
    return as_vector(number, number, number)


def component(which: int, vector: np.ndarray) -> np.ndarray:
    """A number of a vector; one that is constant stays ()."""
    return vector[which, 0] if vector.shape[-1] == 1 else vector[which]


def average(vector: np.ndarray) -> np.ndarray:
    return number((vector[0] + vector[1] + vector[2]) / 3)


def number(a: np.ndarray) -> np.ndarray:
    """() for what is (1,) because its inputs are constant vectors."""
    return a[0] if a.shape == (1,) else a


def _smooth_minimum(a: np.ndarray, b: np.ndarray, distance: np.ndarray) -> np.ndarray:
    h = divide(np.maximum(distance - np.abs(a - b), 0), distance)
    return np.minimum(a, b) - h * h * h * distance / 6


def _fraction(a: np.ndarray) -> np.ndarray:
    return a - np.floor(a)


def _floored_modulo(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(b != 0, a - np.floor(a / b) * b, 0)


def _ping_pong(a: np.ndarray, scale: np.ndarray) -> np.ndarray:
    return np.where(scale != 0, np.abs(_fraction((a - scale) / (scale * 2)) * scale * 2 - scale), 0)


def _compare(a: np.ndarray, b: np.ndarray, epsilon: np.ndarray) -> np.ndarray:
    return (a == b) | (np.abs(a - b) <= np.maximum(epsilon, np.finfo(np.float32).eps))


MATH = {
    "ADD": lambda a, b, c: a + b,
    "SUBTRACT": lambda a, b, c: a - b,
    "MULTIPLY": lambda a, b, c: a * b,
    "DIVIDE": lambda a, b, c: divide(a, b),
    "MULTIPLY_ADD": lambda a, b, c: a * b + c,
    "POWER": lambda a, b, c: power(a, b),
    "LOGARITHM": lambda a, b, c: np.where((a > 0) & (b > 0), divide(np.log(a), np.log(b)), 0),
    "SQRT": lambda a, b, c: np.sqrt(np.maximum(a, 0)),
    "INVERSE_SQRT": lambda a, b, c: np.where(a > 0, 1 / np.sqrt(a), 0),
    "ABSOLUTE": lambda a, b, c: np.abs(a),
    "EXPONENT": lambda a, b, c: np.exp(a),
    "MINIMUM": lambda a, b, c: np.minimum(a, b),
    "MAXIMUM": lambda a, b, c: np.maximum(a, b),
    "LESS_THAN": lambda a, b, c: a < b,
    "GREATER_THAN": lambda a, b, c: a > b,
    "SIGN": lambda a, b, c: np.sign(a),
    "COMPARE": _compare,
    "SMOOTH_MIN": _smooth_minimum,
    "SMOOTH_MAX": lambda a, b, c: -_smooth_minimum(-a, -b, c),
    "ROUND": lambda a, b, c: np.floor(a + np.float32(0.5)),
    "FLOOR": lambda a, b, c: np.floor(a),
    "CEIL": lambda a, b, c: np.ceil(a),
    "TRUNC": lambda a, b, c: np.trunc(a),
    "FRACT": lambda a, b, c: _fraction(a),
    "MODULO": lambda a, b, c: np.where(b != 0, np.fmod(a, b), 0),
    "FLOORED_MODULO": lambda a, b, c: _floored_modulo(a, b),
    "WRAP": wrap,
    "SNAP": lambda a, b, c: np.floor(divide(a, b)) * b,
    "PINGPONG": lambda a, b, c: _ping_pong(a, b),
    "SINE": lambda a, b, c: np.sin(a),
    "COSINE": lambda a, b, c: np.cos(a),
    "TANGENT": lambda a, b, c: np.tan(a),
    "ARCSINE": lambda a, b, c: np.arcsin(np.clip(a, -1, 1)),
    "ARCCOSINE": lambda a, b, c: np.arccos(np.clip(a, -1, 1)),
    "ARCTANGENT": lambda a, b, c: np.arctan(a),
    "ARCTAN2": lambda a, b, c: np.arctan2(a, b),
    "SINH": lambda a, b, c: np.sinh(a),
    "COSH": lambda a, b, c: np.cosh(a),
    "TANH": lambda a, b, c: np.tanh(a),
    "RADIANS": lambda a, b, c: np.radians(a),
    "DEGREES": lambda a, b, c: np.degrees(a),
}
"""Operations of the Math node by Blender's names: functions of three numbers."""


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def reflect(incident: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return incident - 2 * dot(normal, incident) * normal


def _refract(incident: np.ndarray, normal: np.ndarray, eta: np.ndarray) -> np.ndarray:
    cosine = dot(normal, incident)
    k = 1 - eta * eta * (1 - cosine * cosine)
    return np.where(k < 0, 0, eta * incident - (eta * cosine + np.sqrt(np.maximum(k, 0))) * normal)


_BY_COMPONENT = """
    ADD SUBTRACT MULTIPLY DIVIDE MULTIPLY_ADD SNAP FLOOR CEIL ROUND MODULO WRAP ABSOLUTE POWER SIGN
    MINIMUM MAXIMUM SINE COSINE TANGENT
"""


def _of_components(operation: Callable[..., np.ndarray]) -> Callable[..., np.ndarray]:
    return lambda a, b, c, scale: operation(a, b, c)


VECTOR_MATH = {
    **{name: _of_components(MATH[name]) for name in _BY_COMPONENT.split()},
    "FRACTION": lambda a, b, c, scale: _fraction(a),
    "CROSS_PRODUCT": lambda a, b, c, scale: cross(a, b),
    "PROJECT": lambda a, b, c, scale: divide(dot(a, b), dot(b, b)) * b,
    "REFLECT": lambda a, b, c, scale: reflect(a, unit(b)),
    "REFRACT": lambda a, b, c, scale: _refract(a, unit(b), scale),
    "FACEFORWARD": lambda a, b, c, scale: np.where(dot(c, b) < 0, a, -a),
    "DOT_PRODUCT": lambda a, b, c, scale: number(dot(a, b)),
    "DISTANCE": lambda a, b, c, scale: number(length(a - b)),
    "LENGTH": lambda a, b, c, scale: number(length(a)),
    "SCALE": lambda a, b, c, scale: a * scale,
    "NORMALIZE": lambda a, b, c, scale: unit(a),
}
"""Operations of the Vector Math node by Blender's names: functions of three vectors and a number."""


def _smooth_step(x: np.ndarray) -> np.ndarray:
    return x * x * (3 - 2 * x)


def _smoother_step(x: np.ndarray) -> np.ndarray:
    return x * x * x * (x * (x * 6 - 15) + 10)


def map_range(
    kind: str,
    clamped: bool,
    value: np.ndarray,
    from_min: np.ndarray,
    from_max: np.ndarray,
    to_min: np.ndarray,
    to_max: np.ndarray,
    steps: np.ndarray,
) -> np.ndarray:
    """From one range to another, for numbers and for vectors; an empty range is where it begins."""
    factor = divide(value - from_min, from_max - from_min)
    if kind == "STEPPED":
        factor = np.where(steps > 0, np.floor(factor * (steps + 1)) / steps, 0)
    elif kind == "SMOOTHSTEP":
        factor = _smooth_step(saturate(factor))
    elif kind == "SMOOTHERSTEP":
        factor = _smoother_step(saturate(factor))
    result = to_min + factor * (to_max - to_min)
    return clip_range(result, to_min, to_max) if clamped else result
