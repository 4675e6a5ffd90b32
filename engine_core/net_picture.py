# SPDX-License-Identifier: GPL-3.0-or-later
"""An integral of its own over every pixel, by one net of points whose values are followed over the picture.

What shadows break up is no polynomial of the place. For each point of a net of the other dimensions alone it
is: smooth, but where the edge of a shadow passes. So the corners of small cells of the picture tell, point by
point, what the pixels within get:

    P_i, between the values of point i at the corners                        without any ray
    (f_i - P_i) / chance, at one random place of each pixel                  with a chance for each i

The chance is 1 where a shadow's edge lies between the corners, and little where they agree. Whatever was
believed, the mean over chances is f_i. The net is as wrong as its few points are; nets of their own at the
corners, smoothed over the picture, take off what neighbours are wrong by together. All of it is unbiased.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .image.film import LARGEST, Layer
from .integration.integrand import values_at
from .integration.integrated import Integrated
from .integration.mapping import Map
from .integration.point_sets import RandomPoints, SobolPoints, staged_points
from .integration.sample_mean import sum_samples
from .integration.sobol import hash_combine
from .parts import OverNet, Region, cell_of
from .settings import Settings
from .transport.camera_hits import Pixels

CELL = 4
"""Edge of a cell in pixels."""

STRIP = 8
"""Rows of cells at once."""

LOG_SURE = 6
SURE = 1 << LOG_SURE
"""Chances are whole numbers of 1 / SURE, so that no rounding makes them others than they are."""

LEAST = 2
"""Of these, chance of a point on which all corners agree."""

DIFFERENT = 0.5
"""How much a point's corners differ, of the mean of all points, so that anything may lie between them."""

NEXT = 0.25
"""Of a cell's chances, what the cells around get at least: where an edge is, others are not far."""

ROUGH = 0.4
"""Mean chance of a cell in whose pixels all points are asked for, at several places."""

PLACES = 8
"""In these pixels, a power of two."""

ON_OUTLINES, BESIDE_OUTLINES = 16, 8
"""Camera rays of a pixel that an outline crosses, and of the others of its cell."""

SPLIT = 8
"""Camera rays for as many points as the net has."""

FRESH = 2
"""The net's points over those of a corner's own net."""

AROUND = np.array([1.0, 2.0, 3.0, 2.0, 1.0])
"""Weights of the corners that tell how wrong the net is, along each axis."""

MOST_POINTS = 512
"""Of a net; where more are wanted there are several, one after another."""

BATCH = 1 << 15
"""Points evaluated at once, about."""


class NetPicture:
    """One layer of a picture, or its polynomials alone.

    told : what was done, for people. seconds, regions, nodes : as in `ScreenPicture`.
    """

    def __init__(
        self, by: OverNet, settings: Settings, region: Region, layer: Layer, check: Callable[[], None]
    ) -> None:
        """region : x0, y0, x1, y1 in the whole frame. check : called before every batch; may raise."""
        self._by, self._settings, self._region, self._layer, self._check = by, settings, region, layer, check
        self._integrand = by.integrand
        self._alone = settings.integrator == "cv_only"
        self._rounds = -(-by.points // MOST_POINTS)
        self._points = by.points // self._rounds
        self.told = f"{self._points} points followed over the picture, {self._rounds} times"
        self.seconds: dict[str, float] = {}
        self._width, self._height = region[2] - region[0], region[3] - region[1]
        columns, rows = -(-self._width // CELL), -(-self._height // CELL)
        self._corners = rows + 1, columns + 1
        self.regions, self.nodes = rows * columns, self._corners[0] * self._corners[1]

    def build(self, map_: Map, enough: Callable[[], bool]) -> None:
        """Draw all of it. map_ : runs a function over items on the workers. enough : not asked."""
        nobody = np.zeros((self._height, self._width), bool)
        elsewhere = nobody if self._by.elsewhere is None else self._by.elsewhere.T
        # Nothing is between corners on either side of an outline.
        outline = nobody if self._alone else self._by.outlines(self._region, map_).T
        beside = _whole_cells(outline)
        for number in range(self._rounds):
            self._prepare(number)
            self._served = ~(beside | elsewhere)
            map_(self._strip, range(0, self._height, STRIP * CELL))
            if self._alone:
                continue
            self._correct()
            for which, cameras in (outline, ON_OUTLINES), (beside & ~outline, BESIDE_OUTLINES):
                index = np.flatnonzero(which & ~elsewhere)
                step = max(1, 4 * BATCH // (cameras * self._split))
                map_(self._sample, [(index[low : low + step], cameras) for low in range(0, len(index), step)])
        layer = self._layer
        for term in (layer.radiance, layer.control_variate, layer.residual):
            np.clip(term, -LARGEST, LARGEST, out=term)
        # Of all nets together; until here, the squares' sum.
        np.sqrt(layer.standard_error, out=layer.standard_error)
        layer.standard_error /= self._rounds

    def _prepare(self, number: int) -> None:
        """Nets of one round."""
        seed, dimensions = self._settings.seed, self._integrand.rest_dimensions
        if number:
            seed = int(hash_combine(seed, number)[0])
        net = SobolPoints(range(dimensions), seed, 103)
        net.prepare(self._points)
        self._net = net.points(np.zeros(1, np.uint32), 0, self._points)[:, 0]
        self._fresh = Integrated(self._integrand, max(1, self._points // FRESH), seed, fixed=False)
        self._places, self._draws = SobolPoints(range(2), seed, 104), RandomPoints(1, seed, 105)
        self._places.prepare(PLACES)
        self._split = max(1, self._points // SPLIT)
        self._plain = staged_points("sobol", 2, dimensions, self._split, seed + 1)
        for group, n in zip(self._plain, (1, self._split), strict=True):
            group.prepare(ON_OUTLINES * n)
        self._off = np.zeros((3, *self._corners))

    def _pixels(self, x: np.ndarray, y: np.ndarray) -> Pixels:
        x, y = (x + self._region[0]).astype(np.int32), (y + self._region[1]).astype(np.int32)
        return Pixels(x, y, cell_of(x, y, self._region))

    def _sample(self, work: tuple[np.ndarray, int]) -> None:
        """f itself in some pixels (B,), by so many camera rays each."""
        self._check()
        index, cameras = work
        layer = self._layer
        y, x = np.divmod(index, self._width)
        pixels = self._pixels(x, y)
        sums = sum_samples(self._integrand, pixels, pixels.key(), self._plain, 0, cameras, self._split, BATCH)
        value = sums.values[:3].T / (cameras * self._rounds)
        layer.radiance[y, x] += value
        layer.residual[y, x] += value
        layer.sample_count[y, x] += cameras
        # As if half of all points were dark.
        error = np.square(value.mean(axis=1) * self._rounds) / (cameras * self._split) ** 1.5
        layer.standard_error[y, x] += error[:, None]

    def _strip(self, low: int) -> None:
        """Some rows of cells from pixel row ``low`` on."""
        high = min(low + STRIP * CELL, self._height)
        columns, rows = (
            np.append(np.arange(start, end, CELL), end) for start, end in ((0, self._width), (low, high))
        )
        values = self._at_corners(columns, rows)
        means = values.mean(axis=3, dtype=np.float64)
        chance, spread = _chances(values.sum(axis=0))
        y, x = np.nonzero(self._served[low:high])
        if not self._alone:
            # Where most must be asked, different places in a pixel might have to be, too.
            rough = (chance.mean(axis=2) > ROUGH * SURE)[y // CELL, x // CELL]
            self._add_rough(x[rough], y[rough] + low, spread[y[rough] // CELL, x[rough] // CELL])
            y, x = y[~rough], x[~rough]
        row, column = y // CELL, x // CELL
        inner = (x - columns.take(column), y - rows.take(row) + low)
        size = np.diff(columns).take(column), np.diff(rows).take(row)
        corner = row * len(columns) + column
        corners = np.stack([corner, corner + 1, corner + len(columns), corner + len(columns) + 1])
        h = _at_middles(means, high - low, self._width)[:, y, x]
        residual, variance = np.zeros_like(h), spread[row, column] / self._points**1.5
        if not self._alone:
            values = np.ascontiguousarray(values.reshape(3, -1).T)  # (corners * N, 3)
            cell = row * (len(columns) - 1) + column
            chance = chance.reshape(-1, self._points)
            due = np.cumsum(chance, axis=1, dtype=np.uint16)
            rays = np.cumsum(chance.mean(axis=1).take(cell) * (self._points / SURE))
            firsts = np.searchsorted(rays, np.arange(0, rays[-1] + 1, BATCH)) if len(rays) else []
            for part in map(slice, firsts, [*firsts[1:], len(x)]):
                where = x[part], y[part] + low, [a[part] for a in inner], [a[part] for a in size]
                found = self._asked(*where, corners[:, part], cell[part], values, chance, due)
                residual[:, part] = found[:3]
                variance[part] += found[3]
        y += low
        layer = self._layer
        layer.control_variate[y, x] += h.T / self._rounds
        layer.residual[y, x] += residual.T / self._rounds
        layer.radiance[y, x] += (h + residual).T / self._rounds
        layer.sample_count[y, x] += not self._alone
        layer.standard_error[y, x] += variance[:, None]

    def _add_rough(self, x: np.ndarray, y: np.ndarray, spread: np.ndarray) -> None:
        """All points of the net in pixels (B,), each at one of `PLACES`; spread : (B,) of points.

        It is the same net as of all others: that it showed where it is needed must not change the mean.
        """
        step = max(1, BATCH // self._points)
        for low in range(0, len(x), step):
            self._check()
            part = slice(low, min(low + step, len(x)))
            pixels, n = self._pixels(x[part], y[part]), len(x[part])
            stage = self._integrand.first(pixels, self._places.points(pixels.key(), 0, PLACES))
            # Consecutive points are nets of their own.
            f = values_at(self._integrand, stage, n * PLACES, None, np.tile(self._net, n))[:3]
            value = f.reshape(3, n, -1).mean(axis=2, dtype=np.float64).T / self._rounds
            at, layer = (y[part], x[part]), self._layer
            layer.radiance[at] += value
            layer.residual[at] += value
            layer.sample_count[at] += PLACES
            layer.standard_error[at] += (spread[part] / self._points**1.5)[:, None]

    def _at_corners(self, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """(3, rows, columns, N) values of the net's points at corners of cells; keeps how wrong it is."""
        y, x = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
        count = self._points
        values = np.empty((3, len(x), count), np.float32)
        # The picture's last corners are those of its last pixels.
        at_x, at_y = np.minimum(x, self._width - 1), np.minimum(y, self._height - 1)
        u = np.stack([x - at_x, y - at_y]).astype(np.float32)[:, :, None]
        pixels = self._pixels(at_x, at_y)
        step = max(1, BATCH // count)
        for low in range(0, len(x), step):
            self._check()
            part = slice(low, min(low + step, len(x)))
            n = part.stop - part.start
            stage = self._integrand.first(pixels[part], u[:, part])
            found = values_at(self._integrand, stage, n, None, np.tile(self._net, n))
            values[:, part] = found[:3].reshape(3, n, count)
        # What two strips share is the later one's.
        own = len(rows) - (rows[-1] < self._height)
        if not self._alone:
            mine = slice(0, own * len(columns))
            off = self._fresh.first(pixels[mine], u[:, mine]).values
            off -= values[:, mine].mean(axis=2, dtype=np.float64)
            first = rows[0] // CELL
            self._off[:, first : first + own] = off.reshape(3, own, -1)
        return values.reshape(3, len(rows), len(columns), count)

    def _asked(
        self,
        x: np.ndarray,
        y: np.ndarray,
        inner: list[np.ndarray],
        size: list[np.ndarray],
        corners: np.ndarray,
        cell: np.ndarray,
        values: np.ndarray,
        chance: np.ndarray,
        due: np.ndarray,
    ) -> np.ndarray:
        """(4, B) f - P at random places of pixels (B,), three channels, and the variance that chance makes.

        inner, size : of each, its place in its cell, and the cell's size. corners : (4, B), rows of values
        (corners * N, 3). cell : (B,), rows of chance (cells, N), and of due, its running sums.
        """
        if len(x) == 0:
            return np.zeros((4, 0))
        self._check()
        count = self._points
        pixels = self._pixels(x, y)
        keys = pixels.key()
        place = self._places.points(keys, 0, 1)
        # In turn along the points, so that as many are taken as are due. What overflows does so alike.
        due = due.take(cell, axis=0)
        due += (self._draws.points(keys, 0, 1)[0] * SURE).astype(np.uint16)
        due >>= LOG_SURE
        taken = np.empty(due.shape, bool)
        np.not_equal(due[:, 1:], due[:, :-1], out=taken[:, 1:])
        taken[:, 0] = due[:, 0] > 0
        lane, point = np.nonzero(taken)
        stage = self._integrand.first(pixels, place)
        f = values_at(self._integrand, stage, len(x), lane, self._net.take(point, axis=1))[:3]
        change = f.T.astype(np.float32)
        weights = _bilinear(*((a + u) / s for a, u, s in zip(inner, place[:, :, 0], size, strict=True)))
        for c, w in zip(corners, weights.astype(np.float32), strict=True):
            change -= values.take(c.take(lane) * count + point, axis=0) * w.take(lane)[:, None]
        likely = chance[cell.take(lane), point]
        change *= ((SURE / count) / likely)[:, None]
        by_chance = np.square(change.mean(axis=1)) * (1 - likely / SURE)
        return np.stack([np.bincount(lane, a, len(x)) for a in (*change.T, by_chance)])

    def _correct(self) -> None:
        """Take off what the net is wrong by in all pixels around, as nets of their own at corners tell."""
        off = _smoothed(_smoothed(self._off, 1), 2) / self._rounds
        change = _at_middles(off, self._height, self._width).transpose(1, 2, 0) * self._served[:, :, None]
        self._layer.radiance += change
        self._layer.control_variate += change


def _chances(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of values (rows + 1, columns + 1, N) at corners of cells: (rows, columns, N) uint16 chances to ask for
    a point in a pixel, in 1 / SURE; and (rows, columns) variances of points, of a channel.
    """
    rows, columns = values.shape[0] - 1, values.shape[1] - 1
    at_corners = [values[j : j + rows, i : i + columns] for j in (0, 1) for i in (0, 1)]
    chance = np.maximum.reduce(at_corners) - np.minimum.reduce(at_corners)
    middle = sum(at_corners) / 4
    bright = middle.mean(axis=2, keepdims=True)
    np.divide(chance, DIFFERENT * bright, out=chance, where=bright > 0)
    np.minimum(chance, 1, out=chance)
    # What is smooth differs less from what is believed than its corners do.
    chance *= chance
    np.maximum(chance, NEXT * _largest_around(chance), out=chance)
    chance *= SURE
    np.ceil(chance, out=chance)
    return np.clip(chance, LEAST, SURE).astype(np.uint16), middle.var(axis=2, dtype=np.float64) / 9


def _bilinear(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(4, B) weights of a cell's corners at u, v (B,): left and right, of the lower ones first."""
    return np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])


def _at_middles(a: np.ndarray, height: int, width: int) -> np.ndarray:
    """(C, height, width) between values (C, rows + 1, columns + 1) at cells' corners, in pixels' middles: the
    mean over the pixel of what is linear in x and in y.
    """
    for axis, n in ((1, height), (2, width)):
        cell, inner = np.divmod(np.arange(n), CELL)
        t = (inner + 0.5) / np.minimum(CELL, n - cell * CELL)
        low, high = a.take(cell, axis=axis), a.take(cell + 1, axis=axis)
        high -= low
        high *= t[:, None] if axis == 1 else t
        high += low
        a = high
    return a


def _whole_cells(a: np.ndarray) -> np.ndarray:
    """(H, W) bool, where any pixel of the same cell is one of ``a``."""
    for axis, n in enumerate(a.shape):
        some = np.logical_or.reduceat(a, np.arange(0, n, CELL), axis=axis)
        a = np.repeat(some, CELL, axis=axis).take(np.arange(n), axis=axis)
    return a


def _largest_around(a: np.ndarray) -> np.ndarray:
    """The largest of ``a`` (rows, columns, N) in each cell and the eight around."""
    for axis in range(2):
        few, many = [slice(None)] * 2, [slice(None)] * 2
        few[axis], many[axis] = slice(1, None), slice(None, -1)
        few, many, largest = tuple(few), tuple(many), a.copy()
        np.maximum(largest[few], a[many], out=largest[few])
        np.maximum(largest[many], a[few], out=largest[many])
        a = largest
    return a


def _smoothed(a: np.ndarray, axis: int) -> np.ndarray:
    """Means of ``a`` and those around it along an axis, by `AROUND`; at its ends, of those that there are."""
    reach, n = len(AROUND) // 2, a.shape[axis]
    index = np.arange(n)[:, None] + np.arange(-reach, reach + 1)
    weight = np.where((index >= 0) & (index < n), AROUND, 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.moveaxis(a, axis, -1).take(np.clip(index, 0, n - 1), axis=-1)
    return np.moveaxis((rows * weight).sum(axis=-1), -1, axis)
