# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures in OpenEXR files come back bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import area_light, studio

from engine_core import Settings, render
from engine_core.image.exr import film_channels, read_exr, write_exr

pytest.importorskip("OpenEXR")


def test_channels_come_back_bit_for_bit(tmp_path):
    random = np.random.default_rng(1)
    channels = {
        "Combined.R": random.normal(size=(5, 7)).astype(np.float32),
        "Depth.Z": np.array([[0, np.inf, -0.0, 1e-45, 3e38, 1e10, -1]] * 5, np.float32),
    }
    write_exr(tmp_path / "picture.exr", channels)
    read = read_exr(tmp_path / "picture.exr")
    assert read.keys() == channels.keys()
    for name, array in channels.items():
        assert read[name].dtype == np.float32 and np.array_equal(read[name], array)


def test_film_comes_back_bit_for_bit(tmp_path):
    film = render(studio(40, 24, [area_light()]), Settings(samples=2, normals=True))
    write_exr(str(tmp_path / "film.exr"), film)
    read = read_exr(tmp_path / "film.exr")
    assert {"Combined.R", "Combined.A", "Depth.Z", "Normal.Y"} <= read.keys()
    for name, array in film_channels(film).items():
        assert np.array_equal(read[name], array)


def test_row_0_is_the_bottom(tmp_path):
    OpenEXR = pytest.importorskip("OpenEXR")
    picture = np.arange(6, dtype=np.float32).reshape(3, 2)
    write_exr(tmp_path / "rows.exr", {"Y": picture})
    stored = OpenEXR.File(str(tmp_path / "rows.exr"), separate_channels=True).parts[0].channels["Y"].pixels
    assert np.array_equal(stored, picture[::-1])


def test_other_types_are_written_as_floats(tmp_path):
    write_exr(tmp_path / "count.exr", {"samples": np.arange(6).reshape(2, 3)})
    assert np.array_equal(read_exr(tmp_path / "count.exr")["samples"], np.arange(6).reshape(2, 3))
