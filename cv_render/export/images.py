# SPDX-License-Identifier: GPL-3.0-or-later
"""Images: Blender's pixels, as Cycles takes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...engine_core.shading.colour import linear_to_srgb
from ...engine_core.shading.textures import ImagePixels
from .messages import Messages

MISSING = ImagePixels(np.array([[[1, 0, 1, 1]]], np.float32))
"""Cycles' magenta."""

CODED, LINEAR = ("sRGB",), ("Linear Rec.709", "Linear", "scene_linear", "Non-Color", "Raw")
"""Colour spaces that need no colour management: their names from 4.2 to today."""

NOT_YET = {
    "TILED": "only the first tile is used",
    "SEQUENCE": "image sequences are not supported yet, one picture is used",
    "MOVIE": "movies are not supported yet, one picture is used",
}


def read_image(image: Any | None, messages: Messages, owner: str) -> np.ndarray:
    """(H, W, 4) float32 scene linear pixels of a Blender image, row 0 at the bottom; see `stored_image`."""
    return stored_image(image, messages, owner).linear()


def stored_image(image: Any | None, messages: Messages, owner: str) -> ImagePixels:
    """The pixels of a Blender image; one that is magenta if it is missing; ``owner`` is who uses it."""
    if image is None:
        return MISSING
    name = f'image "{image.name}"'
    if image.source in NOT_YET:
        messages.add(owner, f"{name}: {NOT_YET[image.source]}")
    pixels = _pixels(image)
    if pixels is None:
        messages.add(owner, f'{name} is missing ("{image.filepath}"), it is magenta')
        return MISSING
    if not np.isfinite(pixels.sum()):
        pixels[~np.isfinite(pixels)] = 0
    space = image.colorspace_settings
    data = getattr(space, "is_data", space.name in ("Non-Color", "Raw"))
    if image.alpha_mode == "NONE":
        pixels[..., 3] = 1
    opaque = bool((pixels[..., 3] == 1).all())
    premultiplied = not (opaque or data or image.alpha_mode in ("CHANNEL_PACKED", "NONE"))
    coded = not data and space.name not in LINEAR
    if image.is_float:
        # Blender has decoded it; Cycles interpolates codes of 16 bits, too.
        coded = coded and space.name in CODED
        if coded:
            pixels[..., :3] = linear_to_srgb(pixels[..., :3])
        return ImagePixels(pixels, coded, premultiplied)
    if coded and space.name not in CODED:
        messages.add(owner, f'colour space "{space.name}" of {name} is not supported yet, it is sRGB')
    stored = np.rint(pixels * 255).astype(np.uint8)
    if premultiplied:
        # Cut off, not rounded, as in Cycles.
        stored[..., :3] = stored[..., :3].astype(np.uint16) * stored[..., 3:] // 255
    return ImagePixels(stored, coded, premultiplied)


def _pixels(image: Any) -> np.ndarray | None:
    """(H, W, 4) float32, row 0 at the bottom; None if there are none."""
    count, channels = len(image.pixels), image.channels
    width, height = image.size
    if count == 0 or width * height * channels != count:
        return None
    pixels = np.empty(count, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, channels)
    if channels == 4:
        return pixels
    full = np.ones((height, width, 4), np.float32)
    full[..., :3] = pixels[..., :1] if channels < 3 else pixels
    if channels == 2:
        full[..., 3] = pixels[..., 1]
    return full
