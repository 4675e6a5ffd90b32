# SPDX-License-Identifier: GPL-3.0-or-later
"""The order of work, from a scene to a film: what is built, what is sampled, in tiles and passes."""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from threading import Lock
from typing import Any

import numpy as np

from .directly_seen import directly_seen
from .edge_samples import EdgeSamples
from .errors import RenderError
from .image.film import FAR, Film
from .integration.mapping import Map
from .net_picture import CELL, TILE, NetPicture
from .part_pictures import AroundLightsPicture, SeenPicture, TargetsPicture
from .parts import AroundLights, OverNet, OverScreen, Seen, Targets, parts_of, pixels_at
from .plain_picture import PlainPicture, Tile
from .refinement import ControlVariatePicture, obstacles
from .scene import Camera, Scene
from .screen_picture import ScreenPicture
from .seen_through_lens import seen_through_lens
from .settings import Settings
from .transport.direct_light import CAMERA, NON_FINITE, DirectLight, DirectLightOverTile
from .transport.guide_on_surfaces import guide_of_sky
from .transport.lens_targets import LensTargets
from .workers import Nobody, Sink, Workers

PICTURES = {
    OverScreen: ScreenPicture,
    OverNet: NetPicture,
    Seen: SeenPicture,
    Targets: TargetsPicture,
    AroundLights: AroundLightsPicture,
}
"""What makes a part's layer."""

Refined = ScreenPicture | AroundLightsPicture
"""Of these, what samples are taken of when all are built."""

Built = tuple[Refined | NetPicture | SeenPicture | TargetsPicture, float]
"""A part's picture, and the seconds that it took to build."""

FEW_LIGHTS = 32
"""Up to which a choice among them costs nothing, so that surfaces may be looked at before."""

BESIDE, SHARE_BESIDE = 2.0, 0.5
"""Surfaces have twice their samples as long as their noise is so many times that of what is beside them, and
their rays are no more than this part of those that were traced until then, most of them of fog and lasers."""

DEPTH_ROWS, ROWS = 16, 64
"""Of the picture, whose depth is looked for at once, and whose brightness."""


def render(
    scene: Scene,
    settings: Settings | None = None,
    sink: Sink | None = None,
    executor: Executor | None = None,
) -> Film:
    """Render a scene. Returns the film, also when cancelled (`Film.stopped_by` says why it ended).

    executor : runs the tiles on threads of this process (they write into one film); its own if None.
    """
    try:
        # What over- or underflows in a scene of extreme sizes is dealt with where it matters.
        with np.errstate(all="ignore"):
            return _Render(scene, settings or Settings(), sink or Nobody(), executor).run()
    except MemoryError as error:
        raise RenderError(
            "not enough memory for this scene; use fewer or simpler instances, or a smaller picture"
        ) from error


class _Render:
    def __init__(self, scene: Scene, settings: Settings, sink: Sink, executor: Executor | None) -> None:
        self._threads = settings.threads or os.cpu_count() or 1
        self._workers = Workers(sink, settings.time_limit, self._threads, executor)
        self._settings = settings
        self._sink = sink
        self._camera: Camera = scene.camera
        sink.progress(0.0, 0.0, None, "Building the scene")
        self._integrand = DirectLight(
            scene,
            settings.transparent,
            settings.normals,
            settings.direct_sampling,
            settings.transparent_bounces,
        )
        self._parts = parts_of(scene, self._integrand, settings, self._workers.check)
        # Parts without noise alone know no lens.
        no_lens = self._integrand.screen_dimensions == 2
        built = settings.integrator == "control_variates" or settings.integrator == "cv_only" and no_lens
        self._built = [part for part in self._parts if built and part.by is not None]
        self._plainly = [part for part in self._parts if part not in self._built]
        # A picture of what is black needs its depth alone.
        self._sampled = self._integrand.shows or bool(self._plainly)
        shown = [part.shows for part in self._parts]
        asked = settings.terms, settings.standard_error, settings.normals
        self._film = Film.empty(*scene.camera.region_size, shown, self._sampled, *asked)
        self._film.messages += self._integrand.messages
        self._surface = self._film.of_surfaces()
        self._layers = {
            part.name: layer for part, layer in zip(self._parts, self._film.layers[1:], strict=True)
        }
        self._plain = PlainPicture(
            self._integrand,
            [(part, self._layers[part.name]) for part in self._plainly],
            self._surface,
            scene.camera,
            settings,
            self._threads,
            self._workers.check,
        )
        self._sampled_once = False
        self._counts: Counter[str] = Counter()
        self._counting = Lock()
        self._integrals = {"control variate": f"skipped: the integrator is {settings.integrator}"}
        if not self._parts:
            self._integrals["volume"] = "skipped: there is none that light reaches"
        self._regions = self._nodes = 0
        self._stages = {"seconds control variate": 0.0, "seconds sampling": 0.0}
        self._workers.begin()

    def run(self) -> Film:
        try:
            ended = self._by_control_variates()
            if ended is None and not self._sampled:
                ended = self._look_for_depth() if self._settings.depth else "samples"
            elif ended is None:
                ended = self._begin_plain()
                begin = time.perf_counter()
                ended = ended or self._passes()
                self._stages["seconds sampling"] += time.perf_counter() - begin
                if self._settings.standard_error:
                    self._plain.finish()
            self._film.stopped_by = ended
            self._compose()
        finally:
            self._workers.close()
        self._report()
        return self._film

    # -- control variates --------------------------------------------------------------------------

    def _by_control_variates(self) -> str | None:
        """Build and show all, then refine it; returns why it ended, None if surfaces want plain samples."""
        surfaces, ended = None, self._learn()
        if not ended:
            surfaces, ended = self._build_surfaces()
        parts = []
        if not ended and surfaces is None and self._integrand.shows and self._built:
            # Plain samples come in any case, and the first ones tell what of the fog's noise they hide.
            ended = self._begin_plain(share=0.0)
        if not ended:
            parts, ended = self._build_parts(surfaces)
        ended = self._refine_parts(parts, surfaces, ended)
        if not ended:
            self._share_out(parts, surfaces)
        if surfaces is None:
            return ended
        begin = time.perf_counter()
        ended = ended or self._refine(surfaces)
        if self._settings.standard_error and self._settings.integrator != "cv_only":
            surfaces.finish()
        self._stages["seconds sampling"] = time.perf_counter() - begin
        self._count(surfaces.integrand)
        return ended or "samples"

    def _learn(self) -> str | None:
        """By which part of the sky surfaces are lit; returns why that was stopped, if it was."""
        settings, integrand, region = self._settings, self._integrand, self._camera.region
        by_sky = integrand.reflects and integrand.lights.of_world.size
        if not by_sky or settings.integrator not in ("control_variates", "cv_only"):
            return None
        begin = time.perf_counter()

        def learn(map_: Map, enough: Callable[[], bool]) -> None:
            at = partial(pixels_at, region), region, settings.seed, settings.samples
            integrand.guide, pilots = guide_of_sky(integrand, *at, map_, self._workers.check)
            # They are not of what fog took, by which surfaces have more samples.
            for pilot in pilots:
                self._plain.counts.update(pilot.counts)

        outcome, ended = self._workers.drive(learn, "Looking for the sky")
        if not ended:
            outcome.result()
        self._stages["seconds guide"] = time.perf_counter() - begin
        return ended

    def _build_surfaces(self) -> tuple[ControlVariatePicture | None, str | None]:
        """None if plain samples serve this picture better; and why it was stopped, if it was."""
        settings = self._settings
        alone = settings.integrator == "cv_only"
        if settings.integrator != "control_variates" and not alone:
            return None, None
        why = obstacles(self._integrand)
        if why:
            if alone:
                self._film.messages.append(
                    f"CV Only can't serve this scene ({why}): it is sampled as by Sobol"
                )
            self._integrals["control variate"] = f"skipped: {why}"
            return None, None
        begin = time.perf_counter()
        picture = ControlVariatePicture(
            self._integrand, settings, self._camera.region, self._surface, self._workers.check
        )
        outcome, ended = self._workers.drive(picture.build, "Building the control variate")
        built = time.perf_counter()
        self._regions, self._nodes = picture.regions, picture.nodes
        self._stages["seconds control variate"] = built - begin
        if ended or not outcome.result():
            given_up = "stopped while it was built" if ended else "polynomials would not pay"
            self._integrals["control variate"] = f"given up: {given_up}"
            self._count(picture.integrand)
            return None, ended
        self._integrals["control variate"] = picture.told
        self._show_all()
        return picture, None

    def _show(self, x0: int, y0: int, x1: int, y1: int) -> None:
        if self._sink.watched:
            self._film.compose(x0, y0, x1, y1)
            self._sink.tile(self._film, x0, y0, x1, y1)

    def _show_all(self) -> None:
        if self._sink.watched:
            self._compose()
            self._sink.tile(self._film, 0, 0, *self._camera.region_size)

    def _compose(self) -> None:
        if len(self._film.layers) == 1:
            return
        width, height = self._camera.region_size
        self._workers.map(lambda low: self._film.compose(0, low, width, low + ROWS), range(0, height, ROWS))

    # -- fog and lasers ----------------------------------------------------------------------------

    def _build_parts(self, surfaces: ControlVariatePicture | None) -> tuple[list[Built], str | None]:
        """Pictures of fog and lasers, built and shown; and why it was stopped, if it was."""
        built, ended = [], None
        if not self._built:
            return built, ended
        beside: dict[str, Any] = {}
        for part in self._built:
            begin, by, layer = time.perf_counter(), part.by, self._layers[part.name]
            while by is not None and not ended:
                picture = PICTURES[type(by)](
                    by, self._settings, self._camera.region, layer, self._workers.check
                )
                build = picture.build
                if isinstance(picture, NetPicture):
                    shown = [other.radiance[..., :3] for other in self._film.layers[1:] if other is not layer]
                    around = sum(float(radiance.mean(dtype=np.float64)) for radiance in shown)
                    beside = beside or self._beside(surfaces)
                    build = partial(build, around=around, **beside)
                outcome, ended = self._workers.drive(build, f"Building {part.name}")
                if not ended:
                    outcome.result()
                given_up = isinstance(picture, ScreenPicture) and not picture.built
                instead = by.otherwise if given_up and not ended else None
                by = None
                if instead is not None:
                    # It looks at the scene, which may be given up as well.
                    outcome, ended = self._workers.drive(
                        lambda _, __, make=instead: make(), f"Building {part.name}"
                    )
                    by = None if ended else outcome.result()
            if not ended:
                self._show_all()
            built.append((picture, time.perf_counter() - begin))
            if ended:
                break
        return built, ended

    def _beside(self, surfaces: ControlVariatePicture | None) -> dict[str, Any]:
        """What is told to nets of the noise of surfaces: how many points are worth it depends on that."""
        sampled = self._plain if self._sampled_once else surfaces
        if sampled is None:
            return {"noise": None}
        return {"noise": sampled.noise, "hiding": sampled.hiding(TILE * CELL)}

    def _refine_parts(
        self, parts: list[Built], surfaces: ControlVariatePicture | None, ended: str | None
    ) -> str | None:
        """Sample what was built, unless it is ``ended``; returns why it was stopped, if it was."""
        # What is worth a sample depends on all that is shown.
        beside = None
        refined = any(isinstance(picture, Refined) for picture, _ in parts)
        if refined and not ended and self._settings.integrator == "control_variates":
            if surfaces is not None:
                a_sample = surfaces.deviation_a_sample
            else:
                a_sample = self._plain.deviation_a_sample() if self._sampled_once else None
            beside = *self._brightness(), a_sample
        for part, (picture, seconds) in zip(self._built, parts, strict=False):
            begin = time.perf_counter()
            if isinstance(picture, Refined):
                if beside is not None and not ended:
                    ended = self._refine_part(picture, part.name, *beside)
                picture.show(self._workers.map)
                self._show_all()
            self._regions, self._nodes = self._regions + picture.regions, self._nodes + picture.nodes
            self._integrals[part.name] = picture.told
            stages = picture.seconds | {"in all": seconds + time.perf_counter() - begin}
            self._stages |= {f"seconds {part.name}, {stage}": s for stage, s in stages.items()}
            self._counts.update(part.counts())
        return ended

    def _share_out(self, parts: list[Built], surfaces: ControlVariatePicture | None) -> None:
        """Give surfaces more samples where they cost little beside what fog and lasers took, and are most of
        the noise.
        """
        settings = self._settings
        beside = [picture.noise for picture, _ in parts if isinstance(picture, NetPicture | ScreenPicture)]
        if not beside or settings.integrator != "control_variates" or settings.noise_threshold:
            return
        if surfaces is not None:
            sampled, told = surfaces, surfaces.noise_of_halves(self._workers.map)
        elif self._sampled_once:
            sampled, told = self._plain, self._plain.noise_of_halves()
        else:
            return
        rays, others = sampled.rays, sum(self._counts.values())

        def times(noise: float) -> int:
            many = 1
            while noise > BESIDE * math.hypot(*beside) and 0 < rays * many <= SHARE_BESIDE * others:
                noise, many = noise / 2**0.75, 2 * many
            return many

        # Of each half of a chessboard as the other half tells: samples that call for more are brighter than
        # others, and stay.
        if told:
            sampled.take_more((times(told[1]), times(told[0])))

    def _brightness(self) -> tuple[np.ndarray, float]:
        """Radiance (H, W) of fog and lasers as built, and the mean of all but lamps; channels summed."""
        around = np.zeros(self._film.depth.shape, np.float32)

        def add(low: int) -> None:
            for layer in self._film.layers[1:]:
                around[low : low + ROWS] += np.einsum("yxc->yx", layer.radiance[low : low + ROWS])

        self._workers.map(add, range(0, len(around), ROWS))
        bright = float(around.mean(dtype=np.float64))
        if self._integrand.shows and len(self._integrand.lights) <= FEW_LIGHTS:
            bright += float(np.square(np.sqrt(self._plain.few_pixels().sum(axis=0)).mean()))
        return around, bright

    def _refine_part(self, picture: Refined, name: str, *beside: np.ndarray | float | None) -> str | None:
        """Sample what is built leaves. beside : as in `ScreenPicture.allocate`."""
        outcome, ended = self._workers.drive(
            lambda map_, _: picture.allocate(map_, *beside), f"Sampling {name}"
        )
        if not ended:
            outcome.result()
            ended = self._sample_part(picture, name)
        return ended

    def _sample_part(self, picture: Refined, name: str) -> str | None:
        workers = self._workers
        workers.expect(sum(picture.work(number) for number in range(len(picture))))
        pending = {workers.submit(picture.refine, n, workers.advance): n for n in range(len(picture))}
        ended = workers.wait(
            pending, lambda future, _: future.result(), lambda: f"Sampling {name}", always=True
        )
        picture.finish()
        return ended

    def _refine(self, picture: ControlVariatePicture) -> str | None:
        """Passes over the tiles that double the samples each time; returns why they were stopped."""
        work = [[picture.work(n, p) for n in range(len(picture))] for p in range(picture.passes)]
        total, before, workers = max(sum(map(sum, work)), 1), 0.0, self._workers

        def finish(future: Future, number: int) -> None:
            future.result()
            self._show(*picture.box(number))

        for pass_, samples in enumerate(work):
            workers.expect(sum(samples))
            # The largest first, so that no thread ends up with it alone.
            order = sorted((n for n in range(len(picture)) if samples[n]), key=lambda n: -samples[n])
            pending = {workers.submit(picture.refine, n, pass_, workers.advance): n for n in order}
            share = sum(samples) / total
            ended = workers.wait(
                pending,
                finish,
                lambda pass_=pass_: f"Refining, pass {pass_ + 1} of {picture.passes}",
                before,
                share,
                always=pass_ == 0,
            )
            if ended:
                return ended
            before += share
        return None

    def _look_for_depth(self) -> str:
        """All that there is to see of black surfaces: how far they are, in the middle of each pixel."""
        (x0, y0, x1, y1), film = self._camera.region, self._surface

        def look(low: int) -> None:
            self._workers.check()
            y, x = (a.ravel() for a in np.mgrid[low : min(low + DEPTH_ROWS, y1), x0:x1])
            depth = np.minimum(self._integrand.depth(x, y), FAR)
            film.depth[low - y0 : low - y0 + DEPTH_ROWS] = depth.reshape(-1, x1 - x0)

        outcome, ended = self._workers.drive(
            lambda map_, _: map_(look, range(y0, y1, DEPTH_ROWS)), "Looking for depth"
        )
        if not ended:
            outcome.result()
            film.sample_count[:] = 1
            self._counts[CAMERA] += film.depth.size
        return ended or "samples"

    # -- plain samples -----------------------------------------------------------------------------

    def _see(self) -> str | None:
        """Integrate apart what camera rays see by themselves, if lamps may be among it: returns why it was
        stopped, if it was.
        """
        integrand, (x0, y0, x1, y1) = self._integrand, self._camera.region
        if self._settings.integrator != "control_variates" or not integrand.sees:
            return None
        eye = DirectLightOverTile(integrand, None, self._workers.check, reflects=False)
        lens, window = integrand.screen_dimensions > 2, (x0, y0, x1 - x0, y1 - y0)
        if not (lens or integrand.stage.images_of_lights(window).any()):
            return None

        def build(map_: Map, enough: Callable[[], bool]) -> None:
            settings, region, check = self._settings, self._camera.region, self._workers.check
            if not lens:
                self._plain.seen = directly_seen(eye, integrand.stage, region, settings, map_)
            elif len(targets := LensTargets.of_lamps(integrand.stage)):
                at = targets, region, settings, settings.seed + 1
                self._plain.see(*seen_through_lens(eye.first, *at, map_, enough, check))

        outcome, ended = self._workers.drive(build, "Looking at lamps")
        if not ended:
            outcome.result()
        # Many points through a lens are not of what fog took, by which surfaces have more samples.
        (self._plain.counts if lens else self._counts).update(eye.counts)
        return ended

    def _begin_plain(self, share: float | None = None) -> str | None:
        """The first sample of every pixel, once; returns why that was stopped, if it was.

        share : of the whole render that is done then; None where samples are all of it.
        """
        if self._sampled_once:
            return None
        self._sampled_once, begin = True, time.perf_counter()
        ended = self._see()
        if not ended:
            self._plain.begin()
            ended = self._pass(self._plain.due(), 0, 1, share)
        if share is not None:
            self._workers.expect(0)
        self._stages["seconds sampling"] += time.perf_counter() - begin
        return ended

    def _passes(self) -> str:
        """Passes over all tiles that double the samples each time; returns why they ended."""
        plain, done = self._plain, 1
        while done < plain.samples:
            tiles = plain.due()
            if not tiles:
                return "noise"
            count = min(done, plain.samples - done)
            ended = self._pass(tiles, done, count)
            if ended:
                return ended
            done += count
        return self._more_at_edges() or "samples"

    def _more_at_edges(self) -> str | None:
        """`EdgeSamples`, where they are worth it; returns why they were stopped, if they were."""
        settings, integrand = self._settings, self._integrand
        exact = integrand.samples_every or (integrand.only_points and len(integrand.lights) == 1)
        plain = bool(self._plainly)
        if settings.integrator != "control_variates" or settings.noise_threshold or not exact or plain:
            return None
        edges = EdgeSamples(
            integrand,
            self._surface,
            self._camera.region[:2],
            self._plain.points,
            self._plain.of_halves,
            settings.batch_size,
            self._workers.check,
            self._plain.seen_in,
        )
        self._workers.expect(edges.samples)

        def add(have: int, many: int, rows: np.ndarray) -> None:
            self._count(edges.add(have, many, rows))
            self._workers.advance(have * (many - 1) * len(rows))

        pending = {self._workers.submit(add, *one): None for one in edges.work}
        ended = self._workers.wait(
            pending, lambda future, _: future.result(), lambda: "Sampling edges", 0.99, 0.01
        )
        self._show_all()
        return ended

    def _pass(self, tiles: list[Tile], start: int, count: int, share: float | None = None) -> str | None:
        plain, samples, workers = self._plain, self._plain.samples, self._workers
        plain.prepare(start + count)
        pixels = sum(int((tile.x1 - tile.x0) * (tile.y1 - tile.y0)) for tile in tiles)
        of_halves = (min(count, max(of_half - start, 0)) for of_half in plain.of_halves)
        workers.expect(pixels * sum(of_halves) // 2)
        share = count / samples if share is None else share
        pending = {workers.submit(plain.sample, tile, start, count, workers.advance): tile for tile in tiles}

        def text() -> str:
            return f"Sample {start + int(count * workers.part())}/{samples}"

        # A first sample everywhere comes before any limit, or there would be holes.
        return workers.wait(pending, self._finish, text, start / samples, share, always=start == 0)

    def _finish(self, future: Future, tile: Tile) -> None:
        future.result()
        x0, y0 = self._camera.region[:2]
        self._show(tile.x0 - x0, tile.y0 - y0, tile.x1 - x0, tile.y1 - y0)

    # -- in the workers ----------------------------------------------------------------------------

    def _count(self, spent: DirectLightOverTile) -> None:
        """Add up what evaluations cost; called once for a tile, so that it costs nothing itself."""
        with self._counting:
            self._counts.update(spent.counts)

    def _report(self) -> None:
        end, began, built = time.perf_counter(), self._workers.began, self._workers.built
        film = self._film
        self._counts.update(self._plain.counts)
        for part in self._plainly:
            self._counts.update(part.counts())
        if self._counts[NON_FINITE]:
            film.messages.append(
                f"{self._counts[NON_FINITE]} light samples were not finite and count as black; "
                "check the scene for lights and objects of extreme size or power."
            )
        film.statistics = {
            **self._integrals,
            "lights": len(self._integrand.lights),
            "regions": self._regions,
            "nodes": self._nodes,
            "samples": int(film.sample_count.sum()),
            **self._counts,
            "threads": self._threads,
            "seconds building": built - began,
            **{f"seconds {stage}": seconds for stage, seconds in self._integrand.seconds.items()},
            **self._stages,
            "seconds rendering": end - built,
            "seconds total": end - began,
        }
