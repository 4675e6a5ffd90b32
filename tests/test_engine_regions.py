# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions tile the domain to the last bit, no node is evaluated twice, and H is the mean of h."""

from __future__ import annotations

import numpy as np
import pytest

from engine_core.integration.allocation import evenly_spread, learned_deviation, sample_counts
from engine_core.integration.control_variate import ControlVariate
from engine_core.integration.mapping import even_parts
from engine_core.integration.regions import BIN, SMALLEST, WHOLE, RegionTree, neighbourly, root_edges
from engine_core.integration.residual import Overlaps
from engine_core.integration.rules import SIMPSON, bin_means, gauss, lagrange


class Counted:
    """An integrand of places, which keeps what it was asked for."""

    def __init__(self, bins: tuple[int, ...], dimensions: int, f) -> None:
        self.full = np.array([n << BIN for n in bins] + [1 << WHOLE] * (dimensions - len(bins)), float)
        self.f = f
        self.places: list[np.ndarray] = []

    def __call__(self, place: np.ndarray) -> tuple[np.ndarray, None]:
        self.places.append(place)
        return self.f(place / self.full[:, None])[None], None


def edge(u: np.ndarray) -> np.ndarray:
    return (1 + u[0]) * np.where(((u - 0.4) ** 2).sum(axis=0) < 0.2, 1.0, 0.3)


def grown(bins: tuple[int, ...], dimensions: int, sweeps: int = 6, **options) -> tuple[RegionTree, Counted]:
    counted = Counted(bins, dimensions, edge)
    tree = RegionTree(bins, dimensions, options.pop("log_edge", 3), counted, **options)
    for _ in range(sweeps):
        tree.sweep(max(4, len(tree) // 2), 0.0)
    return tree, counted


GRIDS = [((8,), 1), ((8,), 3), ((8, 8), 2), ((13, 7), 2), ((13, 7), 3), ((8, 8), 4), ((5, 3, 6), 4)]


@pytest.mark.parametrize("bins", range(1, 2001, 37))
@pytest.mark.parametrize("log_edge", [0, 3, 6])
def test_roots_tile_any_number_of_bins(bins, log_edge):
    starts, sizes = root_edges(bins, log_edge)
    assert starts[0] == 0 and starts[-1] + (1 << sizes[-1]) == bins
    assert (starts[1:] == (starts + (1 << sizes))[:-1]).all()
    assert (starts % (1 << sizes) == 0).all()  # aligned: halves never straddle a bin


@pytest.mark.parametrize(("bins", "dimensions"), GRIDS)
def test_regions_tile_the_domain(bins, dimensions):
    tree, _ = grown(bins, dimensions)
    regions = tree.leaves()
    assert abs(regions.volume.sum() - 1) < 1e-13
    # A point lies in exactly one of them.
    point = (np.random.default_rng(1).random((dimensions, 200)) * tree._full[:, None]).astype(np.int64)
    size = 1 << regions.size.astype(np.int64)
    inside = (point[:, :, None] >= regions.start[:, None]) & (
        point[:, :, None] < (regions.start + size)[:, None]
    )
    assert (inside.all(axis=0).sum(axis=1) == 1).all()


@pytest.mark.parametrize(("bins", "dimensions"), GRIDS)
def test_no_node_is_evaluated_twice(bins, dimensions):
    tree, counted = grown(bins, dimensions)
    places = np.concatenate(counted.places, axis=1)
    assert np.unique(places, axis=1).shape[1] == places.shape[1] == tree.store.count
    assert (places >= 0).all() and (places <= tree._full[:, None]).all()


@pytest.mark.parametrize(("bins", "dimensions"), GRIDS)
def test_a_split_costs_at_most_two_faces_of_nodes(bins, dimensions):
    tree, counted = grown(bins, dimensions, sweeps=0)
    for _ in range(6):
        before, splits = tree.store.count, tree.splits
        tree.sweep(5, 0.0)
        assert tree.store.count - before <= (tree.splits - splits) * 2 * 3 ** (dimensions - 1)


def test_neighbours_of_a_quadtree_share_their_nodes():
    counted = Counted((16, 16), 2, edge)
    tree = RegionTree((16, 16), 2, 4, counted, within_bins=False)
    while tree.sweep(len(tree), 0.0):  # all down to one bin, whatever their error
        pass
    assert len(tree) == 256
    assert tree.store.count == 33 * 33


def test_a_region_alone_has_its_own_error_alone():
    tree, _ = grown((1, 1), 2, sweeps=0)
    regions = tree.leaves()
    assert len(regions) == 1

    def map_(function, items):
        return [function(item) for item in items]

    density = np.array([0.3])
    assert np.allclose(neighbourly(density, regions, tree.store.count, map_), density)


@pytest.mark.parametrize(("bins", "dimensions"), GRIDS)
def test_nodes_hold_the_integrand(bins, dimensions):
    tree, counted = grown(bins, dimensions)
    regions = tree.leaves()
    offset = np.indices((3,) * dimensions).reshape(dimensions, -1)
    half = regions.size.astype(np.int64) - 1
    place = regions.start[:, :, None] + (offset[:, None] << half[:, :, None])
    wanted = edge(place.reshape(dimensions, -1) / counted.full[:, None])
    assert np.array_equal(tree.store.values[0].take(regions.nodes).ravel(), wanted)


def overlapping(tile):
    """Regions and bins (P,) that overlap."""
    pairs = tile.pairs()
    sizes = [np.diff(group.begin, append=len(group.regions)) for group in tile.footprints]
    size, regions = np.concatenate(sizes), np.concatenate([group.regions for group in tile.footprints])
    count = size.take(pairs.footprint)
    begin = (np.cumsum(size) - size).take(pairs.footprint) - (np.cumsum(count) - count)
    at = np.arange(count.sum()) + np.repeat(begin, count)
    bin_ = np.repeat(np.arange(len(pairs.first) - 1), np.diff(pairs.first))
    return regions.take(at), np.repeat(bin_, count)


@pytest.mark.parametrize(("bins", "dimensions"), GRIDS)
def test_h_of_bins_is_the_mean_of_h(bins, dimensions):
    tree, _ = grown(bins, dimensions)
    variate = ControlVariate(tree, 3, 1 << 20)
    x, w = gauss(2)  # exact for quadratics
    for number in range(len(variate)):
        tile = variate.tile(number)
        density = tile.density(None)
        mean, error, unexplained = tile.means()
        assert (unexplained >= 0).all()
        region, bin_ = overlapping(tile)
        volume = tile.overlap.take(region)
        assert np.allclose(np.bincount(bin_, volume), 1, rtol=0, atol=1e-13)
        assert np.allclose(np.bincount(bin_, volume * density.take(region)), error, atol=1e-13)
        total = np.zeros(len(region))
        grid = np.stack(np.meshgrid(*[np.arange(2)] * dimensions, indexing="ij")).reshape(dimensions, -1)
        for at in grid.T:
            u = np.repeat(x[at][:, None], len(bin_), axis=1)
            total += w[at].prod() * tile.values(region, bin_, u)[0]
        assert np.allclose(np.bincount(bin_, volume * total), mean[0], rtol=1e-12)


@pytest.mark.parametrize(("bins", "dimensions"), GRIDS)
def test_samples_inside_overlaps_are_where_h_says(bins, dimensions):
    # h of a quadratic is that quadratic: so `place` and `values` mean the same point.
    def quadratic(u: np.ndarray) -> np.ndarray:
        return ((u - 0.3) ** 2).sum(axis=0) + u.prod(axis=0)

    counted = Counted(bins, dimensions, quadratic)
    tree = RegionTree(bins, dimensions, 2, counted)
    for _ in range(5):
        tree.sweep(max(3, len(tree) // 2), 0.0)
    variate = ControlVariate(tree, 2, 1 << 20)
    random = np.random.default_rng(3)
    for number in range(len(variate)):
        tile = variate.tile(number)
        region, bin_ = overlapping(tile)
        u = random.random((dimensions, len(bin_)))
        at = tile.place(region, u)
        k = len(bins)
        assert (at >= 0).all() and (at <= 1).all()
        at[:k] = (at[:k] + tile.index[:, bin_]) / np.array(bins)[:, None]
        assert np.allclose(tile.values(region, bin_, u)[0], quadratic(at), rtol=1e-12)


@pytest.mark.parametrize(("bins", "dimensions"), [((8, 8), 2), ((8, 8), 4), ((13, 7), 3)])
def test_overlaps_are_chosen_as_often_as_their_weights_say(bins, dimensions):
    tree, _ = grown(bins, dimensions, sweeps=8)
    tile = ControlVariate(tree, 4, 1 << 20).tile(0)
    density, (_, error, _) = tile.density(None), tile.means()
    overlaps = Overlaps(tile, density, error)
    n = 1 << 12
    several = np.argsort(np.bincount(overlapping(tile)[1]))[-3:]
    for bin_ in several:
        x = (np.arange(n) + 0.5) / n
        region, weight = overlaps.choose(np.full(n, bin_), x)
        assert (x >= 0).all() and (x <= 1).all()
        # E[vol / q] is 1, and no weight exceeds 1 over the even part.
        assert abs(weight.mean() - 1) < 2e-2 and weight.max() <= 5 + 1e-9
        assert len(np.unique(region)) > 1


def test_a_region_is_halved_no_further_than_its_lattice():
    counted = Counted((1,), 1, lambda u: np.where(u[0] < 1 / 3, 1.0, 0.0))
    tree = RegionTree((1,), 1, 0, counted)
    for _ in range(100):
        if not tree.sweep(1, 0.0):
            break
    assert tree.leaves().size.min() >= SMALLEST
    tree = RegionTree((4,), 1, 2, counted, within_bins=False)
    for _ in range(100):
        if not tree.sweep(4, 0.0):
            break
    assert tree.leaves().size.min() == BIN and len(tree) == 4


def test_what_no_node_has_seen_is_looked_for():
    counted = Counted((16, 16), 3, lambda u: np.exp(-((u - 0.3) ** 2).sum(axis=0) / 2e-3))
    tree = RegionTree((16, 16), 3, 4, counted)
    assert tree.store.values.max() < 1e-6  # a peak between all nodes of the root
    for _ in range(40):
        tree.sweep(8, 0.0)
    assert tree.store.values.max() > 0.2


@pytest.mark.parametrize(("bins", "dimensions"), GRIDS)
def test_bins_left_out_have_no_node_inside(bins, dimensions):
    without = np.random.default_rng(2).random(bins) < 0.1
    counted = Counted(bins, dimensions, edge)
    tree = RegionTree(bins, dimensions, 3, counted, without=without)
    for _ in range(4):
        tree.sweep(8, 0.0)
    assert abs(tree.leaves().volume.sum() - (~without).mean()) < 1e-13
    place = np.concatenate(counted.places, axis=1)[: len(bins)]
    inside = (place & ((1 << BIN) - 1) != 0).all(axis=0)  # of a bin: on no edge
    assert not without[tuple(place[:, inside] >> BIN)].any()


def test_rules_integrate_what_they_should():
    x = np.linspace(0, 1, 3)
    assert np.array_equal(lagrange(x), np.eye(3))
    for count in (1, 2, 8, 64):
        m = bin_means(count)
        assert np.allclose(m.mean(axis=0), SIMPSON, atol=1e-15)
        edges = np.arange(count + 1) / count
        cubes = np.diff(edges**3) / 3 * count  # the mean of t^2 in each bin
        assert np.allclose(m @ x**2, cubes, atol=1e-14)


@pytest.mark.parametrize("samples", [10.0, 1000.0, 50_000.0])
@pytest.mark.parametrize("chance", [1 / 16, 1.0])
def test_counts_are_powers_of_two_within_the_budget(samples, chance):
    error = np.random.default_rng(0).random(1000) ** 8
    count, chances = sample_counts(error, samples, 0.1, chance)
    assert (count & (count - 1) == 0).all() and (count >= 1).all()
    assert (chances > 0).all() and (chances <= 1).all() and (chances[count > 1] == 1).all()
    least = len(error) * chance
    spent = (count * chances).sum()
    assert spent <= max(samples, least) + 1e-9
    assert spent > 0.9 * min(samples, spent + 1) or samples < least
    order = np.argsort(error)
    assert count[order][-100:].mean() >= count[order][:100].mean()


def test_a_pilot_corrects_what_the_nodes_predicted_but_has_no_say_in_its_own_bins():
    random = np.random.default_rng(3)
    bins = (96, 64)
    predicted = random.uniform(0.5, 2, bins)
    wrong = np.where(np.arange(96) < 48, 0.3, 3.0)[:, None]
    pilot = evenly_spread(bins, 4, 0)
    square = np.square(predicted * wrong * random.normal(size=bins))
    found = learned_deviation(square, pilot, predicted) / (predicted * wrong)
    for half in (slice(0, 38), slice(58, 96)):
        assert abs(np.median(found[half]) - 1) < 0.2 and found[half].std() < 0.4
    at = tuple(np.argwhere(pilot)[100])
    changed = square.copy()
    changed[at] += 100 * square.mean()
    again = learned_deviation(changed, pilot, predicted) / (predicted * wrong)
    # Of itself it moves the mean of the picture, of which it is one in 1,536, and that through others' eyes.
    assert abs(again[at] / found[at] - 1) < 0.01
    assert again[at[0] + 1, at[1]] > 1.5 * found[at[0] + 1, at[1]]


@pytest.mark.parametrize("scale", [1e-44, 1e-39, 1e-30, 1.0, 1e30, 1e37])
def test_samples_are_shared_alike_however_large_the_errors(scale):
    random = np.random.default_rng(4)
    error = random.uniform(2, 30, (40, 30)).astype(np.float32)
    scaled = (error.astype(np.float64) * scale).astype(np.float32)
    bins, pilot = np.ones(error.shape), np.ones(error.shape, bool)
    found = learned_deviation(np.square(scaled, dtype=np.float64), pilot, scaled)
    assert np.isfinite(found).all() and found.max() > 0
    for of_error in (scaled, found):
        count, chance = sample_counts(of_error.ravel(), 5.0 * bins.size, 0.1, 0.1)
        assert 0.8 * 5 * bins.size < (count * chance).sum() <= 5 * bins.size


def test_what_is_not_in_a_pilot_has_no_say_and_no_bins_have_none():
    random = np.random.default_rng(5)
    predicted, pilot = random.uniform(1, 2, (20, 16)), evenly_spread((20, 16), 4, 0)
    square = np.where(pilot, np.square(predicted), np.nan)
    expected = learned_deviation(np.where(pilot, square, 0), pilot, predicted)
    assert np.array_equal(learned_deviation(square, pilot, predicted), expected)
    assert learned_deviation(np.zeros((0, 3)), np.zeros((0, 3), bool), np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.parametrize("most", [1, 2, 3, 4, 7, 100])
def test_even_parts_are_whole_and_even(most):
    assert even_parts(0, most) == []
    for count in range(1, 60):
        parts = even_parts(count, most)
        size = [part.stop - part.start for part in parts]
        assert np.array_equal(np.concatenate([np.arange(count)[part] for part in parts]), np.arange(count))
        assert min(size) > 0 and max(size) <= min(most, min(size) + 1)
        # No more than it takes, but for a few.
        assert len(parts) <= max(-(-count // most), 4)


@pytest.mark.parametrize("bins", [(64,), (128, 96), (24, 20, 16)])
def test_a_part_of_the_bins_is_evenly_spread(bins):
    chosen = evenly_spread(bins, 4, 5)
    assert abs(chosen.mean() - 0.25) < 0.02
    for axis in range(len(bins)):
        halves = [half.mean() for half in np.array_split(chosen, 4, axis)]
        assert np.ptp(halves) < 0.1
