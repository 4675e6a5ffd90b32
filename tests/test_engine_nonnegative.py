# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures without what is below black keep their means."""

from __future__ import annotations

import numpy as np
import pytest

from engine_core.image.nonnegative import WEIGHTS, raise_negative


@pytest.mark.parametrize("shape", [(40, 30), (1, 30), (40, 1), (2, 2)])
def test_means_stay_where_there_is_enough_around(shape):
    random = np.random.default_rng(2)
    pixels = random.uniform(0.5, 1, (*shape, 4)).astype(np.float32)
    negative = random.random(shape) < 0.1
    negative[0, 0] = True
    pixels[negative, :3] -= 1.2
    before = pixels.copy()
    raise_negative(pixels)
    assert pixels.min() >= 0 and (pixels[before < 0] == 0).all()
    np.testing.assert_allclose(pixels.sum(axis=(0, 1)), before.sum(axis=(0, 1)), rtol=1e-5)
    # What is far from all that is negative is as it was, and so is a channel without any.
    reach, near = len(WEIGHTS) // 2, np.zeros(shape, bool)
    for y, x in np.argwhere(negative):
        near[max(0, y - reach) : y + reach + 1, max(0, x - reach) : x + reach + 1] = True
    np.testing.assert_array_equal(pixels[~near], before[~near])
    np.testing.assert_array_equal(pixels[..., 3], before[..., 3])


def test_colours_above_black_stay_as_they_are():
    pixels = np.random.default_rng(1).random((9, 7, 4)).astype(np.float32)
    before = pixels.copy()
    raise_negative(pixels)
    np.testing.assert_array_equal(pixels, before)


@pytest.mark.parametrize("value", [1e-30, 1.0, 1e37])
def test_where_there_is_not_enough_all_is_black(value):
    pixels = np.full((9, 7, 3), -value, np.float32)
    pixels[4, 3] = value
    raise_negative(pixels)
    assert not pixels.any()
    pixels = np.full((9, 7, 3), 0.5, np.float32)
    pixels[4, 3] = -value
    raise_negative(pixels)
    assert np.isfinite(pixels).all() and (pixels >= 0).all()
