# SPDX-License-Identifier: GPL-3.0-or-later
"""Means over pixels, and over a lens, of small and bright things that camera rays see by themselves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .directly_seen import UNKNOWN
from .integration.allocation import sample_counts
from .integration.integrand import FirstStage
from .integration.mapping import Map
from .integration.point_sets import SobolPoints
from .settings import Settings
from .transport.camera_hits import Pixels
from .transport.lens_targets import LensTargets

POINTS, MOST_POINTS = 64, 1 << 14
"""Of a pixel that sees one target of which one is worth a point, in a picture of one sample: so many, if
`POINTS_OF_ALL` allows; of more targets as many times as many. And of a pixel where much is expected."""

GROWTH = 2 / 3
"""Points grow as the samples to this power, as a net's in fog: their error falls faster than by the root."""

POINTS_OF_ALL, MORE = 8, 1.0
"""What they cost all pixels, in the mean, in points of one target, in a picture of one sample. And so many
times as many go where most is expected."""

OF_HALVES = 0.9
"""What a pixel is wrong by, of what halves of its points differ by: as halves of one net, they are wrong
alike. If they were not, it were a half; of beams, spots and lamps it is .80 to .95 (1 and 16 samples)."""

TARGETS = 8
"""How many targets of a point cost as much as its ray."""


def seen_through_lens(
    first: Callable[[Pixels, np.ndarray], FirstStage],
    targets: LensTargets,
    region: tuple[int, int, int, int],
    settings: Settings,
    seed: int,
    map_: Map,
    enough: Callable[[], bool],
    check: Callable[[], None],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (B,) of a region x0, y0, x1, y1 that may see any of the ``targets``, row * width + column, and
    (3, B) mean radiance there, and its standard error.

    first : radiance of camera rays through points (4, B, S) of pixels and the lens.
    map_ : runs a function over items on the workers. enough : whether to make do with the first points.
    check : called now and then; may raise, to give up.
    """
    x0, y0, x1, y1 = region
    seers = targets.seers(region, map_, check)
    column, row = np.divmod(seers.index, y1 - y0)
    if len(seers) == 0:
        return seers.index, *np.zeros((2, 3, 0))
    samples = settings.samples
    if settings.noise_threshold or settings.time_limit:
        samples = min(samples, UNKNOWN)
    # Of a point with one target, and as many more as there are targets.
    wanted = seers.worth * (1 + seers.count) / 2
    cost = float((wanted * (1 + seers.count / TARGETS)).sum())
    each = min(POINTS_OF_ALL * (x1 - x0) * (y1 - y0) / max(cost, 1), POINTS)
    log = GROWTH * (samples - 1).bit_length() + np.log2(each * np.maximum(wanted, 1))
    counts = np.exp2(np.clip(np.rint(log), 1, np.log2(MOST_POINTS))).astype(np.int64)
    counts[seers.worth == 0] = min(max(1 << (samples - 1).bit_length(), 2), MOST_POINTS)
    points, batch = SobolPoints(range(4), seed, 109), settings.batch_size
    total, square = np.zeros((3, len(seers))), np.zeros(len(seers))

    def look(work: tuple[int, int, np.ndarray]) -> None:
        begin, end, rows = work
        some = seers.take(rows)
        x, y = (column.take(rows) + x0).astype(np.int32), (row.take(rows) + y0).astype(np.int32)
        pixels = Pixels(x, y, np.zeros(len(rows), np.int32))
        step = max(1, batch // max(len(rows), len(some.target)))
        for low in range(begin, end, step):
            net = points.points(pixels.key(), low, min(step, end - low))
            u, weight = targets.points(pixels, some, net)
            values = first(pixels, u).values[:3].reshape(3, *weight.shape) * weight
            total[:, rows] += values.sum(axis=2, dtype=np.float64)
            square[rows] += np.square(values.sum(axis=0, dtype=np.float64)).sum(axis=1)

    def look_at_all(begin: np.ndarray, end: np.ndarray) -> None:
        points.prepare(int(end.max()))
        # Pixels that have as many points, and a batch of their pairs with targets each time.
        due = np.flatnonzero(end > begin)
        key = (begin << 32 | end << 8 | seers.count).take(due)
        order = np.argsort(key, kind="stable")
        due, key = due.take(order), key.take(order)
        cost = np.cumsum((end - begin).take(due) * np.maximum(seers.count.take(due), 1)) // batch
        cuts = np.flatnonzero((np.diff(key >> 8, prepend=-1) != 0) | (np.diff(cost, prepend=-1) != 0))
        with_none = np.flatnonzero(np.diff(key & 255 == 0, prepend=False))
        parts = np.split(due, np.union1d(cuts, with_none))
        map_(look, [(int(begin[part[0]]), int(end[part[0]]), part) for part in parts if part.size])

    half = counts // 2
    look_at_all(np.zeros_like(counts), half)
    before = total.copy()
    look_at_all(half, counts)
    error = OF_HALVES * np.abs(total - 2 * before) / counts
    if not enough():
        deviation = np.sqrt(np.maximum(square / counts - np.square(total.sum(axis=0) / counts), 0))
        grid = np.zeros((x1 - x0 + 2, y1 - y0 + 2))
        grid[column + 1, row + 1] = deviation
        have, counts = counts, _wanted(grid, column, row, counts)
        look_at_all(have, counts)
        error *= (have / counts) ** 0.75
    return row * (x1 - x0) + column, total / counts, error


def _wanted(deviation: np.ndarray, column: np.ndarray, row: np.ndarray, have: np.ndarray) -> np.ndarray:
    """(B,) points of pixels that have some, all of them, as those beside tell.

    deviation : of a point, of the picture's pixels and of one more around; 0 where there is none.
    """
    beside = sum(np.square(deviation[column + x, row + y]) for x, y in ((0, 1), (2, 1), (1, 0), (1, 2)))
    wanted = have.copy()
    # As of a chessboard: what a pixel's own points tell has no say in how many there are.
    for which in ((column + row) % 2 == 0, (column + row) % 2 != 0):
        # Errors fall as points^-3/4: the sum of their squares is least by deviation^.8 points each.
        expected = beside[which] ** 0.4
        if expected.any():
            budget = (1 + MORE) * have[which].sum()
            due = sample_counts(expected, budget, 0.0, 1.0)[0]
            wanted[which] = np.clip(due, have[which], np.maximum(have[which], MOST_POINTS))
    return wanted
