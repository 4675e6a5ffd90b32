# SPDX-License-Identifier: GPL-3.0-or-later
"""Lasers, part by part: seconds to the error that the integrator Sobol has at 64 samples; engine_core alone.

Two scenes: `laser` with its beam in the frame, and the same with the beam above what the camera sees. Error:
root mean square difference of two seeds / sqrt 2, of the mean. Seconds: of the processor, on one thread, of
the part alone.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine_core import Laser, Scene, Settings
from engine_core.image.film import Film
from engine_core.integration.point_sets import staged_points
from engine_core.integration.sample_mean import sum_samples
from engine_core.parts import Part, cell_of, parts_of
from engine_core.render import PICTURES, Refined
from engine_core.transport.camera_hits import Pixels
from engine_core.transport.direct_light import DirectLight

from .chapters.common import table
from .scenes import core

ABOVE = 2.75
"""How far the beam is raised to be out of the frame."""

SOBOL = 64
PARTS = ("in_fog", "on_surfaces", "beam", "spot")


def laser_scene(width: int, height: int, above: bool, part: str, count: int = 1) -> Scene:
    """`laser` with one part of its light, from ``count`` beams side by side of the same power in all."""
    scene = core.example("laser", width, height)
    (one,) = (light for light in scene.lights if isinstance(light, Laser))
    lights = []
    for i in range(count):
        place = one.light_to_world.copy()
        place[:3, 3] += ABOVE * above * np.eye(3)[2]
        place[:3, 3] += 0.02 * (i - (count - 1) / 2) * np.eye(3)[1]
        shown = {name: name == part for name in PARTS}
        lights.append(replace(one, power=one.power / count, light_to_world=place, **shown))
    return replace(scene, lights=lights)


def parts(scene: Scene, settings: Settings) -> list[Part]:
    return parts_of(scene, DirectLight(scene), settings, lambda: None)


def by_sobol(scene: Scene, samples: int, seed: int) -> tuple[np.ndarray, float]:
    """Radiance (H, W, 3) and seconds."""
    settings = Settings(samples=samples, seed=seed, threads=1, integrator="sobol")
    width, height = scene.camera.region_size
    y, x = (a.ravel().astype(np.int32) for a in np.mgrid[:height, :width])
    pixels = Pixels(x, y, cell_of(x, y, scene.camera.region))
    picture, seconds = np.zeros((height * width, 3)), 0.0
    for part in parts(scene, settings):
        points = staged_points("sobol", 2, part.plain.rest_dimensions, 1, seed + 17)
        for group in points:
            group.prepare(samples)
        start = time.process_time()
        for low in range(0, len(x), 4096):
            some = pixels[np.arange(low, min(low + 4096, len(x)))]
            sums = sum_samples(part.plain, some, some.key(), points, 0, samples, 1, settings.batch_size)
            picture[low : low + 4096] += sums.values[:3].T / samples
        seconds += time.process_time() - start
    return picture.reshape(height, width, 3), seconds


def by_control_variates(scene: Scene, samples: int, seed: int) -> tuple[np.ndarray, float]:
    """Radiance (H, W, 3) and seconds."""
    settings = Settings(samples=samples, seed=seed, threads=1)
    found = parts(scene, settings)
    film = Film.empty(*scene.camera.region_size, [part.shows for part in found])
    start, pictures = time.process_time(), []
    for part, layer in zip(found, film.layers[1:], strict=True):
        picture = PICTURES[type(part.by)](part.by, settings, scene.camera.region, layer, lambda: None)
        picture.build(_in_turn, lambda: False)
        pictures.append(picture)
    # As the renderer does when all are built.
    around = sum(layer.radiance.sum(axis=2) for layer in film.layers[1:])
    for picture in pictures:
        if isinstance(picture, Refined):
            picture.allocate(_in_turn, around, float(around.mean()), None)
            for number in range(len(picture)):
                picture.refine(number, lambda done: None)
            picture.show(_in_turn)
    seconds = time.process_time() - start
    return sum(layer.radiance.astype(np.float64) for layer in film.layers[1:]), seconds


def _in_turn(function, items) -> list:
    return [function(item) for item in items]


def measured(method, scene: Scene, samples: int) -> tuple[float, float]:
    """Error and seconds, of two seeds."""
    (one, seconds), (other, again) = (method(scene, samples, seed) for seed in (11, 12))
    mean = max((one.mean() + other.mean()) / 2, 1e-300)
    return float(np.sqrt(np.square(one - other).mean() / 2) / mean), min(seconds, again)


def seconds_at(error: float, errors: Sequence[float], seconds: Sequence[float]) -> float | None:
    """Seconds at which an error is reached, between runs on a line of both logarithms; None if it is not."""
    if errors[0] <= error:
        return seconds[0]
    for i in range(1, len(errors)):
        if errors[i] <= error:
            place = np.log(errors[i - 1] / error) / np.log(errors[i - 1] / errors[i])
            return float(seconds[i - 1] * (seconds[i] / seconds[i - 1]) ** place)
    return None


def main() -> None:
    parser = argparse.ArgumentParser(prog="dev.py bench lasers", description=__doc__.partition("\n")[0])
    parser.add_argument("--size", default="640x360", metavar="WxH")
    parser.add_argument("--samples", default="1,2,4,8", help="of control variates")
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--lasers", default="", metavar="1,8,64", help="growth with their number instead")
    options = parser.parse_args()
    width, height = (int(n) for n in options.size.split("x"))
    counts = [int(n) for n in options.samples.split(",")]
    names = options.parts.split(",")
    if options.lasers:
        rows = []
        for part in names:
            for count in (int(n) for n in options.lasers.split(",")):
                scene = laser_scene(width, height, False, part, count)
                rows += [
                    [part, str(count), f"{by_control_variates(scene, n, 11)[1]:.2f}", str(n)] for n in counts
                ]
                print(rows[-1], flush=True)
        print(table(["part", "lasers", "seconds", "samples"], rows))
        return
    rows = []
    for part in names:
        for above in (True, False):
            if above and part in ("beam", "spot"):
                continue
            scene = laser_scene(width, height, above, part)
            error, seconds = measured(by_sobol, scene, SOBOL)
            runs = [measured(by_control_variates, scene, n) for n in counts]
            reached = seconds_at(error, *zip(*runs, strict=True))
            rows.append([
                part.replace("_", " "),
                "above the frame" if above else "in the frame",
                f"{error:.4f} in {seconds:.2f} s",
                *(f"{e:.4f} in {s:.2f} s" for e, s in runs),
                "not reached" if reached is None else f"{seconds / reached:.1f}x",
            ])  # fmt: skip
            print(rows[-1], flush=True)
    print(table(["part", "beam", f"Sobol, {SOBOL}", *map(str, counts), "sooner"], rows))


if __name__ == "__main__":
    main()
