# SPDX-License-Identifier: GPL-3.0-or-later
"""The same seed is the same picture, whoever renders it, in whatever order and pieces."""

from __future__ import annotations

import dataclasses
import random
import threading
from concurrent.futures import Executor, Future

import numpy as np
import pytest
from scenes import area_light, mixed_lights, studio

from engine_core import Film, PointLight, Scene, Settings, Volume, World, render

SCENES = {
    "one light": studio(lights=[area_light()]),
    "mixed lights": studio(lights=mixed_lights(12), world=World(0.1)),
}
SETTINGS = Settings(integrator="sobol", samples=8, threads=1, tile_size=16, normals=True)


class ShuffledExecutor(Executor):
    """One thread that runs what was submitted in random order."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._tasks: list = []
        self._ready = threading.Condition()
        self._closed = False
        self.order: list = []
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def submit(self, fn, /, *args, **kwargs) -> Future:
        future: Future = Future()
        with self._ready:
            self._tasks.append((future, fn, args, kwargs))
            self._ready.notify()
        return future

    def _work(self) -> None:
        while True:
            with self._ready:
                # Time for some choice, or the first to come would be the first to go.
                self._ready.wait_for(lambda: len(self._tasks) > 5 or self._closed, timeout=0.02)
                if not self._tasks:
                    if self._closed:
                        return
                    continue
                future, fn, args, kwargs = self._tasks.pop(self._random.randrange(len(self._tasks)))
            self.order.append(args[0])
            if future.set_running_or_notify_cancel():
                try:
                    future.set_result(fn(*args, **kwargs))
                except BaseException as error:
                    future.set_exception(error)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        with self._ready:
            self._closed = True
            self._ready.notify()
        self._thread.join()


@pytest.fixture(params=SCENES)
def scene(request: pytest.FixtureRequest) -> Scene:
    return SCENES[request.param]


def assert_same(a: Film, b: Film) -> None:
    for field in ("combined", "depth", "normal", "sample_count"):
        assert np.array_equal(getattr(a, field), getattr(b, field)), field


def assert_close(a: Film, b: Film) -> None:
    assert np.abs(a.combined - b.combined).max() <= 1e-5 * a.combined.max()
    assert np.array_equal(a.depth, b.depth)
    assert np.array_equal(a.sample_count, b.sample_count)


def _with(**changes) -> Settings:
    return dataclasses.replace(SETTINGS, **changes)


@pytest.mark.parametrize("integrator", ["sobol", "monte_carlo"])
def test_two_renders_are_the_same_bit_for_bit(scene, integrator):
    settings = _with(integrator=integrator, threads=2)
    assert_same(render(scene, settings), render(scene, settings))


@pytest.mark.parametrize("threads", [2, 5])
def test_thread_count_changes_no_bit(scene, threads):
    assert_same(render(scene, SETTINGS), render(scene, _with(threads=threads)))


@pytest.mark.parametrize("seed", [1, 2])
def test_order_of_tiles_changes_no_bit(scene, seed):
    with ShuffledExecutor(seed) as executor:
        film = render(scene, SETTINGS, executor=executor)
    assert_same(render(scene, SETTINGS), film)
    # Four passes over six tiles, and no two in the same order.
    passes = [tuple(map(id, executor.order[i : i + 6])) for i in range(0, 24, 6)]
    assert len(executor.order) == 24 and len(set(passes)) > 1


def test_noise_threshold_stops_the_same_blocks_whatever_the_threads(scene):
    settings = _with(samples=32, noise_threshold=0.05, min_samples=4)
    first = render(scene, settings)
    assert first.sample_count.min() < 32
    assert_same(first, render(scene, dataclasses.replace(settings, threads=5)))


@pytest.mark.parametrize("tile_size", [0, 48, 128])
def test_tile_size_does_not_matter(scene, tile_size):
    assert_close(render(scene, SETTINGS), render(scene, _with(tile_size=tile_size)))


@pytest.mark.parametrize("batch_size", [64, 1000, 65536])
@pytest.mark.parametrize("light_samples", [1, 3])
def test_batch_size_does_not_matter(scene, batch_size, light_samples):
    settings = _with(light_samples=light_samples, tile_size=128)
    assert_close(render(scene, settings), render(scene, dataclasses.replace(settings, batch_size=batch_size)))


@pytest.mark.parametrize("volumes", [(), (Volume(0.1),)])
def test_batches_may_be_smaller_than_what_one_pixel_takes(volumes):
    world = World(0.0, volume=0) if volumes else World(0.0)
    lights = [PointLight(100.0, position=(0.3, -1, 1.5))]
    scene = studio(24, 24, lights=lights, world=world, volumes=volumes)
    settings = Settings(samples=64, threads=1)
    assert_close(render(scene, settings), render(scene, dataclasses.replace(settings, batch_size=64)))


@pytest.mark.parametrize("integrator", ["sobol", "monte_carlo"])
def test_another_seed_is_another_estimate(scene, integrator):
    films = [
        render(scene, _with(integrator=integrator, seed=seed)).combined for seed in (0, 1, -1, 2**32 - 2)
    ]
    for i, film in enumerate(films):
        for other in films[i + 1 :]:
            assert (film != other)[film[..., 0] > 0].mean() > 0.5


@pytest.mark.parametrize("region", [(0, 0, 16, 16), (5, 3, 30, 29), (47, 31, 48, 32), (10, 0, 11, 32)])
def test_region_is_the_crop_of_the_whole_picture(scene, region):
    x0, y0, x1, y1 = region
    part = render(
        dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, region=region)), SETTINGS
    )
    whole = render(scene, SETTINGS)
    assert np.array_equal(part.combined, whole.combined[y0:y1, x0:x1])
    assert np.array_equal(part.depth, whole.depth[y0:y1, x0:x1])
    assert np.array_equal(part.normal, whole.normal[y0:y1, x0:x1])


def test_long_sums_do_not_depend_on_the_batch():
    # 2^14 equal samples a pixel: naive float32 sums would drift.
    scene = studio(8, 8, world=World((0.1, 0.3, 0.7)))
    settings = Settings(integrator="sobol", samples=1 << 14, threads=1, batch_size=1 << 20)
    assert_close(render(scene, settings), render(scene, dataclasses.replace(settings, batch_size=64 * 64)))
