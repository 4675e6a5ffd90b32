# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights inside the frame in fog, the thesis' open problem: error by samples and by rays; engine_core alone.

A spot and three points in fog of extinction 0.08 (`scenes.fog.lights_in_frame`). Errors are root mean square
differences to two converged pictures, relative to the mean. "Worst about a light" is how far the mean of the
pixels within some distance of a light is from the converged: a dark or bright blotch would show there. The
converged are made by control variates, as plain samples take too long; what Sobol's means, whole and about
lights, differ by is what these are off by, within Sobol's noise.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

import dev
from engine_core import PointLight, Scene, Settings, render

from .chapters.common import own_error, relative_error, seen, table
from .chapters.fog import error_colours
from .method_figures import Canvas
from .scenes.fog import lights_in_frame

FOLDER = dev.PRIVATE / "lights_in_frame"
SAMPLES = {
    "control_variates": (1, 2, 3, 4, 8, 16, 64),
    "sobol": (16, 64),
    "monte_carlo": (64,),
}
GOAL = 64
"""Evaluations a pixel at which an error is asked for (0.012), of rays and of samples."""
ABOUT = (2, 4, 8, 16)
"""Pixels about a light, of 256 along an edge."""


def converged(size: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Two pictures (H, W, 3) of different seeds."""
    scene = lights_in_frame(size)
    one, other = (picture(scene, "control_variates", samples // 2, seed)[0] for seed in (1001, 2002))
    return one, other


def picture(scene: Scene, integrator: str, samples: int, seed: int) -> tuple[np.ndarray, float]:
    """(H, W, 3) radiance, row 0 at the bottom, and rays a pixel, towards lights and of the camera."""
    film = render(scene, Settings(samples=samples, seed=seed, integrator=integrator))
    return film.combined[..., :3].astype(np.float64), (
        film.statistics["shadow rays"] + film.statistics["camera rays"]
    ) / film.depth.size


def places(scene: Scene) -> np.ndarray:
    """(L, 2) column and row of the lights, in pixels."""
    camera = scene.camera
    left, right, bottom, top = camera.viewplane
    lights = np.stack(
        [
            light.position if isinstance(light, PointLight) else light.light_to_world[:3, 3]
            for light in scene.lights
        ]
    )
    seen_from = (lights - camera.camera_to_world[:3, 3]) @ camera.camera_to_world[:3, :3]
    x, y = seen_from[:, :2].T / -seen_from[:, 2]
    return np.stack(
        [(x - left) / (right - left) * camera.width, (y - bottom) / (top - bottom) * camera.height], -1
    )


def worst_about_lights(made: np.ndarray, truth: np.ndarray, lights: np.ndarray) -> float:
    """The largest deviation of the means about lights, signed, relative to the converged means."""
    row, column = np.mgrid[: len(truth), : truth.shape[1]] + 0.5
    found = []
    for x, y in lights:
        distance = np.hypot(column - x, row - y)
        for pixels in ABOUT:
            near = distance <= max(pixels * len(truth) / 256, 1.0)
            found.append(made[near].mean() / truth[near].mean() - 1)
    return max(found, key=abs)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="dev.py bench lights_in_frame", description=__doc__.partition("\n")[0]
    )
    add = parser.add_argument
    add("--size", type=int, default=256)
    add("--seeds", type=int, default=4)
    add("--reference-samples", type=int, default=256, help="of both converged pictures together")
    add("-o", "--output", type=Path, default=FOLDER, metavar="FOLDER")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    path = options.output / f"reference-{options.size}-{options.reference_samples}.npy"
    if not path.exists():
        np.save(path, converged(options.size, options.reference_samples))
    halves = np.load(path)
    truth, scene = halves.mean(axis=0), lights_in_frame(options.size)
    lights, rows, reached, shown = places(scene), [], [], []
    for integrator, counts in SAMPLES.items():
        for samples in counts:
            begin = time.process_time()
            pictures, rays = zip(
                *(picture(scene, integrator, samples, seed) for seed in range(options.seeds)), strict=True
            )
            seconds = (time.process_time() - begin) / options.seeds
            errors = [relative_error(made, *halves) for made in pictures]
            error = float(np.sqrt(np.mean(np.square(errors))))
            means = np.array([made.mean() for made in pictures]) / truth.mean() - 1
            spread = means.std(ddof=1) / np.sqrt(len(means)) if len(means) > 1 else np.nan
            blotch = max((worst_about_lights(made, truth, lights) for made in pictures), key=abs)
            if integrator == "control_variates":
                reached.append((samples, float(np.mean(rays)), error))
            if samples == GOAL or (integrator, samples) == ("control_variates", 1):
                shown.append((f"{integrator.replace('_', ' ')}, {samples}: {error:.4f}", pictures[0]))
            rows.append([
                integrator.replace("_", " "), f"{samples}", f"{np.mean(rays):.1f}", f"{error:.4f}",
                f"{max(errors):.4f}", f"{100 * means.mean():+.3f} +- {100 * spread:.3f} %",
                f"{100 * blotch:+.2f} %", f"{seconds:.2f}",
            ])  # fmt: skip
            print(" ".join(rows[-1]), flush=True)
    head = ("integrator", "samples", "rays a pixel", "relative RMSE", "its worst seed", "mean",
            "worst about a light", "processor seconds")  # fmt: skip
    samples, rays, errors = np.log(reached).T
    by_rays, by_samples = (np.exp(np.interp(np.log(GOAL), x, errors)) for x in (rays, samples))
    text = (
        f"{table(head, rows)}\n\nControl variates at {GOAL} rays a pixel: {by_rays:.4f}; "
        f"at {GOAL} samples: {by_samples:.4f}. "
        f"The converged picture's own error: {own_error(*halves):.4f}."
    )
    (options.output / "table.md").write_text(text + "\n", "utf-8")
    draw(options.output / "lights_in_frame.png", shown, truth)
    print(f"\n{text}")


def draw(path: Path, shown: list[tuple[str, np.ndarray]], truth: np.ndarray) -> None:
    """Pictures, and below them each pixel's error: black at 0.0003 of the mean, white at all of it."""
    gap, top, size = 8, 22, len(truth)
    pitch = gap + max(size, 256)
    canvas = Canvas(len(shown) * pitch + gap, top + 2 * (size + gap))
    for number, (label, made) in enumerate(shown):
        x = gap + number * pitch
        canvas.text(x, top / 2, label)
        canvas.image(x, top, seen(made), 1)
        error = np.abs(made - truth).mean(axis=-1) / truth.mean()
        canvas.image(x, top + size + gap, error_colours(error), 1)
    canvas.save(path)


if __name__ == "__main__":
    main()
