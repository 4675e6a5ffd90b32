# SPDX-License-Identifier: GPL-3.0-or-later
"""What the integrator's choices are worth: the default with one thing changed, against the default.

A variant is a method with other arguments, or with a constant or a function of `engine_core.integration`
replaced while it runs. What was tried and left lives here and nowhere else.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any
from unittest import mock

import numpy as np

from engine_core.integration import (
    GaussTensor,
    Net,
    allocation,
    build,
    control_variate,
    regions,
    residual,
    rules,
)
from engine_core.integration import control_variates as whole

from .integrands import INTEGRANDS, Integrand, reference
from .integrators import Entrant, Slowed, print_row

COMMON = ("smooth3", "ridge3", "disk2", "sscat_occ", "direct4", "spot4", "vrl4", "colour3", "fog5", "grid4")
"""Those of the table in docs/method.md."""

GIVEN_UP = (
    ("never", ((1.0, np.inf),)),
    ("at 1/8 above 0.4 alone", ((1 / 8, 0.4),)),
    ("at 1/4 above 0.2 alone", ((1 / 4, 0.2),)),
    ("at 1/8 above 0.2", ((1 / 8, 0.2),)),
    ("at 1/4 above 0.1", ((1 / 8, 0.4), (1 / 4, 0.1))),
)
"""What `build.HOPELESS` could be instead: after what part of the budget, above what is unexplained."""

Patch = tuple[Any, str, Any]
"""A module or class, a name in it, and what stands there meanwhile."""


@dataclass(frozen=True)
class Variant:
    """The default with other arguments, or other parts."""

    name: str
    arguments: dict[str, Any] = field(default_factory=dict)
    patches: tuple[Patch, ...] = ()

    @property
    def entrant(self) -> Entrant:
        return Entrant(self.name, {"method": whole.ControlVariates(**self.arguments)})

    @contextmanager
    def in_place(self) -> Iterator[None]:
        with ExitStack() as stack:
            for patch in self.patches:
                stack.enter_context(mock.patch.object(*patch))
            yield


# Parts that were tried and left


def nested_errors_signed(values: np.ndarray, nodes: np.ndarray, m: int) -> np.ndarray:
    """Eq. 4.8 to the letter: |integral of Simpson - trapezoid|, where what changes sign cancels."""
    out = np.zeros((m, len(nodes)))
    for channel in values:
        v = channel.take(nodes).reshape(-1, *(3,) * m)
        for d in range(m):
            line = np.moveaxis(v, 1 + d, 1).reshape(len(nodes), 3, -1)
            out[d] += np.abs((2 * line[:, 1] - line[:, 0] - line[:, 2]) @ rules.face_weights(m - 1))
    return out / 3


def judge_relatively(judge: Callable, tree: regions.RegionTree, part: slice | np.ndarray) -> None:
    """Halve by the error relative to the region's own mean; samples still go by the absolute one."""
    judge(tree, part)
    index = np.arange(len(tree))[part]
    weights = rules.face_weights(tree.dimensions)
    mean = sum(np.abs(v).take(tree.regions.nodes[index]) @ weights for v in tree.store.values)
    tree.regions.gain[index] /= np.maximum(mean, 1e-300)


class WithOwnAlpha(residual.ResidualSampler):
    """Eq. 2.15 in every bin from its own samples: alpha = Cov(f, h) / Var(h)."""

    def _residual(
        self, integrand, bins, keys, tile, overlaps, part, n, later=False
    ) -> tuple[np.ndarray, Any]:
        def weighted(of: Any) -> tuple[np.ndarray, Any]:
            values, stage = residual.ResidualSampler._residual(
                self, integrand, bins, keys, of, overlaps, part, n, later
            )
            return np.array(values, np.float64).reshape(len(values), len(part), n), stage

        left, stage = weighted(tile)
        f, _ = weighted(_Flat(tile))
        h = f - left
        if n > 1:
            f0, h0 = (a - a.mean(axis=2, keepdims=True) for a in (f, h))
            spread = (h0 * h0).mean(axis=2, keepdims=True)
            usable = spread > 1e-28 * h.mean(axis=2, keepdims=True) ** 2
            covariance = (f0 * h0).mean(axis=2, keepdims=True)
            alpha = np.where(usable, covariance / np.where(usable, spread, 1), 1)
            left = left + (alpha - 1) * (tile.means()[0][:, part, None] - h)
        return left.reshape(len(left), -1), stage


class _Flat:
    """A tile whose h is 0."""

    def __init__(self, tile: control_variate.TileOfRegions) -> None:
        self._tile = tile

    def __getattr__(self, name: str) -> Any:
        return getattr(self._tile, name)

    def values(self, *of: Any) -> np.ndarray:
        return np.zeros_like(self._tile.values(*of))


def variants() -> list[Variant]:
    """All, the default first."""

    def constant(module: Any, name: str, *values: float) -> list[Variant]:
        return [Variant(f"{name} {value:g}", patches=((module, name, value),)) for value in values]

    def argument(name: str, *values: float) -> list[Variant]:
        return [Variant(f"{name} {value:.3g}", {name: value}) for value in values]

    def judged(judge: Callable) -> tuple[Patch, ...]:
        original = regions.RegionTree._judge
        return ((regions.RegionTree, "_judge", lambda tree, part: judge(original, tree, part)),)

    def spread_evenly(error: np.ndarray, *others: float) -> tuple[np.ndarray, np.ndarray]:
        return allocation.sample_counts(np.ones_like(error), *others)

    def within(even: float) -> Patch:
        return (whole, "ResidualSampler", partial(residual.ResidualSampler, even=even))

    evenly = (whole, "sample_counts", spread_evenly)
    points = whole.staged_points
    random = (whole, "staged_points", lambda kind, *others: points("monte_carlo", *others))
    alpha = (whole, "ResidualSampler", WithOwnAlpha)
    never_twice = (whole, "sampled_twice", lambda bins, *others: np.zeros(bins, bool))
    return [
        Variant("default"),
        *constant(regions, "TRUST", 0, 0.5, 1),
        Variant("nested error with its sign", patches=((regions, "nested_errors", nested_errors_signed),)),
        Variant("nested error relative", patches=judged(judge_relatively)),
        *constant(regions, "EXPLORE", 0, 1 / 8, 1 / 4),
        *constant(build, "SWEEP", 0.1, 0.25),
        *(Variant(f"roots of {1 << k} bins", patches=((whole, "root_edge", lambda *_, k=k: k),))
          for k in (2, 3, 4, 5)),
        *argument("share", 1 / 16, 1 / 8, 1 / 4, 1 / 2),
        *(Variant(f"given up {text}", patches=((build, "HOPELESS", checks),)) for text, checks in GIVEN_UP),
        *constant(build, "EVERYWHERE", 0),
        *constant(whole, "BEYOND_HOPE", np.inf),
        *argument("defensive", 0.05, 0.25),
        *argument("chance", 1.0),
        Variant("neighbours' errors not asked",
                patches=((control_variate, "neighbourly", lambda density, *_: density),)),
        *(Variant(f"EVEN {even:g}", patches=(within(even),)) for even in (0.1, 0.5, 1)),
        Variant("samples even over bins", patches=(evenly,)),
        Variant("even over bins and regions", patches=(evenly, within(1))),
        Variant("pseudo-random samples", patches=(random,)),
        Variant("alpha from own samples", patches=(alpha,)),
        Variant("no bin sampled twice", patches=(never_twice,)),
    ]  # fmt: skip


@cache
def _truth(name: str, bins: tuple[int, ...]) -> Any:
    return reference(INTEGRANDS[name], bins)


def error(variant: Variant, integrand: Integrand, samples: float, seeds: Iterable[int]) -> float:
    """Median relative RMSE."""
    truth = _truth(integrand.name, integrand.bins)
    with variant.in_place():
        results = (variant.entrant.run(integrand, integrand.bins, samples, seed)[0] for seed in seeds)
        return statistics.median(truth.relative_error(result.value) for result in results)


def short(value: float) -> str:
    """1.2e-3 for 1.2e-03."""
    number, _, power = f"{value:.1e}".partition("e")
    return f"{number}e{int(power)}"


def compare(options: argparse.Namespace) -> None:
    """How many times the default's error every variant has."""
    names = [integrand.name for integrand in options.integrands]
    print(f"Error over the default's, at {' / '.join(f'{n:g}' for n in options.samples)} samples:\n")
    print_row(("variant", *names, "mean"))
    print_row(["---"] * (len(names) + 2))
    default = None
    for variant in variants():
        if options.only and variant.name != "default" and options.only not in variant.name:
            continue
        found = np.array(
            [
                [error(variant, integrand, samples, range(options.seeds)) for samples in options.samples]
                for integrand in options.integrands
            ]
        )
        if default is None:
            default = found
            cells = [" / ".join(map(short, row)) for row in found]
            print_row(("**default: the error itself**", *cells, ""))
            continue
        ratio = found / default
        mean = np.exp(np.log(ratio).mean(axis=0))
        print_row((variant.name, *(" / ".join(f"{r:.2f}" for r in row) for row in (*ratio, mean))))


# How many dimensions the polynomial covers


def inner_rules(dimensions: int) -> Iterator[tuple[str, Any]]:
    """Rules for so many dimensions inside a node; Gauss points only where they are few."""
    if not dimensions:
        yield "", None
        return
    for count in (8, 16, 64):
        yield f"Net({count})", Net(count)
    for order in (4, 8):
        if order**dimensions <= 64:
            yield f"Gauss({order})", GaussTensor(order)


def coverings(integrand: Integrand) -> Iterator[tuple[str, str, Entrant]]:
    """Sobol, and every cv_dims up to 5 with every inner rule: what it is, the rule, the method."""
    yield "sobol", "", Entrant.named("sobol")
    for covered in range(len(integrand.bins), min(integrand.ndim, 5) + 1):
        for text, rule in inner_rules(integrand.ndim - covered):
            method = whole.ControlVariates(cv_dims=covered, inner=rule)
            yield f"cv_dims={covered}", text, Entrant(f"cv_dims={covered} {text}", {"method": method})


def dimensions(options: argparse.Namespace) -> None:
    """Error and seconds of all coverings."""
    bins = tuple(options.bins)
    counts = options.samples
    print(f"{bins[0]} x {bins[1]} bins, {options.cost:g} us a point, {options.threads} threads")
    print_row(("integrand", "method", "inner rule", *(f"error, seconds at {n:g}" for n in counts), "regions"))
    print_row(["---"] * (4 + len(counts)))
    for integrand in options.integrands:
        truth = _truth(integrand.name, bins)
        f = Slowed(integrand.f, integrand.ndim, options.cost * 1e-6)
        for column, rule, entrant in coverings(integrand):
            cells = []
            for samples in counts:
                seeds = range(options.seeds)
                runs = [entrant.run(integrand, bins, samples, seed, f, options.threads) for seed in seeds]
                error_ = statistics.median(truth.relative_error(result.value) for result, _ in runs)
                cells.append(f"{short(error_)}, {min(seconds for _, seconds in runs):.2f}")
            print_row((integrand.name, column, rule, *cells, runs[0][0].regions))


def parse(arguments: Iterable[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="dev.py bench ablation", description=__doc__)
    parser.add_argument("--integrands", nargs="+", choices=INTEGRANDS, default=COMMON, metavar="NAME")
    parser.add_argument("--samples", nargs="+", type=float, default=[16, 64], metavar="N")
    parser.add_argument("--seeds", type=int, default=9)
    parser.add_argument("--only", metavar="TEXT", help="variants with this in their name")
    parser.add_argument("--dims", action="store_true", help="instead: every cv_dims, with seconds")
    parser.add_argument("--bins", nargs=2, type=int, default=(128, 128), metavar=("H", "W"), help="of --dims")
    parser.add_argument("--cost", type=float, default=0.3, help="us that a point takes, of --dims")
    parser.add_argument("--threads", type=int, default=1, help="of --dims")
    options = parser.parse_args(arguments)
    options.integrands = [INTEGRANDS[name] for name in options.integrands]
    return options


def main() -> None:
    options = parse()
    (dimensions if options.dims else compare)(options)


if __name__ == "__main__":
    main()
