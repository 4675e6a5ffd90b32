# SPDX-License-Identifier: GPL-3.0-or-later
"""How a render goes: passes, tiles, progress, and what ends it."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event, get_ident

import numpy as np
import pytest
from scenes import area_light, blocks, mixed_lights, studio

from engine_core import Film, RenderError, Scene, Settings, Sink, World, render
from engine_core.geometry.surfaces import Surfaces
from engine_core.workers import Nobody, Workers


class Recorder(Sink):
    """Keeps what it was told, and cancels after a number of tiles."""

    def __init__(self, cancel_after: int | None = None) -> None:
        self.cancel_after = cancel_after
        self.tiles: list[tuple[int, int, int, int]] = []
        self.counts: list[np.ndarray] = []
        self.told: list[tuple[float, float, float | None, str]] = []
        self.threads: set[int] = set()

    def cancelled(self) -> bool:
        self.threads.add(get_ident())
        return self.cancel_after is not None and len(self.tiles) >= self.cancel_after

    def tile(self, film: Film, x0: int, y0: int, x1: int, y1: int) -> None:
        self.threads.add(get_ident())
        self.tiles.append((x0, y0, x1, y1))
        self.counts.append(film.sample_count[y0:y1, x0:x1].copy())

    def progress(self, fraction: float, elapsed: float, remaining: float | None, text: str) -> None:
        self.threads.add(get_ident())
        self.told.append((fraction, elapsed, remaining, text))


@pytest.fixture
def scene() -> Scene:
    return studio(96, 64, [area_light()])


def _covered(tiles: list[tuple[int, int, int, int]], width: int, height: int) -> np.ndarray:
    count = np.zeros((height, width), int)
    for x0, y0, x1, y1 in tiles:
        count[y0:y1, x0:x1] += 1
    return count


@pytest.mark.parametrize("size", [(96, 64), (1, 1), (1, 300), (50, 17)])
@pytest.mark.parametrize("tile_size", [0, 16])
def test_each_pass_covers_every_pixel_once(size, tile_size):
    sink = Recorder()
    film = render(
        studio(*size, [area_light()]),
        Settings(integrator="sobol", samples=5, threads=2, tile_size=tile_size),
        sink,
    )
    # Passes of 1, 1, 2 and 1 samples.
    assert (_covered(sink.tiles, *size) == 4).all()
    assert (film.sample_count == 5).all() and film.stopped_by == "samples"
    per_pass = len(sink.tiles) // 4
    for number, total in enumerate((1, 2, 4, 5)):
        part = slice(number * per_pass, (number + 1) * per_pass)
        assert (_covered(sink.tiles[part], *size) == 1).all()
        assert all((count == total).all() for count in sink.counts[part])


def test_sink_hears_from_the_callers_thread_alone(scene):
    sink = Recorder()
    render(scene, Settings(integrator="sobol", samples=4, threads=3), sink)
    assert sink.threads == {get_ident()}


def test_progress_grows_from_nothing_to_all(scene):
    sink = Recorder()
    render(scene, Settings(integrator="sobol", samples=8, threads=2), sink)
    fractions = [fraction for fraction, *_ in sink.told]
    assert fractions[0] == 0 and fractions[-1] == pytest.approx(1)
    assert fractions == sorted(fractions) and max(fractions) <= 1
    assert sink.told[-1][3] == "Sample 8/8"
    remaining = [seconds for _, _, seconds, _ in sink.told if seconds is not None]
    assert remaining and all(seconds >= 0 for seconds in remaining) and remaining[-1] < 1e-6
    elapsed = [seconds for _, seconds, *_ in sink.told]
    assert elapsed == sorted(elapsed)


def test_cancel_in_the_middle_keeps_what_is_there(scene):
    sink = Recorder(cancel_after=40)
    settings = Settings(integrator="sobol", samples=64, threads=2, tile_size=16)
    film = render(scene, settings, sink)
    assert film.stopped_by == "cancel"
    assert film.sample_count.min() >= 1 and film.sample_count.max() < 64
    # Every pixel is the honest estimate of as many samples as it says.
    for count in np.unique(film.sample_count):
        whole = render(scene, Settings(integrator="sobol", samples=int(count), threads=1, tile_size=16))
        same = film.sample_count == count
        assert np.array_equal(film.combined[same], whole.combined[same])


def test_cancel_before_anything(scene):
    film = render(scene, Settings(integrator="sobol", samples=1 << 20, threads=2), Recorder(cancel_after=0))
    assert film.stopped_by == "cancel"
    assert (film.combined[film.sample_count == 0] == 0).all()


def test_cancel_comes_soon_in_a_long_pass(scene):
    class Late(Sink):
        def __init__(self) -> None:
            self.asked = 0

        def cancelled(self) -> bool:
            self.asked += 1
            return self.asked > 30

    settings = Settings(integrator="sobol", samples=1 << 20, threads=2)
    assert render(scene, settings, Late()).stopped_by == "cancel"


def test_time_limit_ends_the_render(scene):
    film = render(scene, Settings(integrator="sobol", samples=1 << 20, threads=2, time_limit=0.2))
    assert film.stopped_by == "time"
    assert film.sample_count.min() >= 1


def test_tiny_time_limit_still_gives_every_pixel_a_sample(scene):
    film = render(scene, Settings(integrator="sobol", samples=64, threads=2, time_limit=1e-9))
    assert film.stopped_by == "time" and film.sample_count.min() >= 1


def test_noise_threshold_spends_samples_where_the_noise_is(scene):
    settings = Settings(integrator="sobol", samples=256, threads=2, noise_threshold=0.02, min_samples=8)
    sink = Recorder()
    film = render(scene, settings, sink)
    count = blocks(film.sample_count[..., None].astype(float))
    assert set(np.unique(film.sample_count)) <= {8, 16, 32, 64, 128, 256}
    assert count.min() == 8 and count.max() > 8
    assert (count == np.round(count)).all()  # a block stops as one
    reference = render(scene, Settings(integrator="sobol", samples=1024, threads=2)).combined
    error = np.sqrt(blocks((film.combined - reference)[..., :3] ** 2).mean(axis=2))
    allowed = 0.02 * np.sqrt(blocks(reference[..., :3]).mean(axis=2))
    assert (error <= allowed).mean() > 0.9


def test_noise_threshold_that_all_meet_ends_the_render(scene):
    film = render(
        scene, Settings(integrator="sobol", samples=1 << 16, threads=2, noise_threshold=1e3, min_samples=4)
    )
    assert film.stopped_by == "noise" and (film.sample_count == 4).all()


def test_noise_threshold_waits_for_the_least_samples(scene):
    film = render(scene, Settings(integrator="sobol", samples=64, noise_threshold=1e3, min_samples=64))
    assert (film.sample_count == 64).all()


def test_executor_handed_in_is_used_and_left_open(scene):
    settings = Settings(integrator="sobol", samples=4, tile_size=16)
    with ThreadPoolExecutor(2, "guest") as executor:
        first = render(scene, settings, executor=executor)
        assert executor.submit(int).result() == 0
        second = render(scene, settings, executor=executor)
    assert np.array_equal(first.combined, second.combined)
    assert np.array_equal(first.combined, render(scene, settings).combined)


def test_two_renders_at_once_do_not_disturb_each_other(scene):
    other = studio(48, 32, mixed_lights(8), world=World(0.2))
    with ThreadPoolExecutor(2) as executor:
        films = list(
            executor.map(
                lambda s: render(s, Settings(integrator="sobol", samples=8, threads=2)), (scene, other)
            )
        )
    for film, which in zip(films, (scene, other), strict=True):
        assert np.array_equal(
            film.combined, render(which, Settings(integrator="sobol", samples=8, threads=1)).combined
        )


@pytest.mark.parametrize("method", ["tile", "progress", "cancelled"])
def test_error_of_the_sink_comes_through(scene, method):
    class Broken(Recorder):
        pass

    def fail(self, *_):
        raise KeyboardInterrupt

    setattr(Broken, method, fail)
    begin = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        render(scene, Settings(integrator="sobol", samples=1 << 20, threads=2, tile_size=16), Broken())
    assert time.perf_counter() - begin < 60


def test_want_of_memory_in_a_worker_is_a_render_error(scene, monkeypatch):
    def fail(*_):
        raise MemoryError

    monkeypatch.setattr(Surfaces, "first_hit", fail)
    with pytest.raises(RenderError, match="memory"):
        render(scene, Settings(integrator="sobol", samples=4, threads=2))


def test_statistics_count_the_rays(scene):
    film = render(scene, Settings(integrator="sobol", samples=4, threads=2, light_samples=3))
    assert film.statistics["camera rays"] == 96 * 64 * 4
    assert 0 < film.statistics["shadow rays"] <= 3 * 96 * 64 * 4
    assert film.statistics["non-finite samples"] == 0
    assert film.statistics["seconds building"] >= 0 and film.statistics["seconds rendering"] > 0


def test_many_lights_cost_no_more_shadow_rays():
    films = [
        render(studio(lights=mixed_lights(count)), Settings(integrator="sobol", samples=4, light_samples=1))
        for count in (6, 200)
    ]
    few, many = (film.statistics["shadow rays"] for film in films)
    assert films[1].statistics["lights"] == 200
    assert many <= 48 * 32 * 4 and few <= 48 * 32 * 4


def test_nothing_is_written_any_more_when_a_failed_map_ends() -> None:
    workers, running, done = Workers(Nobody(), 0.0, 2), Event(), []

    def work(number: int) -> None:
        if number == 0:
            running.wait()
            raise ValueError
        running.set()
        time.sleep(0.2)
        done.append(number)

    with pytest.raises(ValueError):
        workers.map(work, [0, 1])
    assert done == [1]
    workers.close()
