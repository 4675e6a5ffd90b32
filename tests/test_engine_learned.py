# SPDX-License-Identifier: GPL-3.0-or-later
"""What samples deviate by, learned from few of them."""

from __future__ import annotations

import numpy as np
import pytest

from engine_core.integration.allocation import evenly_spread
from engine_core.learned import Learned

SHAPE, SAID, TRUE = (192, 256), 1.0, 0.2


@pytest.mark.parametrize("one_in", [48, 384])
def test_few_samples_do_not_say_that_there_is_nothing(one_in: int) -> None:
    said = np.full(SHAPE, SAID, np.float32)
    wrong = []
    for seed in range(8):
        rows = np.flatnonzero(evenly_spread(SHAPE, one_in, seed))
        found = np.square(TRUE * np.random.default_rng(seed).standard_normal(len(rows)))
        learned = Learned.of(found, rows, said, 1.0, one_in)
        deviation = learned.deviation(said, slice(0, SHAPE[0]), np.zeros(SHAPE))
        wrong.append(deviation < TRUE / 2)
        assert 0.8 * TRUE < np.sqrt(np.square(deviation).mean()) < 1.2 * TRUE
    # A quarter of the mean of twelve squares of normal numbers, or less, has a chance of .004.
    assert np.mean(wrong) < 0.01


def test_what_differs_is_learned_where_it_is() -> None:
    said, true = np.ones(SHAPE, np.float32), np.full(SHAPE, TRUE)
    true[:, SHAPE[1] // 2 :] *= 10
    rows = np.flatnonzero(evenly_spread(SHAPE, 48, 1))
    found = np.square(true.reshape(-1)[rows] * np.random.default_rng(1).standard_normal(len(rows)))
    learned = Learned.of(found, rows, said, 1.0, 48)
    halves = np.split(learned.deviation(said, slice(0, SHAPE[0]), np.zeros(SHAPE)), 2, axis=1)
    left, right = (np.sqrt(np.square(half[:, 32:-32]).mean()) for half in halves)
    assert 0.8 * TRUE < left < 2 * TRUE
    assert 8 * TRUE < right < 12 * TRUE
