# SPDX-License-Identifier: GPL-3.0-or-later
"""How often bins are sampled, and whether at all."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from engine_core.integration.allocation import PART, black_of_chessboard, drawn, sample_counts


def test_little_chances_in_a_large_picture_are_kept():
    # In single precision, one part in 32 would be lost beside a sum of some hundred thousand.
    chance = np.ones(1 << 21, np.float32)
    chance[3::4] = np.random.default_rng(1).uniform(1 / 32, 1 / 8, 1 << 19)
    taken = drawn(chance, seed=5)
    assert taken[chance == 1].all()
    for few in np.split(taken.astype(np.float64) - chance, 64):
        assert abs(few.sum()) < 1.01


def test_each_bin_is_drawn_with_its_chance():
    chance = np.random.default_rng(2).uniform(1 / 32, 1, 256).astype(np.float32)
    often = np.mean([drawn(chance, seed, part) for seed in range(100) for part in range(20)], axis=0)
    deviation = np.sqrt(chance * (1 - chance) / 2000)
    assert (np.abs(often - chance) < 5 * deviation + 1e-3).all()


def test_samples_are_counted_alike_on_any_workers():
    error = np.random.default_rng(3).random(3 * PART + 17).astype(np.float32) ** 4
    for each in (0.06, 3.3):
        samples = each * len(error)
        count, chance = sample_counts(error, samples, 0.1, 1 / 32)
        with ThreadPoolExecutor(3) as pool:
            again = sample_counts(error, samples, 0.1, 1 / 32, lambda f, items: list(pool.map(f, items)))
        np.testing.assert_array_equal((count, chance), again)
        spent = (count * chance.astype(np.float64)).sum()
        assert 0.97 * samples < spent < 1.001 * samples
        # More where the error is larger: within half an octave of in proportion.
        due = (0.9 * error / error.mean() + 0.1) * spent / len(error)
        wanted = due >= 1
        assert np.all(np.abs(np.log2(count[wanted] / due[wanted])) < 1.2)


def test_a_chessboards_neighbours_have_other_colours():
    black = black_of_chessboard((5, 4))
    assert not black[0, 0]
    assert (black[1:] != black[:-1]).all() and (black[:, 1:] != black[:, :-1]).all()
