# SPDX-License-Identifier: GPL-3.0-or-later
"""The integrator on functions with known means: error, time to equal error, and bias.

A method is one of the short names, or a method object as it is written in Python, such as
"ControlVariates(cv_dims=2, residual=False)".
"""

from __future__ import annotations

import argparse
import ast
import itertools
import math
import statistics
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from engine_core import integration

from .integrands import INTEGRANDS, REFERENCE_FIVE, Function, Integrand, Reference, reference

SHORT = {
    "monte_carlo": {"method": "monte_carlo"},
    "sobol": {"method": "sobol"},
    "quadrature": {"method": "quadrature"},
    "default": {"method": "control_variates"},
    "thesis_2020": {"method": "control_variates", "preset": "thesis_2020"},
}

REQUIRED = {
    "smooth3": {16: 1.2e-5, 64: 1.0e-6, 256: 1.3e-7},
    "ridge3": {16: 1.3e-3, 64: 2.6e-4, 256: 6e-5},
    "disk2": {16: 3.8e-2, 64: 6.6e-3, 256: 9e-4},
    "sscat_occ": {16: 2.5e-2, 64: 6.0e-3, 256: 1.8e-3},
    "direct4": {16: 2.6e-2, 64: 9.2e-3, 256: 3.0e-3},
}
"""The relative RMSE that `default` may have at most, by samples."""

TIMED_SAMPLES = 64
"""The error to reach is the one that `sobol` has with so many."""
TIMED_RATIO = {"sscat_occ": 3.0, "direct4": 1.5, "smooth3": 20.0, "ridge3": 20.0, "checkerboard4": 0.8}
"""How many times as fast as `sobol` `default` has to be."""


@dataclass(frozen=True)
class Entrant:
    """A method, and what `integrate` is given for it."""

    name: str
    arguments: dict[str, Any]

    @classmethod
    def named(cls, text: str) -> Entrant:
        if text in SHORT:
            return cls(text, SHORT[text])
        try:
            call = ast.parse(text, mode="eval").body
            kind = getattr(integration, call.func.id)
            values = {keyword.arg: ast.literal_eval(keyword.value) for keyword in call.keywords}
            return cls(text, {"method": kind(**values)})
        except (AttributeError, SyntaxError, TypeError, ValueError) as error:
            short = ", ".join(SHORT)
            raise argparse.ArgumentTypeError(f"{text!r} is none of {short}, nor a method: {error}") from None

    def run(
        self,
        integrand: Integrand,
        bins: tuple[int, ...],
        samples: float,
        seed: int,
        f: Function | None = None,
        threads: int = 1,
    ) -> tuple[integration.Result, float]:
        """The result, and seconds."""
        start = time.perf_counter()
        result = integration.integrate(
            f or integrand.f,
            integrand.ndim,
            bins=bins,
            samples=samples,
            seed=seed,
            threads=threads,
            **self.arguments,
        )
        return result, time.perf_counter() - start


# Errors


def errors(options: argparse.Namespace) -> None:
    """A row for each integrand, method and number of samples."""
    head = ("integrand", "bins", "method", "samples", "relative RMSE", "at most", "evaluations a bin",
            "regions", "seconds", "not finite")  # fmt: skip
    print_row(head)
    print_row(["---"] * len(head))
    for integrand in options.integrands:
        bins = options.bins or integrand.bins
        truth = reference(integrand, bins)
        for entrant, samples in itertools.product(options.methods, options.samples):
            runs = [
                entrant.run(integrand, bins, samples, seed, threads=options.threads)
                for seed in range(options.seeds or 5)
            ]
            limit = REQUIRED.get(integrand.name, {}).get(samples) if entrant.name == "default" else None
            error = statistics.median(truth.relative_error(result.value) for result, _ in runs)
            note = "" if limit is None or bins != integrand.bins else f"{limit:.1e}"
            if note and error > limit:
                note += " **missed**"
            print_row(
                (
                    integrand.name,
                    " x ".join(map(str, bins)),
                    entrant.name,
                    f"{samples:g}",
                    f"{error:.2e}",
                    note,
                    f"{statistics.mean(r.evaluations for r, _ in runs) / math.prod(bins):.1f}",
                    f"{statistics.median(r.regions for r, _ in runs):.0f}",
                    f"{min(seconds for _, seconds in runs):.3f}",
                    f"{max(r.non_finite for r, _ in runs)}",
                )
            )
        if truth.own_error > 1e-12:
            print(f"  ({integrand.name}: the reference's own relative RMSE is {truth.own_error:.1e})")


# Time


class Slowed:
    """A function that takes ``seconds`` a point, by arithmetic that runs without the GIL."""

    def __init__(self, f: Function, ndim: int, seconds: float) -> None:
        self._f = f
        u = np.random.default_rng(0).random((ndim, 1 << 14))
        own = self._seconds_of(lambda: f(u)) / u.shape[1]
        self.own = own
        self._passes = 0.0
        work = u[0].copy()
        one = self._seconds_of(lambda: np.cos(work, out=work)) / u.shape[1]
        self._passes = max(0.0, (seconds - own) / one)
        # Once more with everything in place: calls and caches count as well.
        for _ in range(2):
            now = self._seconds_of(lambda: self(u)) / u.shape[1]
            self._passes = max(0.0, self._passes + (seconds - now) / one)
        self.seconds = self._seconds_of(lambda: self(u)) / u.shape[1]

    @staticmethod
    def _seconds_of(call: Any) -> float:
        """The median of many calls."""
        spent = []
        for _ in range(25):
            start = time.perf_counter()
            call()
            spent.append(time.perf_counter() - start)
        return statistics.median(spent)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        values = self._f(u)
        # Pieces stay in the cache whatever the caller's batches are; cos keeps them in [-1, 1].
        whole, part = divmod(self._passes, 1.0)
        for low in range(0, u.shape[1], 1 << 13):
            work = np.array(u[0, low : low + (1 << 13)], np.float64)
            for _ in range(int(whole)):
                np.cos(work, out=work)
            some = work[: int(part * work.size)]
            np.cos(some, out=some)
        return values


def times(options: argparse.Namespace) -> None:
    """Time of `sobol` at 64 samples, over time of the others at the fewest samples with its error."""
    bins = options.bins or (512, 512)
    seeds = options.seeds or 3
    rival = Entrant.named("sobol")
    head = ("integrand", "method", "samples", "evaluations a bin", "error", "sobol's", "seconds",
            "sobol's", "times as fast", "at the same error", "at least", "regions")  # fmt: skip
    rows = [head, ["---"] * len(head)]
    for integrand in options.integrands:
        truth = reference(integrand, bins)
        f = Slowed(integrand.f, integrand.ndim, options.cost * 1e-6)
        print(f"{integrand.name}: {1e6 * f.seconds:.3f} us a point (the function itself {1e6 * f.own:.3f})")
        for entrant in options.methods:
            if entrant.name == rival.name:
                continue
            goal = truth.relative_error(rival.run(integrand, bins, TIMED_SAMPLES, 0)[0].value)
            samples = fewest(entrant, integrand, bins, truth, goal)
            if samples is None:
                print(f"  {entrant.name} does not reach {goal:.2e} with 8 times sobol's samples")
                continue
            turns = [(rival, TIMED_SAMPLES), (entrant, samples), *([(entrant, samples // 2)] * (samples > 1))]
            found = []
            for seed in range(1, seeds + 1):
                now = []
                for runner, count in turns:
                    result, seconds = runner.run(integrand, bins, count, seed, f, options.threads)
                    now.append((seconds, truth.relative_error(result.value)))
                    print(f"  {runner.name:20} {count:4g} samples {seconds:8.3f} s  error {now[-1][1]:.3e}")
                    if count == samples and runner is entrant:
                        last = result
                found.append(now)
            taken = np.array(found)  # (seeds, turns, (seconds, error))
            ratio = float(np.median(taken[:, 0, 0] / taken[:, 1, 0]))
            (sobol_seconds, sobol_error), (seconds, error), *_ = np.median(taken, axis=0)
            needed = TIMED_RATIO.get(integrand.name) if entrant.name == "default" else None
            note = "" if needed is None else f"{needed:g}"
            if note and ratio < needed:
                note += " **missed**"
            rows.append(
                (
                    integrand.name,
                    entrant.name,
                    f"{samples:g}",
                    f"{last.evaluations / math.prod(bins):.2f}",
                    f"{error:.2e}",
                    f"{sobol_error:.2e}",
                    f"{seconds:.2f}",
                    f"{sobol_seconds:.2f}",
                    f"**{ratio:.2f}**",
                    f"{sobol_seconds / time_to(sobol_error, np.median(taken[:, 1:], axis=0)):.2f}",
                    note,
                    f"{last.regions}",
                )
            )
            print_breakdown(last)
    for cells in rows:
        print_row(cells)


def fewest(
    entrant: Entrant, integrand: Integrand, bins: tuple[int, ...], truth: Reference, goal: float
) -> int | None:
    """The smallest power of two of samples that reaches an error; None beyond 8 times sobol's."""
    samples = 1
    while samples <= 8 * TIMED_SAMPLES:
        error = truth.relative_error(entrant.run(integrand, bins, samples, 0)[0].value)
        if error <= goal:
            return samples
        samples *= 2
    return None


def time_to(error: float, measured: np.ndarray) -> float:
    """Seconds to an error, by a power law through (seconds, error) of two numbers of samples (2, 2)."""
    seconds, errors = np.log(np.maximum(measured, 1e-300)).T
    if len(seconds) == 1 or errors[1] <= errors[0]:
        return float(measured[0, 0])
    return float(np.exp(np.interp(np.log(error), errors, seconds)))


def print_breakdown(result: integration.Result) -> None:
    for key, value in result.statistics.items():
        print(f"    {key}: {value:.4g}" if isinstance(value, float) else f"    {key}: {value}")


# Bias, and the standard error's honesty


@dataclass
class Moments:
    """Of one integrand, method and number of samples over many seeds; all (C, *bins).

    mean, deviation : over the seeds. square_error : mean of (value - truth)^2.
    variance : mean of the squared standard errors where they are finite.
    """

    count: int
    mean: np.ndarray
    deviation: np.ndarray
    square_error: np.ndarray
    variance: np.ndarray

    @classmethod
    def of(
        cls,
        entrant: Entrant,
        integrand: Integrand,
        bins: tuple[int, ...],
        truth: Reference,
        samples: float,
        seeds: Iterable[int],
    ) -> Moments:
        total = square = errors = variance = 0.0
        count, origin = 0, None
        for seed in seeds:
            result, _ = entrant.run(integrand, bins, samples, seed)
            away = result.value - truth.value
            origin = away if origin is None else origin  # sums from here: no digits are lost
            total, square = total + (away - origin), square + (away - origin) ** 2
            errors = errors + away * away
            variance = variance + result.standard_error**2
            count += 1
        mean = total / count
        deviation = np.sqrt(np.maximum(square / count - mean * mean, 0) * count / (count - 1))
        return cls(count, truth.value + origin + mean, deviation, errors / count, variance / count)

    def z(self, truth: Reference) -> np.ndarray:
        """(K,) deviations of the mean from the truth in its standard errors, of bins that have noise."""
        error = self.deviation / math.sqrt(self.count)
        own = math.sqrt(truth.noise)
        noisy = error > max(1e-13 * np.abs(truth.value).max(), own / 3)
        return ((self.mean - truth.value)[noisy] / np.hypot(error[noisy], own)).ravel()

    def honesty(self, block: int = 16) -> np.ndarray:
        """sqrt(mean squared error / mean squared standard error) of blocks of bins."""
        parts = []
        for array in (self.square_error, self.variance):
            h, w = array.shape[1:]
            rows = range(0, h, block)
            parts.append(
                [
                    array[:, i : i + block, j : j + block].mean()
                    for i, j in itertools.product(rows, range(0, w, block))
                ]
            )
        above, below = np.array(parts)
        return np.sqrt(np.divide(above, below, out=np.full_like(above, np.inf), where=below > 0))


def biases(options: argparse.Namespace) -> None:
    """z-tests over seeds in every bin."""
    seeds = range(options.seeds or 300)
    head = ("integrand", "method", "samples", "bins with noise", "mean of z", "deviation of z", "largest",
            "bias of the picture's mean", "error / standard error")  # fmt: skip
    print_row(head)
    print_row(["---"] * len(head))
    for integrand in options.integrands:
        bins = options.bins or tuple(8 for _ in integrand.bins)
        truth = reference(integrand, bins)
        for entrant, samples in itertools.product(options.methods, options.samples):
            moments = Moments.of(entrant, integrand, bins, truth, samples, seeds)
            z = moments.z(truth)
            honesty = moments.honesty()
            statistics_of_z = ("", "", "")
            if len(z):
                statistics_of_z = (f"{z.mean():+.3f}", f"{z.std():.3f}", f"{np.abs(z).max():.1f}")
            bias = moments.mean.mean() / truth.value.mean() - 1
            print_row(
                (
                    integrand.name,
                    entrant.name,
                    f"{samples:g}",
                    f"{len(z)}",
                    *statistics_of_z,
                    f"{bias:+.1e}",
                    f"{honesty.min():.2f} to {honesty.max():.2f}",
                )
            )


def print_row(cells: Iterable[object]) -> None:
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="dev.py bench integrators", description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--integrands", nargs="+", choices=(*INTEGRANDS, "all"), metavar="NAME",
                        help="all, or of " + ", ".join(INTEGRANDS))  # fmt: skip
    parser.add_argument("--methods", nargs="+", type=Entrant.named, metavar="METHOD",
                        help="of " + ", ".join(SHORT) + ", or as in Python")  # fmt: skip
    parser.add_argument("--samples", nargs="+", type=float, metavar="N", help="a bin")
    parser.add_argument("--bins", nargs=2, type=int, metavar=("H", "W"), help="instead of the usual ones")
    parser.add_argument("--seeds", type=int, help="usually 5; 3 with --time, 300 with --z")
    parser.add_argument("--threads", type=int, default=1)
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--time", action="store_true", help="to sobol's error, at 512 x 512")
    mode.add_argument("--z", action="store_true", help="test for bias over seeds, at 8 x 8")
    parser.add_argument("--cost", type=float, default=0.3, help="us that a point takes with --time")
    options = parser.parse_args(arguments)
    names = options.integrands or (TIMED_RATIO if options.time else REFERENCE_FIVE)
    options.integrands = [INTEGRANDS[name] for name in (INTEGRANDS if "all" in names else names)]
    options.bins = tuple(options.bins) if options.bins else None
    options.samples = options.samples or ([1, 2, 4, 16] if options.z else [16, 64, 256])
    if options.methods is None:
        usual = ("default",) if options.time else ("monte_carlo", "sobol", "default")
        options.methods = [Entrant.named(name) for name in usual]
    return options


def main() -> None:
    options = parse()
    (times if options.time else biases if options.z else errors)(options)


if __name__ == "__main__":
    main()
