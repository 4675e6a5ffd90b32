# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures: images, checkers and gradients over coordinates (3, 1) or (3, N)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.vectors import dot, take
from .arithmetic import number, saturate
from .colour import srgb_to_linear

FAR = np.float32(1e9)
"""Texels beyond this are as good as at it, and fit an int."""


@dataclass(frozen=True, eq=False)
class ImagePixels:
    """An image as it is stored.

    pixels : (H, W, 4) float32, or uint8 of which 255 means 1; row 0 is the bottom.
    encoded : whether colours are sRGB, which are decoded after they are interpolated, as in Cycles.
    premultiplied : whether colours are multiplied with alpha.
    """

    pixels: np.ndarray
    encoded: bool = False
    premultiplied: bool = False

    def linear(self) -> np.ndarray:
        """(H, W, 4) float32, scene linear colours."""
        pixels = self.pixels.astype(np.float32)
        if self.pixels.dtype == np.uint8:
            pixels *= np.float32(1 / 255)
        if self.encoded:
            pixels[..., :3] = srgb_to_linear(pixels[..., :3])
        return pixels


def image_texture(
    image: ImagePixels, interpolation: str, extension: str, opaque: bool, coordinates: np.ndarray
) -> np.ndarray:
    """(4, N) scene linear colour and alpha at the first two ``coordinates``; (0, 1) spans the image.

    interpolation : "Closest", "Linear" or "Cubic".
    extension : what is beyond the image: "REPEAT", "EXTEND" (its edge), "CLIP" (nothing) or "MIRROR".
    opaque : whether nobody asks for alpha, so that premultiplied colours stay so.
    """
    height, width = image.pixels.shape[:2]
    texels = image.pixels.reshape(-1, 4)
    columns = _taps(coordinates[0], width, interpolation, extension)
    rows = _taps(coordinates[1], height, interpolation, extension)
    total = np.zeros((coordinates.shape[1], 4), np.float32)
    for row, row_weight in rows:
        for column, column_weight in columns:
            texel = texels.take(row * width + column, axis=0)
            total += texel * (row_weight * column_weight)[:, None]
    colour = np.ascontiguousarray(total.T)
    if image.pixels.dtype == np.uint8:
        colour *= np.float32(1 / 255)
    if image.premultiplied and not opaque:
        colour[:3] /= np.where(colour[3] == 0, np.float32(1), colour[3])
    if image.encoded:
        colour[:3] = srgb_to_linear(colour[:3])
    return colour


def _taps(
    coordinate: np.ndarray, size: int, interpolation: str, extension: str
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Along one axis, the texels (N,) that are averaged, and their weights (N,)."""
    place = np.clip(np.nan_to_num(coordinate * np.float32(size)), -FAR, FAR)
    if interpolation == "Closest":
        first, weights = np.floor(place), [np.ones_like(place)]
    else:
        place = place - np.float32(0.5)
        first = np.floor(place)
        t = place - first
        if interpolation == "Cubic":
            weights = _cubic_spline(t)
            first = first - 1
        else:
            weights = [1 - t, t]
    first = first.astype(np.int64)
    taps = []
    for step, weight in enumerate(weights):
        texel = first + step
        if extension == "CLIP":
            weight = weight * ((texel >= 0) & (texel < size))
        taps.append((_EXTENSIONS[extension](texel, size), weight))
    return taps


def _cubic_spline(t: np.ndarray) -> list[np.ndarray]:
    """Weights of four texels, of which the second is at t = 0: the uniform B-spline."""
    s = 1 - t
    sixth = np.float32(1 / 6)
    return [
        s * s * s * sixth,
        (t * t * (t * 3 - 6) + 4) * sixth,
        (s * s * (s * 3 - 6) + 4) * sixth,
        t * t * t * sixth,
    ]


def _mirrored(texel: np.ndarray, size: int) -> np.ndarray:
    place = texel % (2 * size)
    return np.minimum(place, 2 * size - 1 - place)


_EXTENSIONS = {
    "REPEAT": lambda texel, size: texel % size,
    "EXTEND": lambda texel, size: np.clip(texel, 0, size - 1),
    "CLIP": lambda texel, size: np.clip(texel, 0, size - 1),
    "MIRROR": _mirrored,
}


def on_sphere(p: np.ndarray) -> np.ndarray:
    """Image coordinates (2, ...) of points in the unit box, seen from its centre."""
    return longitude_latitude(2 * p - 1)


def longitude_latitude(p: np.ndarray) -> np.ndarray:
    """(2, ...) in [0, 1] of points about the origin."""
    x, y, z = p
    radius = np.sqrt(x * x + y * y + z * z)
    u = np.where((x == 0) & (y == 0), 0, np.float32(0.5) - np.arctan2(x, y) * np.float32(0.5 / np.pi))
    v = 1 - np.arccos(np.clip(z / np.where(radius > 0, radius, 1), -1, 1)) * np.float32(1 / np.pi)
    return np.where(radius > 0, np.stack([u, v]), np.float32(0))


def on_tube(p: np.ndarray) -> np.ndarray:
    """Image coordinates (2, ...) of points in the unit box, seen from its axis."""
    x, y, z = 2 * p - 1
    u = np.float32(0.5) - np.arctan2(x, y) * np.float32(0.5 / np.pi)
    return np.where((x != 0) | (y != 0), np.stack([u, (z + 1) / 2]), 0)


def flat(p: np.ndarray) -> np.ndarray:
    return p


PROJECTIONS = {"FLAT": flat, "SPHERE": on_sphere, "TUBE": on_tube}


def box_texture(
    image: ImagePixels,
    interpolation: str,
    extension: str,
    opaque: bool,
    blend: float,
    p: np.ndarray,
    normal: np.ndarray,
) -> np.ndarray:
    """(4, N) an image projected along the three axes, blended about the edges of a cube.

    normal : (3, N), in the object's space.
    """
    p, normal = np.broadcast_arrays(p, normal)
    x, y, z = p
    sides = (
        np.stack([np.where(normal[0] < 0, 1 - y, y), z]),
        np.stack([np.where(normal[1] > 0, 1 - x, x), z]),
        np.stack([np.where(normal[2] > 0, 1 - y, y), x]),
    )
    colour = np.zeros((4, p.shape[1]), np.float32)
    for weight, side in zip(_box_weights(normal, np.float32(blend)), sides, strict=True):
        lit = np.flatnonzero(weight > 0)
        if lit.size:
            seen = image_texture(image, interpolation, extension, opaque, take(side, lit))
            colour[:, lit] += seen * weight[lit]
    return colour


def _box_weights(normal: np.ndarray, blend: np.float32) -> np.ndarray:
    """(3, N) of the sides of a cube: one of them, or mixes of two or three near edges and corners."""
    n = np.abs(normal)
    n = n / n.sum(axis=0)
    x, y, z = n
    limit = np.float32(0.5) * (1 + blend)
    zero, one = np.zeros_like(x), np.ones_like(x)
    alone = [
        (x > limit * (x + y)) & (x > limit * (x + z)),
        (y > limit * (x + y)) & (y > limit * (y + z)),
        (z > limit * (x + z)) & (z > limit * (y + z)),
    ]
    single = [np.stack([one, zero, zero]), np.stack([zero, one, zero]), np.stack([zero, zero, one])]
    if blend <= 0:
        return np.select(alone, single, single[0])

    def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return saturate((a / (a + b) - np.float32(0.5) * (1 - blend)) / blend)

    xy, yz, xz = between(x, y), between(y, z), between(x, z)
    near = 1 - limit
    pairs = [z < near * (x + y), x < near * (y + z), y < near * (x + z)]
    doubles = [np.stack([xy, 1 - xy, zero]), np.stack([zero, yz, 1 - yz]), np.stack([xz, zero, 1 - xz])]
    triple = ((2 - limit) * n + (limit - 1)) / (2 * limit - 1)
    return np.select(alone + pairs, single + doubles, triple)


def checker(p: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """1 or 0 in cubes of size 1 / scale."""
    # Cycles' own guard against coordinates that lie on a border.
    cell = np.floor((p * scale + np.float32(1e-6)) * np.float32(0.999999))
    x, y, z = np.abs(np.clip(np.nan_to_num(cell), -FAR, FAR)).astype(np.int64) % 2
    return number(((x == y) == z.astype(bool)).astype(np.float32))


def _easing(x: np.ndarray) -> np.ndarray:
    r = saturate(x)
    return r * r * (3 - 2 * r)


def _ball(p: np.ndarray) -> np.ndarray:
    # The bias of Cycles, so that a unit vector gives exactly 0.
    return np.maximum(np.float32(0.999999) - np.sqrt(dot(p, p)), 0)


_GRADIENTS = {
    "LINEAR": lambda p: p[0],
    "QUADRATIC": lambda p: np.maximum(p[0], 0) ** 2,
    "EASING": lambda p: _easing(p[0]),
    "DIAGONAL": lambda p: (p[0] + p[1]) * np.float32(0.5),
    "RADIAL": lambda p: np.arctan2(p[1], p[0]) * np.float32(0.5 / np.pi) + np.float32(0.5),
    "QUADRATIC_SPHERE": lambda p: _ball(p) ** 2,
    "SPHERICAL": _ball,
}


def gradient(kind: str, p: np.ndarray) -> np.ndarray:
    """In [0, 1], by Blender's names of gradients."""
    return number(saturate(_GRADIENTS[kind](p)))
