# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure the tables of docs/method.md, and write them between their marks."""

from __future__ import annotations

import argparse
import io
import itertools
import math
import statistics
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout

import numpy as np

import dev

from . import ablation, integrators
from .ablation import short
from .integrands import INTEGRANDS, reference
from .integrators import Entrant, Moments, Slowed, print_row

DOCUMENT = dev.ROOT / "docs/method.md"
SAMPLES = (16, 64, 256)
ENDLESS = ("checkerboard4", "bump10")
"""Where quadrature is not run: it bisects until every level is used, or has 3^8 nodes a box."""


def methods() -> None:
    """Relative RMSE, the median of 5 seeds; of quadrature one."""
    names = ("default", "thesis_2020", "sobol", "monte_carlo", "quadrature")
    print(f"At {' / '.join(map(str, SAMPLES))} evaluations a bin; quadrature's own number in brackets.\n")
    print_row(("integrand", *names))
    print_row(["---"] * (1 + len(names)))
    for integrand in INTEGRANDS.values():
        truth, cells = reference(integrand), []
        for name in names:
            texts = []
            if name == "quadrature" and integrand.name in ENDLESS:
                cells.append("not run")
                continue
            seeds = range(1 if name == "quadrature" else 5)
            for samples in SAMPLES:
                entrant, bins = Entrant.named(name), integrand.bins
                runs = [entrant.run(integrand, bins, samples, seed)[0] for seed in seeds]
                text = short(statistics.median(truth.relative_error(run.value) for run in runs))
                spent = runs[0].evaluations / math.prod(bins)
                texts.append(f"{text} ({spent:.0f})" if name == "quadrature" else text)
            cells.append(" / ".join(texts))
        print_row((integrand.name, *cells))


def dimensions() -> None:
    """The best inner rule of every cv_dims."""
    bins, samples, cost = (128, 128), 64, 0.3
    print(f"{bins[0]} x {bins[1]} bins, {samples} evaluations a bin, {cost:g} us a point, one thread:")
    print("error, seconds, and the inner rule with the least error.\n")
    print_row(("integrand", "sobol", *(f"cv_dims {m}" for m in (2, 3, 4, 5))))
    print_row(["---"] * 6)
    for name in ("smooth3", "ridge3", "sscat_occ", "colour3", "direct4", "spot4", "vrl4", "fog5", "bump10"):
        integrand = INTEGRANDS[name]
        truth = reference(integrand, bins)
        f = Slowed(integrand.f, integrand.ndim, cost * 1e-6)
        best: dict[str, tuple[float, float, str]] = {}
        for column, rule, entrant in ablation.coverings(integrand):
            runs = [entrant.run(integrand, bins, samples, seed, f) for seed in range(2)]
            error = statistics.median(truth.relative_error(result.value) for result, _ in runs)
            found = (error, min(seconds for _, seconds in runs), rule)
            best[column] = min(best.get(column, found), found)
        columns = ("sobol", *(f"cv_dims={m}" for m in (2, 3, 4, 5)))
        cells = [best.get(column) for column in columns]
        print_row((name, *(f"{short(c[0])}, {c[1]:.2f} {c[2]}".strip() if c else "" for c in cells)))


def biases() -> None:
    """Of the methods that have one."""
    seeds, bins = 32, (32, 32)
    print("Bias of the picture's mean, and root mean square of the bins' biases, relative to the mean.")
    print(f"{seeds} seeds, 32 x 32 bins; after +- and < what chance alone gives.\n")
    names = ("thesis_2020", "quadrature", "ControlVariates(residual=False)")
    print_row(("integrand", "samples", *(("H alone" if "False" in name else name) for name in names)))
    print_row(["---"] * (2 + len(names)))
    for name, samples in itertools.product(("ridge3", "sscat_occ", "direct4", "colour3"), (4, 16, 64)):
        integrand, cells = INTEGRANDS[name], []
        truth = reference(integrand, bins)
        for entrant in map(Entrant.named, names):
            try:
                found = Moments.of(entrant, integrand, bins, truth, samples, range(seeds))
            except ValueError:
                cells.append("too few samples")
                continue
            scale = truth.value.mean()
            away = (found.mean - truth.value) / scale
            chance = found.deviation / math.sqrt(seeds) / scale
            whole = math.sqrt(np.mean(chance**2) / chance.size)
            square, limit = np.mean(away**2) - np.mean(chance**2), np.sqrt(np.mean(chance**2))
            # A sum of B squares is known to sqrt(2 / B) of itself.
            seen = square > 3 * math.sqrt(2 / chance.size) * limit**2
            each = short(math.sqrt(square)) if seen else f"< {short(limit)}"
            error = f" +- {short(whole)}" if whole else ""
            cells.append(f"{short(away.mean())}{error}, {each}")
        print_row((name, samples, *cells))


def honesty() -> None:
    """sqrt(mean squared error / mean squared standard error), of blocks of 16 x 16 bins."""
    seeds, names = 40, ("default", "sobol", "thesis_2020")
    print(f"Error over standard error, least and largest of the blocks of 16 x 16 bins, {seeds} seeds.\n")
    print_row(("integrand", *(f"{name}, {n}" for name in names for n in (16, 64))))
    print_row(["---"] * (1 + 2 * len(names)))
    for integrand in INTEGRANDS.values():
        bins, cells = (32, 32), []
        truth = reference(integrand, bins)
        for name, samples in itertools.product(names, (16, 64)):
            few = seeds if name != "thesis_2020" else seeds // 4
            block = Moments.of(Entrant.named(name), integrand, bins, truth, samples, range(few)).honesty()
            cells.append(f"{block.min():.2f} to {block.max():.2f}")
        print_row((integrand.name, *cells))


def times() -> None:
    """`integrators --time`, its table alone."""
    options = integrators.parse(["--time", "--seeds", "1"])
    with redirect_stdout(io.StringIO()) as said:
        integrators.times(options)
    print("512 x 512 bins, 0.3 us a point, one thread, one seed.\n")
    print("".join(line for line in said.getvalue().splitlines(True) if line.startswith("|")), end="")


def costs() -> None:
    """What a node and a residual sample take besides the function."""
    bins, samples = (256, 256), 64
    print(f"{bins[0]} x {bins[1]} bins, {samples} evaluations a bin, one thread, nanoseconds; best of 3.\n")
    print_row(("integrand", "the function", "a node, in all", "a residual sample, in all", "H, a bin"))
    print_row(["---"] * 5)
    for name in ("smooth3", "direct4", "colour3"):
        integrand = INTEGRANDS[name]
        own, rows = Slowed(integrand.f, integrand.ndim, 0).own, []
        for seed in range(3):
            result, _ = Entrant.named("default").run(integrand, bins, samples, seed)
            said = result.statistics
            rows.append(
                (
                    said["seconds building"] / said["nodes"],
                    said["seconds sampling"] / result.sample_count.sum(),
                    said["seconds integrating"] / math.prod(bins),
                )
            )
        print_row((name, *(f"{1e9 * value:.0f}" for value in (own, *np.min(rows, axis=0)))))


def variants() -> None:
    ablation.compare(ablation.parse([]))


TABLES: dict[str, Callable[[], None]] = {
    function.__name__: function for function in (methods, dimensions, biases, honesty, times, costs, variants)
}


def write(name: str, text: str) -> None:
    """Put ``text`` between the marks of docs/method.md."""
    marks = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, rest = DOCUMENT.read_text("utf-8").split(marks[0])
    DOCUMENT.write_text(f"{before}{marks[0]}\n{text.strip()}\n{marks[1]}{rest.split(marks[1])[1]}", "utf-8")


def main(arguments: Iterable[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="dev.py bench method_tables", description=__doc__)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"of {', '.join(TABLES)}; else all")
    parser.add_argument("--write", action="store_true", help="also into docs/method.md")
    options = parser.parse_args(arguments)
    for name in options.tables or TABLES:
        with redirect_stdout(io.StringIO()) as said:
            TABLES[name]()
        print(f"## {name}\n\n{said.getvalue()}", flush=True)
        if options.write:
            write(name, said.getvalue())


if __name__ == "__main__":
    main()
