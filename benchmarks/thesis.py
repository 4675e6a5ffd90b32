# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of the thesis: pictures, tables and curves of its chapters 5 and 6 into .dev/thesis."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

import dev
from engine_core import Scene, Settings, render
from example_blends import dragon, green_dragon

from .chapters import direct, fog
from .chapters.common import Study, own_error
from .scenes import core

FOLDER = dev.PRIVATE / "thesis"
CHAPTERS = {5: direct, 6: fog}
WITH_ASSETS = {"dragon": dragon, "green_dragon": green_dragon}


def scenes(options: argparse.Namespace) -> Iterable[tuple[str, Scene]]:
    """By name, at the size that is asked for; those whose mesh is not there are left out."""
    width, height = options.size
    for name in options.scenes:
        if name not in WITH_ASSETS:
            yield name, core.example(name, width, height)
        elif options.assets is not None and (Path(options.assets) / dragon.MESH).is_file():
            yield name, core.scene(WITH_ASSETS[name].model(Path(options.assets)), width, height)
        else:
            print(f"{name} is left out: --assets FOLDER with {dragon.MESH} is missing")


def converged(name: str, scene: Scene, options: argparse.Namespace) -> tuple[np.ndarray, np.ndarray]:
    """By plain samples and by control variates, from the folder if they were made before.

    What is hard for the one is easy for the other (about lights, at thin slivers), and where control variates
    were biased the mean of each would tell.
    """
    width, height = options.size
    path = options.output / f"reference-{name}-{width}x{height}-{options.reference_samples}.npy"
    if options.anew or not path.exists():
        ways = {"sobol": options.reference_samples, "control_variates": options.reference_samples // 4}
        films = [
            render(scene, Settings(samples=samples, seed=77, integrator=integrator))
            for integrator, samples in ways.items()
        ]
        np.save(path, [film.combined[..., :3] for film in films])
    one, other = np.load(path).astype(np.float64)
    return one, other


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="dev.py bench thesis", description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--chapter", type=int, choices=list(CHAPTERS), default=5)
    add(
        "--figures", nargs="+", metavar="5.N", help="; ".join(", ".join(c.FIGURES) for c in CHAPTERS.values())
    )
    add(
        "--scenes", nargs="+", metavar="NAME", help="; ".join(", ".join(c.DETAILS) for c in CHAPTERS.values())
    )
    add("--size", type=int, nargs=2, default=(320, 180), metavar=("WIDTH", "HEIGHT"))
    add("--samples", type=int, default=64,
        help="of a pixel where methods spend the same, and where curves end")  # fmt: skip
    add(
        "--reference-samples",
        type=int,
        default=1024,
        help="of the converged picture by plain samples; of that by control variates a quarter",
    )
    add("--anew", action="store_true", help="references again: the pictures have changed")
    add("--assets", type=Path, default=os.environ.get("CV_RENDER_ASSETS"), metavar="FOLDER",
        help="has the dragon's mesh (else: the environment's CV_RENDER_ASSETS)")  # fmt: skip
    add("-o", "--output", type=Path, default=FOLDER, metavar="FOLDER")
    options = parser.parse_args()
    chapter = CHAPTERS[options.chapter]
    for field, known in (("figures", chapter.FIGURES), ("scenes", chapter.DETAILS)):
        asked = getattr(options, field) or list(known)
        if unknown := set(asked) - set(known):
            parser.error(f"chapter {options.chapter} has no {', '.join(sorted(unknown))}")
        setattr(options, field, asked)
    return options


def main() -> None:
    options = parse()
    chapter = CHAPTERS[options.chapter]
    options.output.mkdir(parents=True, exist_ok=True)
    tables = []
    for name, whole in scenes(options):
        scene = chapter.prepared(whole)
        halves = converged(name, scene, options)
        own, bias = own_error(*halves), halves[1].mean() / halves[0].mean() - 1
        print(f"{name}: the converged pictures' own error is {own:.4f}, means differ by {100 * bias:+.3f} %")
        study = Study(name, scene, halves, options.samples, options.output)
        for figure, (draw, shown) in chapter.FIGURES.items():
            if figure in options.figures and name in shown:
                tables.append(draw(study))
                print(f"\n{tables[-1]}\n", flush=True)
    path = options.output / f"tables-{options.chapter}.md"
    path.write_text("\n\n".join(tables) + "\n", "utf-8")


if __name__ == "__main__":
    main()
