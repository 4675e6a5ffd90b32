# SPDX-License-Identifier: GPL-3.0-or-later
"""An integral of its own over every pixel, by one net of points whose values are followed over the picture.

What shadows break up is no polynomial of the place. For each point of a net of the other dimensions alone it
is: smooth, but where the edge of a shadow passes. So the corners of small cells of the picture tell, point by
point, what the pixels within get:

    P_i, between the values of point i at the corners                        without any ray
    (f_i - P_i) / chance, at one random place of each pixel                  with a chance for each i

The chance is 1 where a shadow's edge lies between the corners, and little where they agree. Whatever was
believed, the mean over chances is f_i. The net is as wrong as its few points are; nets of their own at the
corners, smoothed over the picture, take off what neighbours are wrong by together. Where others again
found more shadows, tiles of the picture follow more points; where points differ everywhere, as each may be of
another light, pixels have nets of their own. All of it is unbiased.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np

from .image.film import LARGEST, Layer
from .integration.integrand import values_at
from .integration.mapping import Map
from .integration.point_sets import RandomPoints, SobolPoints, staged_points
from .integration.sample_mean import sum_samples
from .integration.sobol import hash_combine
from .integration.standard_error import sums_around
from .parts import OverNet, Region, cell_of
from .points_of_tiles import BATCH, enough_points, noise_of_points, points_of_tiles, roughness_of_tiles
from .settings import Settings
from .transport.camera_hits import Pixels

CELL = 4
"""Edge of a cell in pixels."""

TILE = 8
"""Cells along the edge of a tile, all of which follow as many points."""

LOG_SURE = 6
SURE = 1 << LOG_SURE
"""Chances are whole numbers of 1 / SURE, so that no rounding makes them others than they are."""

LEAST = 1
"""Of these, chance of a point on which all corners agree, at least: of a dark one."""

DIFFERENT = 1.0
"""How much a point's corners differ, of the mean of all points, so that anything may lie between them."""

NEXT = 0.25
"""Of a cell's chances, what the cells around get at least: where an edge is, others are not far."""

MISSED = 0.125
"""Of a cell's mean chance, what all of its points get at least: where many see an edge, others have one
between the corners."""

SPECK, BRIGHT = 2.0, 1 / 16
"""Times as bright as its cell that one point is at most, over its chance: where what its corners agree on is
wrong, the pixel is no brighter, nor darker below zero. And the chance at least of one that is as bright as
the mean of its cell's, of others in proportion: of 64 points, one is a quarter as bright as the cell then.
What no corner sees may be more."""

ROUGH = 0.4
"""Mean chance of a cell in whose pixels all points are asked for, at several places."""

PLACES = 8
"""In these pixels, a power of two."""

APART = 0.6
"""How much points differ between the corners of a cell, in tiles around, for a tile's pixels to have nets of
their own: most points would be asked for in any case, and what pixels are wrong by together is a pattern."""

ALIKE = np.ones(7)
"""Weights of the tiles of which that is the mean, along each axis."""

FRESH = 2
"""The net's points over those of a corner's own net."""

TOGETHER = 1 << 11
"""Points of the nets of corners side by side, that are one net together, at most."""

AROUND = np.array([1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0])
"""Weights of the corners that tell how wrong the net is, along each axis."""

MOST_POINTS = 512
"""Of a net; where more are wanted there are several, one after another."""


class NetPicture:
    """One layer of a picture, or its polynomials alone.

    told : what was done, for people. seconds, regions, nodes : as in `ScreenPicture`. noise : error
        to be expected of a pixel's channel, on average, once it is built.
    """

    noise = 0.0

    def __init__(
        self, by: OverNet, settings: Settings, region: Region, layer: Layer, check: Callable[[], None]
    ) -> None:
        """region : x0, y0, x1, y1 in the whole frame. check : called before every batch; may raise."""
        self._by, self._settings, self._region, self._layer, self._check = by, settings, region, layer, check
        self._integrand = by.integrand
        self._alone = settings.integrator == "cv_only"
        self._take(by.points)
        self.seconds: dict[str, float] = {}
        self._width, self._height = region[2] - region[0], region[3] - region[1]
        columns, rows = -(-self._width // CELL), -(-self._height // CELL)
        self._tiles = -(-rows // TILE), -(-columns // TILE)
        self._corners = rows + 1, columns + 1
        self.regions, self.nodes = rows * columns, self._corners[0] * self._corners[1]

    def _take(self, points: int) -> None:
        """So many, a power of two."""
        self._rounds = -(-points // MOST_POINTS)
        self._points = points // self._rounds
        self.told = f"about {self._points} points followed over the picture, {self._rounds} times"

    def build(
        self,
        map_: Map,
        enough: Callable[[], bool],
        noise: float | None = None,
        around: float = 0.0,
        hiding: np.ndarray | None = None,
    ) -> None:
        """Draw all of it. map_ : runs a function over items on the workers. enough : whether to make do with
        the nets that there are. noise : mean error of what is shown beside, of a pixel's channel, None if
        that is not known. around : mean radiance of a channel of other fog that is shown.
        hiding : (rows, columns) error of what is shown beside, in most pixels of each tile.
        """
        if self._by.learn is not None:
            self._by.learn(map_)
        nobody = np.zeros((self._height, self._width), bool)
        elsewhere = nobody if self._by.elsewhere is None else self._by.elsewhere.T
        # Nothing is between corners on either side of an outline.
        outline = nobody if self._alone else self._by.outlines(self._region, map_).T
        self._beside = _whole_cells(outline)
        self._counts = self._allocated(map_, noise, around, hiding)
        self._followed, apart = np.ones(self._tiles, bool), np.zeros(self._tiles, bool)
        if self._by.chooses and not self._alone:
            apart = self._tiles_apart(map_)
            # Their corners tell what those beside are wrong by.
            self._followed = _largest_around(~apart)
        self._apart = self._of_pixels(apart) & ~outline
        self._served = ~(outline | elsewhere | self._apart)
        # Others may look into a lamp, next to which there is no bound to what is seen.
        self._of_use = _corners_around(self._served, self._corners)
        self._levels = np.unique(self._counts).tolist()
        # What is expected at corners, 0 as long as that is not known.
        self._expected = np.zeros(self._corners)
        work = self._work_of_rows()
        for number in range(self._rounds):
            self._prepare(number)
            # In their order: what tiles share may differ in its last bits.
            for row, column, means in map_(self._strip, work):
                for count, values in means.items():
                    self._means[count][:, row[:, None], column] = values
            if not self._alone:
                self._finish_round(map_, outline, elsewhere)
            done = number + 1
            if enough():
                break

        def finish(low: int) -> None:
            part, layer = slice(low, low + TILE * CELL), self._layer
            terms = (layer.control_variate, layer.residual) if self._settings.terms else ()
            for term in (layer.radiance, *terms):
                term[part] /= done
                np.clip(term[part], -LARGEST, LARGEST, out=term[part])
            if self._settings.standard_error:
                # Of all nets together; until here, the squares' sum.
                error = layer.standard_error[part]
                np.sqrt(error, out=error)
                error /= done

        map_(finish, range(0, self._height, TILE * CELL))

    def _finish_round(self, map_: Map, outline: np.ndarray, elsewhere: np.ndarray) -> None:
        """Correct what the net has in common, and sample pixels (H, W) bool that an ``outline`` crosses."""
        off = {count: self._off(count) for count in self._levels}
        map_(lambda tile: self._correct(tile, off), range(self._tiles[0]))
        count_of = self._of_pixels(self._counts)
        work = []
        for count in self._levels:
            of_tile = ~elsewhere & (count_of == count)
            # One point of each camera ray, where these differ most: all dimensions are one net then.
            for where, cameras in ((outline, self._by.at_outlines * count), (self._apart, count)):
                index, step = np.flatnonzero(where & of_tile), max(1, BATCH // cameras)
                work += [(index[low : low + step], cameras) for low in range(0, len(index), step)]
        map_(self._sample, work)

    def _prepare(self, number: int) -> None:
        """Nets of one round."""
        seed, dimensions = self._settings.seed, self._integrand.rest_dimensions
        if number:
            seed = int(hash_combine(seed, number)[0])
        net, most = SobolPoints(range(dimensions), seed, 103), int(self._counts.max())
        net.prepare(most)
        # Fewer points are the first of them.
        self._net = net.points(np.zeros(1, np.uint32), 0, most)[:, 0]
        self._fresh = SobolPoints(range(dimensions), seed, 102)
        self._fresh.prepare(max(TOGETHER, most // FRESH))
        self._places, self._draws = SobolPoints(range(2), seed, 104), RandomPoints(1, seed, 105)
        self._places.prepare(PLACES)
        self._plain = staged_points("sobol", 2, dimensions, 1, seed + 1)
        for group in self._plain:
            group.prepare(self._by.at_outlines * most)
        # At corners, the means of the first points of the net, as many as tiles have, where they are known.
        self._means = {count: np.full((3, *self._corners), np.nan) for count in self._levels}
        self._by_fresh = np.full((3, *self._corners), np.nan)

    def _allocated(
        self, map_: Map, noise: float | None, around: float, hiding: np.ndarray | None
    ) -> np.ndarray:
        """(rows, columns) int of tiles: points of each, powers of two. Arguments as in `build`."""
        shape = self._height, self._width
        rough, bright = roughness_of_tiles(
            self._integrand,
            self._pixels,
            shape,
            TILE * CELL,
            self._settings.seed,
            map_,
            self._check,
            1 if self._by.on_line else 2,
        )
        # What points of one of many lights each are wrong by is a pattern, which is looked at as a whole.
        noise, bright = (noise or 0) / (CELL if self._by.chooses else 1), bright if self._by.more else None
        self._take(enough_points(rough, bright, noise, self._by.fewest, self._by.points, around, hiding))
        counts = points_of_tiles(rough, self._points)
        self.noise = noise_of_points(rough, counts) / self._rounds**0.5
        return counts

    def _tiles_apart(self, map_: Map) -> np.ndarray:
        """(rows, columns) bool of tiles whose pixels have nets of their own. By a net that is no other's:
        what one says of where it is of use itself must not change the mean.
        """
        differing = np.zeros(self._tiles)
        net = SobolPoints(range(self._integrand.rest_dimensions), self._settings.seed, 107)
        most = int(self._counts.max())
        net.prepare(most)
        net = net.points(np.zeros(1, np.uint32), 0, most)[:, 0]

        def look(work: tuple[int, int]) -> None:
            row, count = work
            tiles = np.flatnonzero(self._counts[row] == count)
            # Left and right corners of the cells in tiles' middles, below and above.
            left = np.minimum(tiles * TILE + TILE // 2, self._corners[1] - 2)
            low = min(row * TILE + TILE // 2, self._corners[0] - 2)
            column = np.tile(np.stack([left, left + 1], axis=1).ravel(), 2)
            rows = np.repeat([low, low + 1], 2 * len(tiles))
            points = net[:, :count]
            values = self._by_nets(rows, column, lambda part: np.tile(points, len(rows[part])), count)
            found, *_ = _differing(values.reshape(3, 2, -1, count))
            # Between tiles there are no cells.
            differing[row, tiles] = found[0, ::2].mean(axis=1)

        map_(look, self._work_of_rows())
        # With those around, as single tiles among others of the other kind are seen.
        for axis in range(2):
            sums, weights = (sums_around(a, axis, ALIKE) for a in (differing, np.ones(self._tiles)))
            differing = sums / weights
        return differing > APART

    def _work_of_rows(self) -> list[tuple[int, int]]:
        """Rows of tiles, each with every number of points that some of it follows."""
        return [
            (row, count)
            for row, followed in enumerate(self._followed)
            for count in np.unique(self._counts[row, followed]).tolist()
        ]

    def _of_pixels(self, a: np.ndarray) -> np.ndarray:
        """(H, W) of pixels, of what is one number for each tile."""
        edge = TILE * CELL
        return a.repeat(edge, axis=0).repeat(edge, axis=1)[: self._height, : self._width]

    def _pixels(self, x: np.ndarray, y: np.ndarray) -> Pixels:
        x, y = (x + self._region[0]).astype(np.int32), (y + self._region[1]).astype(np.int32)
        return Pixels(x, y, cell_of(x, y, self._region))

    def _sample(self, work: tuple[np.ndarray, int]) -> None:
        """f itself in some pixels (B,), by so many camera rays each."""
        self._check()
        index, cameras = work
        y, x = np.divmod(index, self._width)
        pixels = self._pixels(x, y)
        sums = sum_samples(self._integrand, pixels, pixels.key(), self._plain, 0, cameras, 1, BATCH)
        value = sums.values[:3] / cameras
        # As if half of all points were dark.
        self._add(index, None, value, cameras, np.square(value.mean(axis=0)) / cameras**1.5)

    def _strip(self, work: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, dict[int, np.ndarray]]:
        """Of a row of tiles, those that have ``count`` points. Returns rows and columns of their corners, and
        (3, rows, columns) means there of as many points of the net, and of as few as other tiles have.
        """
        tile, count = work
        low, high = (min((tile + i) * TILE * CELL, self._height) for i in (0, 1))
        own = (self._counts[tile] == count) & self._followed[tile]
        # Corners of these tiles alone: what is between others is of no use.
        column = np.zeros(self._corners[1], bool)
        last = len(column) - 1
        for shift in range(TILE + 1):
            column[np.minimum(np.flatnonzero(own) * TILE + shift, last)] = True
        column = np.flatnonzero(column)
        row = np.arange(low // CELL, -(-high // CELL) + 1)
        values = self._at_corners(row, column, count)
        means = {n: values[..., :n].mean(axis=3, dtype=np.float64) for n in self._levels if n <= count}
        chance, spread = _chances(values)
        y, x = np.nonzero(self._served[low:high] & own.repeat(TILE * CELL)[: self._width])
        y += low
        across = np.zeros(last + 1, np.intp)
        across[column] = np.arange(len(column))
        j, i = y // CELL - row[0], across.take(x // CELL)
        if not self._alone:
            # Where most must be asked, different places in a pixel might have to be, too. And nothing is
            # between corners on either side of an outline.
            rough = (chance.mean(axis=2) > ROUGH * SURE)[j, i] | self._beside[y, x]
            self._add_rough(x[rough], y[rough], spread[j[rough], i[rough]], count)
            y, x, j, i = y[~rough], x[~rough], j[~rough], i[~rough]
        inner, size = self._in_cells(x, y)
        corners = _corners_of(j, i, len(column))
        h = _between(means[count].reshape(3, -1), corners, inner, size)
        residual, variance = np.zeros_like(h), spread[j, i] / count**1.5
        if not self._alone:
            values = np.ascontiguousarray(values.reshape(3, -1).T)  # (corners * N, 3)
            cell = j * (len(column) - 1) + i
            chance = chance.reshape(-1, count)
            due = np.cumsum(chance, axis=1, dtype=np.uint16)
            rays = np.cumsum(chance.mean(axis=1).take(cell) * (count / SURE))
            firsts = np.searchsorted(rays, np.arange(0, rays[-1] + 1, BATCH)) if len(rays) else []
            for part in map(slice, firsts, [*firsts[1:], len(x)]):
                where = x[part], y[part], [a[part] for a in inner], [a[part] for a in size]
                found = self._asked(*where, corners[:, part], cell[part], values, chance, due)
                residual[:, part] = found[:3]
                variance[part] += found[3]
        self._add(y * self._width + x, h, residual, int(not self._alone), variance)
        return row, column, means

    def _add(
        self, at: np.ndarray, h: np.ndarray | None, residual: np.ndarray, samples: int, variance: np.ndarray
    ) -> None:
        """Add both terms (3, B), None for 0, of pixels (B,), which are different ones, to what they have; the
        samples that it took, and variances (B,).
        """
        layer = self._layer
        sums = [(layer.radiance, residual if h is None else h + residual)]
        if self._settings.terms:
            sums += [(layer.residual, residual)] + ([] if h is None else [(layer.control_variate, h)])
        if self._settings.standard_error:
            sums.append((layer.standard_error, variance[None]))
        for term, values in sums:
            # By one index: several times faster than by two.
            rows = term.reshape(-1, term.shape[2])
            rows[at] += values.T
        layer.sample_count.reshape(-1)[at] += samples

    def _add_rough(self, x: np.ndarray, y: np.ndarray, spread: np.ndarray, count: int) -> None:
        """All ``count`` points of the net in pixels (B,), at a few places in turn; spread : (B,) of points.

        It is the same net as of all others: that it showed where it is needed must not change the mean.
        """
        step, net, places = max(1, BATCH // count), self._net[:, :count], min(PLACES, count)
        for low in range(0, len(x), step):
            self._check()
            part = slice(low, min(low + step, len(x)))
            pixels, n = self._pixels(x[part], y[part]), len(x[part])
            stage = self._integrand.first(pixels, self._places.points(pixels.key(), 0, places))
            # Consecutive points are nets of their own.
            f = values_at(self._integrand, stage, n * places, None, np.tile(net, n))[:3]
            value = f.reshape(3, n, -1).mean(axis=2, dtype=np.float64)
            self._add(y[part] * self._width + x[part], None, value, places, spread[part] / count**1.5)

    def _at_corners(self, rows: np.ndarray, columns: np.ndarray, count: int) -> np.ndarray:
        """(3, rows, columns, N) values of the net's first ``count`` points at these corners of cells.
        Asks those that are these tiles' for a net of their own, too.
        """
        row, column = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
        values = self._by_nets(row, column, lambda part: np.tile(self._net[:, :count], len(row[part])), count)
        values = values.reshape(3, len(row), count)
        if not self._alone:
            # What two tiles share is the later one's.
            tile = (np.minimum(a // TILE, n - 1) for a, n in zip((row, column), self._tiles, strict=True))
            first, second = tile
            mine = np.flatnonzero((first == rows[0] // TILE) & (self._counts[first, second] == count))
            row, column = row.take(mine), column.take(mine)
            few = max(1, count // FRESH)
            nets, expected = self._own_nets(row, column, few), self._expected[row, column]
            fresh = self._by_nets(
                row, column, lambda part: nets[:, part].reshape(len(nets), -1), few, expected
            )
            self._by_fresh[:, row, column] = fresh.reshape(3, -1, few).mean(axis=2, dtype=np.float64)
            self._expected[row, column] = expected
        return values.reshape(3, len(rows), len(columns), count)

    def _own_nets(self, row: np.ndarray, column: np.ndarray, count: int) -> np.ndarray:
        """(D, B, count) nets of corners (B,). In blocks of 2, 4 or 8 corners along either edge they are one
        net together, and so is what is smoothed over them, nearly.
        """
        bits = min(3, (TOGETHER // count).bit_length() - 1 >> 1) if count < TOGETHER else 0
        order = np.zeros(len(row), np.int64)
        for bit in range(bits):
            order |= (column >> bit & 1) << 2 * bit | (row >> bit & 1) << 2 * bit + 1
        block = (row >> bits) * (self._corners[1] + 1) + (column >> bits)
        block, which = np.unique(block, return_inverse=True)
        nets = self._fresh.points(hash_combine(block, bits), 0, count << 2 * bits)
        return nets.reshape(len(nets), -1, count).take((which << 2 * bits) + order, axis=1)

    def _by_nets(
        self,
        row: np.ndarray,
        column: np.ndarray,
        nets: Callable[[slice], np.ndarray],
        count: int,
        expected: np.ndarray | None = None,
    ) -> np.ndarray:
        """(3, B * count) values at corners (B,), at the points (D, b * count) of each slice of them.

        expected : (B,), is overwritten by what is expected there, unless that is known.
        """
        values = np.empty((3, len(row) * count), np.float32)
        x, y = np.minimum(column * CELL, self._width), np.minimum(row * CELL, self._height)
        # The picture's last corners are those of its last pixels.
        at_x, at_y = np.minimum(x, self._width - 1), np.minimum(y, self._height - 1)
        u = np.stack([x - at_x, y - at_y]).astype(np.float32)[:, :, None]
        pixels = self._pixels(at_x, at_y)
        step = max(1, BATCH // count)
        for low in range(0, len(row), step):
            self._check()
            part = slice(low, min(low + step, len(row)))
            n = part.stop - part.start
            stage = self._integrand.first(pixels[part], u[:, part])
            if expected is not None and not expected[part].any():
                expected[part] = 1 if self._by.expected is None else self._by.expected(stage, n)
            found = values_at(self._integrand, stage, n, None, nets(part))
            values[:, low * count : part.stop * count] = found[:3]
        return values

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
        count = chance.shape[1]
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
        # Camera rays of those that ask for any.
        asks = np.zeros(len(x), bool)
        asks[lane] = True
        some, ray = np.flatnonzero(asks), (np.cumsum(asks) - 1).take(lane)
        stage = self._integrand.first(pixels[some], place.take(some, axis=1))
        f = values_at(self._integrand, stage, len(some), ray, self._net.take(point, axis=1))[:3]
        change = f.T.astype(np.float32)
        weights = _bilinear(*((a + u) / s for a, u, s in zip(inner, place[:, :, 0], size, strict=True)))
        for c, w in zip(corners, weights.astype(np.float32), strict=True):
            change -= values.take(c.take(lane) * count + point, axis=0) * w.take(lane)[:, None]
        likely = chance[cell.take(lane), point]
        change *= ((SURE / count) / likely)[:, None]
        by_chance = np.square(change.mean(axis=1, dtype=np.float64)) * (1 - likely / SURE)
        return np.stack([np.bincount(lane, a, len(x)) for a in (*change.T, by_chance)])

    def _off(self, count: int) -> np.ndarray:
        """(3, rows, columns) what the net's first ``count`` points are wrong by at the corners, as nets of
        their own tell at all corners around for which that is known; over what is expected there, as what
        bright ones are wrong by would be seen in the dark.
        """
        off = self._by_fresh - self._means[count]
        known = np.isfinite(off) & self._of_use
        off[~known] = 0
        off, weight = (
            sums_around(sums_around(a, 1, AROUND), 2, AROUND) for a in (off, known[:1] * self._expected)
        )
        return np.divide(off, weight, out=np.zeros_like(off), where=weight > 0)

    def _correct(self, tile: int, off: dict[int, np.ndarray]) -> None:
        """Take off what the net is wrong by with as many points as it has, in a row of tiles. off : by number
        of points, as of `_off`.
        """
        low, high = (min((tile + i) * TILE * CELL, self._height) for i in (0, 1))
        part = slice(low, high)
        y, x = np.arange(low, high), np.arange(self._width)
        (x_in, y_in), (x_size, y_size) = self._in_cells(x, y)
        across, down = (x_in + 0.5) / x_size, ((y_in + 0.5) / y_size)[:, None]
        j, i = y // CELL - low // CELL, x // CELL

        def between(rows: np.ndarray) -> np.ndarray:
            """(..., height, W) of pixels, what is told at corners."""
            rows = rows.take(j, axis=-2) * (1 - down) + rows.take(j + 1, axis=-2) * down
            return rows.take(i, axis=-1) * (1 - across) + rows.take(i + 1, axis=-1) * across

        rows = slice(low // CELL, -(-high // CELL) + 1)
        count_of = self._counts[tile].repeat(TILE * CELL)[: self._width]
        expected, beside = self._expected[rows], self._beside[part]
        # Where an outline is between corners, there is as much as where there is the least.
        least = _of_corners(np.minimum, expected)[j[:, None], i]
        change = np.zeros((3, high - low, self._width))
        for count in np.unique(self._counts[tile]).tolist():
            found = between(off[count][:, rows] * expected)
            if beside.any():
                np.copyto(found, between(off[count][:, rows]) * least, where=beside)
            np.copyto(change, found, where=self._served[part] & (count_of == count))
        for term in (self._layer.radiance, *[self._layer.control_variate] * self._settings.terms):
            term[part] += change.transpose(1, 2, 0)

    def _in_cells(
        self, x: np.ndarray, y: np.ndarray
    ) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """Of pixels (B,) in x and in y, their place in their cell, and its size."""
        inner = x % CELL, y % CELL
        ends = self._width - (x - inner[0]), self._height - (y - inner[1])
        return inner, tuple(np.minimum(CELL, end) for end in ends)


def _chances(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of values (3, rows + 1, columns + 1, N) at corners of cells: (rows, columns, N) uint16 chances to ask
    for a point in a pixel, in 1 / SURE; and (rows, columns) variances of points, of a channel.
    """
    chance, summed, middle, bright = _differing(values)
    largest = _of_corners(np.maximum, summed)
    np.maximum(chance, NEXT * _largest_around(chance), out=chance)
    np.maximum(chance, MISSED * chance.mean(axis=2, keepdims=True), out=chance)
    bright *= min(SPECK * values.shape[3], 1 / BRIGHT)
    np.divide(largest, bright, out=largest, where=bright > 0)
    np.maximum(chance, largest, out=chance, where=bright > 0)
    chance *= SURE
    np.ceil(chance, out=chance)
    return np.clip(chance, LEAST, SURE).astype(np.uint16), middle.var(axis=2, dtype=np.float64) / 9


def _differing(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of values as above, (rows, columns, N) in [0, 1], how much points differ between a cell's corners; and
    their channels' sums: at corners, the mean of each cell's four, and (rows, columns, 1) of all its points.
    """
    # Lights of one brightness may differ in colour.
    differing = sum(_of_corners(np.maximum, channel) - _of_corners(np.minimum, channel) for channel in values)
    summed = values.sum(axis=0)
    middle = _of_corners(np.add, summed) / 4
    bright = middle.mean(axis=2, keepdims=True)
    np.divide(differing, DIFFERENT * bright, out=differing, where=bright > 0)
    np.minimum(differing, 1, out=differing)
    # What is smooth differs less from what is believed than its corners do.
    differing *= differing
    return differing, summed, middle, bright


def _of_corners(of_two: np.ufunc, a: np.ndarray) -> np.ndarray:
    """(rows, columns, ...) of each cell's four corners, where ``a`` (rows + 1, columns + 1, ...) is told."""
    a = of_two(a[:-1], a[1:])
    return of_two(a[:, :-1], a[:, 1:])


def _bilinear(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """(4, B) weights of a cell's corners at u, v (B,): left and right, of the lower ones first."""
    return np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])


def _corners_of(row: np.ndarray, column: np.ndarray, columns: int) -> np.ndarray:
    """(4, B) numbers of the corners of cells (B,), in rows of so many: left and right, lower ones first."""
    corner = row * columns + column
    return np.stack([corner, corner + 1, corner + columns, corner + columns + 1])


def _between(
    values: np.ndarray, corners: np.ndarray, inner: tuple[np.ndarray, ...], size: tuple[np.ndarray, ...]
) -> np.ndarray:
    """(C, B) means over pixels of what is bilinear between values (C, K) at ``corners`` (4, B) of their
    cells: what it is in their middles.
    """
    out = np.zeros((len(values), corners.shape[1]))
    weights = _bilinear(*((a + 0.5) / n for a, n in zip(inner, size, strict=True)))
    for corner, weight in zip(corners, weights, strict=True):
        part = values.take(corner, axis=1)
        part *= weight
        out += part
    return out


def _corners_around(a: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """``shape`` bool, corners of cells that any pixel of ``a`` (H, W) is in."""
    for axis, n in enumerate(a.shape):
        a = np.logical_or.reduceat(a, np.arange(0, n, CELL), axis=axis)
    around = np.zeros(shape, bool)
    for y, x in product((slice(None, -1), slice(1, None)), repeat=2):
        around[y, x] |= a
    return around


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
