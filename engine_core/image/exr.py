# SPDX-License-Identifier: GPL-3.0-or-later
"""OpenEXR files, through the OpenEXR package (an optional dependency: Blender writes its own)."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike, fspath

import numpy as np

from ..errors import RenderError
from .film import Film


def _openexr():
    try:
        import OpenEXR
    except ImportError as error:
        raise RenderError("OpenEXR files need the package OpenEXR: pip install OpenEXR") from error
    return OpenEXR


def film_channels(film: Film) -> dict[str, np.ndarray]:
    """A film's arrays under the names of Blender's multilayer files; (H, W) float32, row 0 at the bottom."""
    channels = {f"Combined.{name}": film.combined[..., i] for i, name in enumerate("RGBA")}
    channels["Depth.Z"] = film.depth
    channels |= {f"Normal.{name}": film.normal[..., i] for i, name in enumerate("XYZ")}
    return channels


def write_exr(path: str | PathLike, picture: Film | Mapping[str, np.ndarray]) -> None:
    """Write a film, or named (H, W) arrays with row 0 at the bottom, as 32-bit floats."""
    channels = film_channels(picture) if isinstance(picture, Film) else picture
    pixels = {name: np.ascontiguousarray(array[::-1], np.float32) for name, array in channels.items()}
    exr = _openexr()
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    exr.File(header, pixels).write(fspath(path))


def read_exr(path: str | PathLike) -> dict[str, np.ndarray]:
    """All channels of all parts of a file: (H, W) float32 arrays with row 0 at the bottom.

    Channels are named as in the file; where several parts have a channel of one name, the part's
    name and a dot come before it.
    """
    file = _openexr().File(fspath(path), separate_channels=True)
    result: dict[str, np.ndarray] = {}
    for part in file.parts:
        for name, channel in part.channels.items():
            key = f"{part.name()}.{name}" if name in result else name
            result[key] = np.asarray(channel.pixels, np.float32)[::-1]
    return result
