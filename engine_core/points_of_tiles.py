# SPDX-License-Identifier: GPL-3.0-or-later
"""How many points of a net each tile of a picture follows.

Points of their own say where many are of use, so that those of the nets stay free of what they show.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .integration.integrand import StagedIntegrand, values_at
from .integration.mapping import Map
from .integration.point_sets import SobolPoints
from .integration.standard_error import sums_around
from .transport.camera_hits import Pixels

MOST_OFTEN = 2
"""Binary logarithm of how many times as many points a tile has as the mean at most, or as few at least."""

FEWEST = 4, 8
"""Points of a tile at least, powers of two: half of the mean, but within these."""

GROWTH = 0.5
"""Points of a tile go as its deviation to this power. Variances of nets fall as points to the power 1.5, so
.8 has the least error; but the eye sees what the dark is wrong by in proportion."""

PILOTS, PILOT_POINTS = 2, 64
"""Along a tile's edge, places that tell its deviation; and points of each, a power of four."""

BATCH = 1 << 16
"""Points evaluated at once, about."""

ERROR = 0.1
"""What the net of N points is wrong by, squared, about: of neighbouring points' mean square difference, over
N^1.5."""

ON_LINE = 8.0
"""Times that, of what differs along one dimension alone, told by 64 cells in line: the same as of 8 x 8 where
edges are few. Of many, those see no more than one for each of 8."""

HIDDEN = 0.4
"""Part of the noise of what the picture shows beside that the net's is no less than: more points would not be
seen."""

ROOT = 0.676
"""Of the deviation of what is normally distributed, the square of its root's mean."""

PATTERN, PATTERN_IN_NOISE, MOST_TIMES = 0.05, 0.1, 4
"""What a net that is followed may be wrong by in the mean, of what is there, as it is a pattern: alone, and
in noise that hides it on average, though not in most pixels; and how many times as many points it has at most
where as many as usual would be wrong by more.
"""

WHOLE = 0.1
"""What a net may be wrong by, of what is there in the mean over the picture: the root of its mean square."""

DIM = 0.25
"""Of the mean, what counts as so bright at least in that."""


def roughness_of_tiles(
    integrand: StagedIntegrand,
    pixels_at: Callable[[np.ndarray, np.ndarray], Pixels],
    shape: tuple[int, int],
    edge: int,
    seed: int,
    map_: Map,
    check: Callable[[], None],
    dimensions: int = 2,
) -> np.ndarray:
    """(2, rows, columns) float64: mean square of what the integrand, its channels summed, differs by between
    neighbours of a net, and its mean; of a few places in each tile and in those around.

    pixels_at : columns and rows (B,) of the picture -> its pixels. shape : its rows and columns.
    edge : of a tile, in pixels. map_ : runs a function over items on the workers. check : called before every
        batch; may raise. dimensions : the first one or two of the net, along which there are neighbours.
    """
    rows, columns = (-(-n // edge) for n in shape)
    step = edge // PILOTS
    y, x = (
        np.minimum(np.arange(n * PILOTS) * step + step // 2, end - 1)
        for n, end in zip((rows, columns), shape, strict=True)
    )
    points = SobolPoints(range(integrand.rest_dimensions), seed, 106)
    points.prepare(PILOT_POINTS)
    pixels = pixels_at(*(a.ravel() for a in np.meshgrid(x, y)))
    size = max(1, BATCH // PILOT_POINTS)

    def roughness(low: int) -> np.ndarray:
        check()
        some = pixels[low : low + size]
        net = points.points(some.key(), 0, PILOT_POINTS)
        middle = np.full((2, len(some), 1), 0.5, np.float32)
        stage = integrand.first(some, middle)
        f = values_at(integrand, stage, len(some), None, net.reshape(len(net), -1))[:3]
        f = f.reshape(3, len(some), -1)
        return np.stack([_roughness(f, net[:dimensions]), f.sum(axis=0, dtype=np.float64).mean(axis=1)])

    found = np.concatenate(map_(roughness, range(0, len(pixels), size)), axis=1)
    found = found.reshape(2, rows, PILOTS, columns, PILOTS).mean(axis=(2, 4))
    found[0] *= ON_LINE if dimensions == 1 else 1
    # What few pilots missed, those around may tell.
    weights = np.array([1.0, 2.0, 1.0])
    for axis in (1, 2):
        found = sums_around(found, axis, weights) / sums_around(np.ones_like(found), axis, weights)
    return found


def hiding(deviation: np.ndarray, edge: int) -> np.ndarray:
    """(rows, columns) of tiles: by how much a channel deviates in most of its pixels; specks hide nothing
    between them, however bright they are.

    deviation : (H, W) of each pixel, as one sample says, or 0. edge : of a tile, in pixels.
    """
    sums = np.stack([np.sqrt(deviation, dtype=np.float64), np.ones(deviation.shape)])
    for axis in (1, 2):
        sums = np.add.reduceat(sums, np.arange(0, sums.shape[axis], edge), axis=axis)
    return np.square(sums[0] / sums[1]) / ROOT


def enough_points(
    rough: np.ndarray,
    bright: np.ndarray | None,
    noise: float,
    fewest: int,
    usual: int,
    around: float = 0.0,
    hiding: np.ndarray | None = None,
) -> int:
    """A power of two: points in the mean, from ``fewest`` to as many as are ``usual``, so that the ``noise``
    of a pixel's channel beside hides that they are no more; or more, if their error would be a pattern.

    rough, bright : of `roughness_of_tiles`; None for the second if more are not worth it whatever pattern
        errors make.
    fewest : 0 if it is as many as usual. around : mean radiance of a channel of other fog that is shown, in
        which patterns are seen the less. hiding : (rows, columns) as of that, what hides patterns; None for
        ``noise``.
    """
    if not fewest:
        return usual

    def least(rough: np.ndarray | float, error: np.ndarray | float) -> np.ndarray:
        return (ERROR * rough / np.maximum(error, 1e-100) ** 2) ** (2 / 3)

    # Channels are summed in that.
    most = float(MOST_TIMES * usual)
    hidden = unseen = min(float(least(rough.mean(), HIDDEN * noise * 3)), most) if noise else most
    if hidden < most and hiding is not None and rough.any():
        # Tiles count as the net errs there.
        weight = np.sqrt(rough)
        of_tiles = np.minimum(least(rough, HIDDEN * hiding * 3), most)
        unseen = max(hidden, (weight * of_tiles).sum() / weight.sum())
    wanted = 0.0
    if bright is not None and bright.any():
        relative = np.sqrt(rough) / np.maximum(bright, DIM * (bright.mean() + 3 * around))
        pattern = PATTERN if hidden >= usual else PATTERN_IN_NOISE
        whole = rough.mean() / (bright.mean() + 3 * around) ** 2
        wanted = max(float(least(relative.mean() ** 2, pattern)), float(least(whole, WHOLE)))
        wanted = min(wanted, unseen)
    fewest = usual if hidden >= usual else 1 << int(np.ceil(np.log2(max(hidden, fewest))))
    return max(fewest, 1 << round(np.log2(max(wanted, 1))))


def noise_of_points(rough: np.ndarray, points: np.ndarray) -> float:
    """Error to be expected of a pixel's channel, on average, by ``points`` (rows, columns) of each tile.
    rough : the first of `roughness_of_tiles`.
    """
    # Channels are summed in that.
    return float(np.sqrt(ERROR / 9 * rough / points**1.5).mean())


def points_of_tiles(rough: np.ndarray, mean: int) -> np.ndarray:
    """(rows, columns) int, powers of two: points of each tile, about ``mean`` of these. rough : as above."""
    return _shared(rough ** (GROWTH / 2), mean, int(np.clip(mean // 2, *FEWEST)))


def _roughness(f: np.ndarray, net: np.ndarray) -> np.ndarray:
    """(B,) mean square of what f (3, B, N) differs by between neighbours of nets (D, B, N), D <= 2: between
    those that a `digital_shift` leaves side by side.

    That counts the edges of shadows in the net's square, by their length and height, as its error does.
    """
    dimensions, places, count = net.shape
    if dimensions == 0:
        return np.zeros(places)
    edge = round(count ** (1 / min(dimensions, 2)))
    # One point in each cell.
    cell = np.zeros((places, count), np.intp)
    for u in net[:2]:
        cell = cell * edge + (u * edge).astype(np.intp)
    grid = np.take_along_axis(f.sum(axis=0, dtype=np.float64), np.argsort(cell, axis=1), axis=1)
    grid = grid.reshape(places, *[edge] * min(dimensions, 2))
    axes, found = range(1, grid.ndim), np.zeros(places)
    for axis in axes:
        lines = np.moveaxis(grid, axis, 1)
        found += np.square(lines[:, 1::2] - lines[:, ::2]).mean(axis=tuple(axes))
    return found


def _shared(wanted: np.ndarray, mean: int, fewest: int) -> np.ndarray:
    """``mean`` times powers of two, nearly in proportion to ``wanted`` (rows, columns): on average
    about ``mean``, ``fewest`` at least.
    """
    if not wanted.any():
        # Black, as far as is seen.
        return np.full(wanted.shape, min(mean, fewest))
    least = max(-MOST_OFTEN, int(np.log2(fewest / mean))) if mean > fewest else 0
    with np.errstate(divide="ignore"):
        level = np.log2(wanted / wanted.mean())
    # The more, the higher the scale: the highest that does not take more in the mean.
    scales = np.linspace(-MOST_OFTEN - 1, MOST_OFTEN + 1, 97)
    levels = np.clip(np.rint(level + scales[:, None, None]), least, MOST_OFTEN)
    means = np.exp2(levels).mean(axis=(1, 2))
    chosen = levels[np.abs(means - 1).argmin()]
    return (mean * np.exp2(chosen)).astype(int)
