# SPDX-License-Identifier: GPL-3.0-or-later
"""What a picture is the sum of beside its surfaces: the light of fog and of lasers, an integral each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from .geometry.vectors import dot, take
from .image.film import LASER, VOLUME
from .integration.inner_rules import InnerRule
from .integration.integrand import FirstStage, StagedIntegrand
from .integration.mapping import Map
from .integration.standard_error import box_sums
from .scene import Scene
from .settings import Settings
from .transport.around_light import (
    HALF_WIDTH,
    AroundLight,
    Block,
    Wedge,
    blocks,
    lit_angles,
    peaks,
    tamed,
    wedges,
)
from .transport.camera_hits import Pixels
from .transport.direct_light import DirectLight
from .transport.fog_rays import FogRays
from .transport.glow_in_fog import ScatteredGlow
from .transport.guide import DIMENSIONS, Guide
from .transport.laser_in_fog import LaserInFog
from .transport.laser_on_surfaces import LaserOnSurfaces, Reflection
from .transport.laser_seen import LasersSeen, beside_beams
from .transport.lasers import Lasers, Stretch
from .transport.lens_targets import LensTargets
from .transport.light_choice_in_fog import FogChoice
from .transport.light_clusters import CELL
from .transport.line_integrals import BISECTIONS
from .transport.openings import open_worlds
from .transport.ray_rule import (
    ALL,
    RAY_POINTS,
    AlongRay,
    NextToLight,
    PointsOfRay,
    ScatteredAlongRay,
)
from .transport.scattered_light import ScatteredLight
from .transport.shadows import Shadows
from .transport.silhouettes import Silhouettes
from .transport.single_scattering import EVERY, SingleScattering
from .transport.through_lens import Lamp, ThroughLens, beside_images

Region = tuple[int, int, int, int]

SHADOW_RAYS = 2
"""In fog, to each light, for each of `Settings.samples`: whole rays with many bring more than a sample of a
surface does."""

NEXT_POINTS = 2
"""Of a ray next to one of many lights in the picture."""

AROUND_LIGHTS = 2, 2
"""Nodes and checks of a whole ray next to a light in the picture. Most of what it brings comes from there,
where little stands in the way, and a pixel there has many rays."""

MOST_BARE, MOST_SIZED = 128, 16
"""Lights without size whose whole rays are looked at: of more, some are chosen at every sample. And lights
with a size, up to which pixels about lights in the picture are integrated by themselves."""

RAYS_OF_MANY = 20, 12, 9
"""Of more than `ALL` lights: what a node, a sample, and a sample of a pixel of no polynomial cost, in rays to
each."""

LIGHT_POINTS, FEW_LIGHT_POINTS, FEW_OF_MANY_LIGHTS, GLOW_POINTS = 16, 4, 8, 32
"""Of the net of lights with a size, in fog, in a picture of one sample, and where surfaces' noise is far more
than the net's, if all lights are sampled and if one of many is; and of that of glowing fog, whose points
are in a direction and not on a light, of which they know where it is."""

SMALL, MOST_SMALL = 0.05, 128
"""Radius of a light over its distance of rays, of half of these at most, and of suns the sine of half their
angle, so that whole rays see it as a few points; wider ones have nets. And up to how many lights."""

MOST_BLUR = 16
"""Pixels by which a narrow beam is taken to be wider through a lens, at most."""

WIDER = 0.15
"""Radians by which a spot's cone is taken to be wider to either side, from all over a lens."""

RAYS_ASKED = 16
"""Along either edge of the picture, how many rays tell that distance."""

NOISY = 0.07
"""Of what suns bring, deviation along whole rays from which on a net serves them better; and of what any
light does where shadows are coloured, which makes these rays dear."""

FOLLOWED, MOST_FOLLOWED = 24, 64
"""Lights in whose cones rays are, in the mean, up to which a net's points are of all lights: so they are
followed, which points of one of many are not. And lights in all.
"""

LEARNING = 1 / 16
"""Of the points of all pixels if each asked for a whole net, what pilots may spend on what a net's points
follow: about as much as corners of cells do."""

FOG_POINTS, SURFACE_POINTS = 32, 16
"""Of the net of a laser in a picture of one sample: in fog, where it has two dimensions; on surfaces."""

BESIDE = 2.0
"""Pixels to either side of a beam, which no polynomial serves."""

SEEN_POINTS, MOST_SEEN_POINTS = (64, 2048), 4096
"""Of each pixel that sees a beam, and of each that sees where one ends, in a picture of one sample. Of more
samples, as many times as many, up to the last."""

HIDDEN_PART, FEW_HIDDEN = 4, 8
"""Of the points of a laser's net in fog, one in so many does where noise beside is far more than the net's;
and so many at least."""

FEW_POINTS, MANY_LASERS = 16, 12
"""Of the net of several lasers, whose light is their sum, at least; on surfaces, of so many, half of that."""


@dataclass(frozen=True, eq=False)
class Seen:
    """An integral over the pixel alone, the sum of several.

    touched : of pixels, which (B',) see anything of one of these.
    means : its radiance (3, B') there and its standard error, at points (2, B', S) of their unit squares.
    points : S.
    """

    touched: tuple[Callable[[Pixels], np.ndarray], ...]
    means: tuple[Callable[[Pixels, np.ndarray], tuple[np.ndarray, np.ndarray]], ...]
    points: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Targets:
    """An integral over the pixel and a lens, of what is small behind that.

    first : its radiance, as of `seen_through_lens`. of_lens : makes all that there is to see.
    """

    first: Callable[[Pixels, np.ndarray], FirstStage]
    of_lens: Callable[[], LensTargets]


@dataclass(frozen=True, eq=False)
class OverScreen:
    """How a control variate over the screen alone serves an integral.

    whole, rule : an unbiased estimate with little noise; and how nodes integrate it, without.
    rays : to each light, that either takes, about.
    alone, alone_rays : what samples pixels of no polynomial, and how many rays to each light that takes.
    outlines : of a region of the picture and a map_ of the workers, (W, H) bool: pixels of no polynomial.
    elsewhere : (W, H) bool, pixels that another part takes; None for none.
    wedges : parts of the picture that no region knows whose nodes all lie beside them.
    bodies : of a region of the picture and a map_, which bodies of fog are seen, as `silhouettes`.
    otherwise : makes what serves it better where polynomials are given up; None if samples of ``alone`` do.
    followed : whether that follows every light, and is better wherever shadows are everywhere.
    """

    whole: StagedIntegrand
    rule: InnerRule
    rays: int
    alone: StagedIntegrand
    alone_rays: int
    outlines: Callable[[Region, Map], np.ndarray]
    elsewhere: np.ndarray | None
    wedges: tuple[Wedge, ...]
    bodies: Callable[[Region, Map], np.ndarray | None]
    otherwise: Callable[[], OverNet] | None = None
    followed: bool = False


@dataclass(frozen=True, eq=False)
class OverNet:
    """An integral by a net of points that are followed over the picture, each for itself.

    integrand : all of it. points : of the net, a power of two; on average over the picture.
    outlines, elsewhere : as in `OverScreen`. at_outlines : samples of a pixel that an outline crosses, over
        the points that pixels around have.
    learn : called with a map_ of the workers before any point is asked for; None for nothing.
    expected : (N,) of N camera rays, by their first stage, what is expected of them, in any unit and apart
        from shadows; None if that is alike everywhere. No random number must have a part in it.
    chooses : whether a point chooses among lights: what it follows may be another one's anywhere then.
    fewest : points that do where noise of what is shown beside hides that they are few; 0 if as many as said
        are taken whatever that is.
    more : whether more than are said are worth it where what these are wrong by would be a pattern.
    on_line : whether points differ by their first dimension, and hardly by others.
    """

    integrand: StagedIntegrand
    points: int
    outlines: Callable[[Region, Map], np.ndarray]
    elsewhere: np.ndarray | None = None
    at_outlines: int = 1
    learn: Callable[[Map], None] | None = None
    expected: Callable[[Any, int], np.ndarray] | None = None
    chooses: bool = False
    fewest: int = 0
    more: bool = False
    on_line: bool = False


@dataclass(frozen=True, eq=False)
class AroundLights:
    """Pixels about lights that the camera sees, in fog, or about where lasers end, or begin at a surface.

    blocks : of each light. own : for each block the integrand of the light itself. others : and of all
        others, with their number, those whose images are not far by themselves.
    """

    blocks: list[Block]
    own: list[StagedIntegrand]
    others: list[list[tuple[StagedIntegrand, int]]]


@dataclass(frozen=True, eq=False)
class Part:
    """One integral over every pixel.

    name, shows : for people; and which pass it belongs to (`image.film.VOLUME` or `LASER`).
    plain : a sample is one point of all its dimensions. split : of the rest for each camera ray.
    by : what serves it better; None for nothing.
    """

    name: str
    shows: str
    plain: StagedIntegrand
    split: int
    by: OverScreen | OverNet | Seen | Targets | AroundLights | None

    def counts(self) -> Counter[str]:
        """Rays by kind, and what was not finite, so far."""
        integrands = [self.plain]
        if isinstance(self.by, OverNet):
            integrands = [self.by.integrand]
        elif isinstance(self.by, OverScreen):
            integrands += [self.by.whole, self.by.alone]
        elif isinstance(self.by, AroundLights):
            integrands += [*self.by.own, *(one for one, _ in chain.from_iterable(self.by.others))]
        every = [integrand.counts for integrand in integrands]
        return sum({id(counts): counts for counts in every}.values(), Counter())


def parts_of(
    scene: Scene, surfaces: DirectLight, settings: Settings, check: Callable[[], None]
) -> list[Part]:
    """The integrals that a scene has; none where there is neither fog nor a laser.

    check : called before every batch; may raise, to give up.
    """
    parts: list[Part] = []
    scattering = None
    outlines = Silhouettes(surfaces.stage.rays, surfaces.surfaces, surfaces.media)
    if surfaces.media is not None:
        scattering = SingleScattering(
            surfaces.frame,
            surfaces.media,
            surfaces.lights,
            surfaces.surfaces,
            surfaces.shader,
            surfaces.stage.rays,
            settings,
        )
        parts += _of_fog(scattering, scene.camera.region, outlines, settings, check)
        if surfaces.media.emits and surfaces.media.scattering.any():
            glow = ScatteredGlow(scattering, surfaces.shadows, check)
            by = OverNet(glow, _growing(GLOW_POINTS, settings.samples), outlines)
            parts.append(Part("fog lit by fog", VOLUME, glow, 1, by))
    # Their fog is their own business.
    shadows = Shadows(surfaces.surfaces, surfaces.shader, settings.transparent_bounces)
    lasers = Lasers.of(scene, surfaces.frame, surfaces.media, shadows)
    if lasers is not None:
        surfaces.messages += lasers.messages
        parts += _of_lasers(lasers, scene, surfaces, scattering, shadows, outlines, settings, check)
    if surfaces.screen_dimensions > 2:
        parts = [_with_lens(part) for part in parts]
    return parts


def _of_fog(
    scattering: SingleScattering,
    region: Region,
    outlines: Silhouettes,
    settings: Settings,
    check: Callable[[], None],
) -> list[Part]:
    rays, lens = scattering.rays, scattering.screen_dimensions > 2
    by_net = settings.integrator == "control_variates" or settings.integrator == "cv_only" and not lens
    parts, rest, elsewhere, calm = [], scattering.sized, None, None
    bare, small = scattering.sizeless, scattering.small
    if len(bare) > MOST_BARE:
        bare, rest = bare[:0], np.union1d(bare, rest)
    coloured = scattering.surfaces.any_transparent
    opened = by_net and open_worlds(
        scattering, rest, partial(pixels_at, region), region, settings.seed, check
    )
    by_phase = None
    if scattering.is_peaked and rest.size:
        lamps, sine = np.setdiff1d(rest, scattering.of_mesh), np.zeros(len(scattering.lights))
        sine[lamps] = _of_distance(scattering, lamps, _asked(scattering, region))
        by_phase = scattering.shares_of_phase(sine)
    if not by_net:
        small = small[:0]
        if coloured:
            # One point each would be dear, and one of all is chosen.
            bare, rest = bare[:0], np.union1d(bare, rest)
    elif small.size or coloured and bare.size:
        asked = _asked(scattering, region)
        small = small[_of_distance(scattering, small, asked) < SMALL]
        small = small if len(small) <= MOST_SMALL else small[:0]
        doubtful = small if coloured else small[scattering.sine[small] > 0]
        if _noise_along(scattering, doubtful, asked, check) > NOISY:
            small = np.setdiff1d(small, doubtful)
        if coloured and _noise_along(scattering, bare, asked, check) > NOISY:
            bare, rest = bare[:0], np.union1d(bare, rest)
    if by_net and lens and len(bare) + len(small) > ALL:
        # Of many, points of each of a lens' rays would be dear.
        bare, small, rest = bare[:0], small[:0], np.union1d(bare, rest)

    def integrands(lights: np.ndarray) -> list[StagedIntegrand]:
        """Of lights of all kinds: whole rays of those without size and small ones, points of the others."""
        found: list[StagedIntegrand] = []
        if (of_rays := np.intersect1d(lights, np.union1d(bare, small))).size:
            looks, checks = AROUND_LIGHTS
            found.append(
                ScatteredAlongRay(scattering, of_rays, check, looks, looks, checks=checks, several=False)
            )
        if (of_rest := np.setdiff1d(np.intersect1d(lights, rest), small)).size:
            found.append(ScatteredLight(scattering, of_rest, None, check, by_phase))
        return [ThroughLens(one) for one in found] if lens else found

    def and_beams(beams: np.ndarray | None) -> Callable[[Region, Map], np.ndarray]:
        return lambda region, map_: outlines.with_fog(region, map_) | (False if beams is None else beams)

    def beams_of(lights: np.ndarray) -> dict[int, Wedge]:
        return wedges(scattering.rays, scattering.lights, scattering.cones, lights)

    def and_narrow(of_spots: dict[int, Wedge]) -> Callable[[Region, Map], np.ndarray]:
        if not (by_net and of_spots):
            return and_beams(None)
        narrow = tamed(scattering.rays, scattering.lights, of_spots, [], region).beams
        if lens:
            blur = _blur_in_pixels(scattering, np.array(list(of_spots)))
            wider = int(np.ceil(min(blur.max(), MOST_BLUR)))
            narrow = box_sums(narrow[None].astype(np.float64), wider)[0] > 0.5
        return and_beams(narrow)

    def and_blurred(lights: np.ndarray, near: Sequence[Lamp]) -> Callable[[Region, Map], np.ndarray]:
        """And where rays through a lens may meet lights (L,) that have none of their own."""
        narrow, others = and_narrow(beams_of(lights)), np.setdiff1d(lights, [lamp.number for lamp in near])
        others = others[np.isfinite(scattering.lights.reach[others])]
        places = scattering.lights.centre[:, others], scattering.lights.reach[others]
        return lambda region, map_: narrow(region, map_) | beside_images(rays, *places, region)

    def points_of(lights: np.ndarray, choice: FogChoice | None = None, shifted: bool = False):
        return ScatteredLight(scattering, lights, choice, check, by_phase, shifted)

    def near_of(lights: np.ndarray, of: Callable[[np.ndarray], StagedIntegrand]) -> list[Lamp]:
        """Those of lights (L,) with rays of their own, through a lens. of : light of some of them."""
        near = _near_rays_of_lens(scattering, lights, region) if by_net and lens else lights[:0]
        return [
            Lamp(int(k), scattering.lights.centre[:, k], of(np.array([k])), _lit_through_lens(scattering, k))
            for k in near
        ]

    def by_points_of_rays(lights: np.ndarray) -> tuple[OverNet, ScatteredLight]:
        """Of lights without size, or small ones, through a lens; and what samples them plainly."""
        near = near_of(lights, partial(PointsOfRay, scattering, check=check))
        integrand = ThroughLens(PointsOfRay(scattering, lights, check), near, rays)
        plain = ScatteredLight(scattering, lights, None, check)
        points = _growing(LIGHT_POINTS, settings.samples)
        told, outlines = integrand.told_by(plain.unshadowed), and_blurred(lights, near)
        return OverNet(integrand, points, outlines, elsewhere, expected=told, more=True), plain

    def by_points(lights: np.ndarray) -> tuple[OverNet, ScatteredLight]:
        """And what samples them plainly."""
        choice, learn = None, None
        if not (by_net and _few_at_once(scattering, lights, region)):
            choice = scattering.choice_of_cells(lights, *cells(region), check)
        light, points = points_of(lights, choice, shifted=True), _growing(LIGHT_POINTS, settings.samples)
        integrand, expected, near = light, light.unshadowed, []
        if by_net and lens:
            near = near_of(lights, points_of) if choice is None else []
            integrand = ThroughLens(light, near, rays)
            expected = integrand.told_by(light.unshadowed)
        if choice is None and by_net and len(lights) <= FOLLOWED:
            each = [points_of(np.array([one])) for one in lights]
            # Where directions go by openings, no grid of them would find much more.
            dimensions = 1 if opened and np.isin(lights, scattering.lights.of_world).all() else DIMENSIONS

            def learn(map_: Map) -> None:
                pixels = (region[2] - region[0]) * (region[3] - region[1])
                work = int(LEARNING * pixels * points)
                pilots = [ThroughLens(one) for one in each] if lens else each
                at = partial(pixels_at, region), region, settings.seed
                light.guide = Guide.of(pilots, *at, work, map_, dimensions)
                for one in each:
                    light.counts.update(one.counts)

        return OverNet(
            integrand,
            points,
            and_blurred(lights, near) if by_net and lens else and_narrow(beams_of(lights)),
            elsewhere,
            learn=learn,
            expected=expected,
            chooses=choice is not None,
            fewest=FEW_LIGHT_POINTS if choice is None else FEW_OF_MANY_LIGHTS,
            more=choice is None,
            on_line=not lens and bool((scattering.sine[lights] > 0).all()),
        ), light

    def by_rays(
        lights: np.ndarray,
        of_spots: dict[int, Wedge],
        pixels: Callable[[Region, Map], np.ndarray],
        many: bool = False,
        otherwise: Callable[[], OverNet] | None = None,
        followed: bool = False,
    ) -> OverScreen:
        """pixels : that are no polynomial's. otherwise, followed : of `OverScreen`."""
        whole = ScatteredAlongRay(scattering, lights, check, tamed=calm, samples_too=many)
        # With a shadow on the way.
        node = whole.nodes + 2 * BISECTIONS
        node, ray, alone = RAYS_OF_MANY if many else (node, node + whole.checks, RAY_POINTS)
        return OverScreen(
            whole,
            AlongRay(node),
            ray,
            PointsOfRay(scattering, lights, check, tamed=calm if many else None),
            alone,
            pixels,
            None if many else elsewhere,
            tuple(of_spots.values()),
            outlines.bodies,
            otherwise,
            followed,
        )

    # Of many lights, blocks have the peaks alone.
    many = len(bare) > ALL
    every = rest if many else np.union1d(bare, rest)
    beams = beams_of(bare)
    if settings.integrator == "control_variates":
        found, own, others = [], [], []
        if len(rest) <= MOST_SIZED:
            sharp = every[_blur_in_pixels(scattering, every) < HALF_WIDTH] if lens else every
            found, elsewhere = blocks(scattering.rays, scattering.lights, sharp, region)
            own = [integrands(every[every == b.light])[0] for b in found]
            groups = [(b.beside, np.setdiff1d(every, np.append(b.beside, b.light))) for b in found]
            others = [
                [(one, len(lights)) for lights in group for one in integrands(lights)] for group in groups
            ]
        if many:
            high, calm = peaks(scattering.rays, scattering.lights, beams, bare, region)
            own += [NextToLight(scattering, b.light, calm, check, NEXT_POINTS) for b in high]
            found, others = found + high, others + [[] for _ in high]
        else:
            calm = tamed(scattering.rays, scattering.lights, beams, found, region)
        if found:
            lit = [lit_angles(scattering.rays, scattering.lights, scattering.cones, b.light) for b in found]
            # A lens sees cones from beside their tips, too.
            lit = [None] * len(found) if lens else lit
            own = [AroundLight(one, b.centre, at) for one, b, at in zip(own, found, lit, strict=True)]
            by = AroundLights(found, own, others)
            parts.append(Part("fog around lights", VOLUME, own[0], 1, by))
        else:
            elsewhere = None
    if by_net and lens:
        if (of_rays := np.union1d(bare, small)).size:
            by, plain = by_points_of_rays(of_rays)
            parts.append(Part("fog lit by points", VOLUME, plain, 1, by))
    elif bare.size:
        by = by_rays(bare, beams, and_beams(None if calm is None else calm.beams), many)
        plain = ScatteredLight(scattering, bare, None, check)
        parts.append(Part("fog lit by points", VOLUME, plain, 1, by))
    if small.size and not lens:
        plain, of_spots = ScatteredLight(scattering, small, None, check), beams_of(small)

        def net() -> OverNet:
            by, _ = by_points(small)
            by.integrand.counts = plain.counts
            return by

        followed = len(small) <= EVERY or _few_at_once(scattering, small, region)
        by = by_rays(small, of_spots, and_narrow(of_spots), otherwise=net, followed=followed)
        parts.append(Part("fog lit by small lights", VOLUME, plain, 1, by))
    others = np.setdiff1d(rest, small)
    apart = np.intersect1d(others, scattering.of_mesh) if by_net and len(others) > EVERY else others[:0]
    # A point that goes to a lamp in one pixel, and to one of many triangles in the next, is followed badly.
    here = np.setdiff1d(others, apart)
    kinds = [("lights", here), ("glowing meshes", apart)]
    if by_net and len(here) <= EVERY:
        # All are sampled at every point: apart, each kind has as many points as it needs.
        world, suns = np.intersect1d(here, scattering.lights.of_world), here[scattering.sine[here] > 0]
        lamps = np.setdiff1d(here, np.union1d(world, suns))
        kinds = [("lights", lamps), ("suns", suns), ("the world", world), *kinds[1:]]
    for name, some in kinds:
        if some.size:
            by, plain = by_points(some)
            parts.append(Part(f"fog lit by {name}", VOLUME, plain, 1, by))
    return parts


def _with_lens(part: Part) -> Part:
    """The same through a lens, of which nets alone know: of points that are of the lens as well. Few of them
    are seen as so many sharp pictures, whatever the noise.
    """
    by = part.by
    if isinstance(by, Targets) or isinstance(by, AroundLights) and part.shows == VOLUME:
        return part
    if not isinstance(by, OverNet):
        return replace(part, by=None)
    integrand, expected = by.integrand, by.expected
    if not isinstance(integrand, ThroughLens):
        integrand = ThroughLens(by.integrand)
        expected = None if expected is None else integrand.told_by(expected)
    return replace(part, by=replace(by, integrand=integrand, expected=expected, fewest=0))


def _blur_in_pixels(scattering: SingleScattering, lights: np.ndarray) -> np.ndarray:
    """(L,) radii of what a lens makes of middles of lights (L,), in pixels."""
    rays, centre = scattering.rays, scattering.lights.centre[:, lights]
    return np.nan_to_num(rays.blur(rays.image_of(centre)[1]) * rays.scale(centre), nan=np.inf)


def _lit_through_lens(scattering: SingleScattering, light: int) -> tuple[float, float] | None:
    """In which directions of a lens, from where it sees a spot, it sees its cone: their middle, and how far
    beside it, about. None for all.
    """
    rays = scattering.rays
    lit = lit_angles(rays, scattering.lights, scattering.cones, light, True)
    if lit is None:
        return None
    wide = min((lit[2] - lit[1]) / 2 + WIDER, np.pi)
    return lit[0] + (lit[1] + lit[2]) / 2 + np.pi * rays.turns(scattering.lights.centre[:, light]), wide


def _near_rays_of_lens(scattering: SingleScattering, lights: np.ndarray, region: Region) -> np.ndarray:
    """Of lights (L,), those in the picture that most of a lens' rays pass outside of, up to `FOLLOWED`."""
    rays, scene = scattering.rays, scattering.lights
    lights = lights[np.isfinite(scene.reach[lights]) & ~np.isin(lights, scattering.of_mesh)]
    image, depth = rays.image_of(scene.centre[:, lights])
    blur, far = rays.blur(depth), _blur_in_pixels(scattering, lights)
    seen = (depth > rays.clip_start) & (scene.reach[lights] < blur / 2) & np.isfinite(image).all(axis=0)
    # What is sharper is seen from few pixels.
    seen &= far >= HALF_WIDTH
    x0, y0, x1, y1 = region
    for at, low, high in zip(image, (x0, y0), (x1, y1), strict=True):
        seen &= (at > low - far) & (at < high + far)
    return lights[seen] if seen.sum() <= FOLLOWED else lights[:0]


def _asked(scattering: SingleScattering, region: Region) -> FogRays:
    """A few rays, all over the picture."""
    x0, y0, x1, y1 = region
    x, y = (
        a.ravel()
        for a in np.meshgrid(np.linspace(x0, x1 - 1, RAYS_ASKED), np.linspace(y0, y1 - 1, RAYS_ASKED))
    )
    pixels = pixels_at(region, x, y)
    return scattering.first(pixels, np.full((scattering.screen_dimensions, len(pixels), 1), 0.5, np.float32))


def _few_at_once(scattering: SingleScattering, lights: np.ndarray, region: Region) -> bool:
    """Whether rays are in the cones of so few of many lights (L,) that points are of all of them. Meshes take
    several times as long as others.
    """
    if not EVERY < len(lights) <= MOST_FOLLOWED or np.intersect1d(lights, scattering.of_mesh).size:
        return False
    lit = ScatteredLight(scattering, lights).lit_rays(_asked(scattering, region))
    return lit.shape[1] == 0 or bool(lit.sum(axis=0).mean() <= FOLLOWED)


def _noise_along(
    scattering: SingleScattering, lights: np.ndarray, rays: FogRays, check: Callable[[], None]
) -> float:
    """What whole rays, without another sample, say that theirs deviate by, of what lights (L,) bring them."""
    if lights.size == 0 or len(rays) == 0:
        return 0.0
    radiance, told = ScatteredAlongRay(scattering, lights, check).along(rays, None)
    return float(told[0].sum() / max(radiance.sum(dtype=np.float64), 1e-300))


def _of_distance(scattering: SingleScattering, lights: np.ndarray, rays: FogRays) -> np.ndarray:
    """(L,) radii of lights (L,) over the median distance of rays' segments of fog; inf for none. Of suns the
    sine of half their angle.
    """
    if len(rays) == 0:
        return np.full(len(lights), np.inf)
    media, scene = rays.media, scattering.lights
    vector = scene.centre[:, lights, None] - take(rays.origin, media.ray)[:, None]
    direction = take(rays.direction, media.ray)[:, None]
    vector -= np.clip(dot(vector, direction), media.start, media.end) * direction
    distance = np.maximum(np.median(np.sqrt(dot(vector, vector)), axis=1), 1e-300)
    return np.where(np.isinf(scene.reach[lights]), scattering.sine[lights], scene.reach[lights] / distance)


def _growing(of_one: int, samples: int) -> int:
    """Points of a net, ``of_one`` for one sample: so many that errors are least that fall as 1 / samples."""
    return 1 << int(np.log2(of_one) + np.log2(samples) * 2 / 3)


def _of_lasers(
    lasers: Lasers,
    scene: Scene,
    surfaces: DirectLight,
    scattering: SingleScattering | None,
    shadows: Shadows,
    outlines: Silhouettes,
    settings: Settings,
    check: Callable[[], None],
) -> list[Part]:
    parts = []
    reflection = Reflection(
        np.array([material.reflectance for material in scene.materials]).reshape(-1, 3).T,
        surfaces.surfaces.triangles.material,
        surfaces.surfaces.triangles.light_set,
    )
    stage = surfaces.stage
    # Rules for smooth functions would bisect what is cut up.
    shifted = settings.integrator != "quadrature"

    def beside(stretches: Sequence[Stretch]) -> Callable[[Region, Map], np.ndarray]:
        def found(region: Region, map_: Map) -> np.ndarray:
            return outlines(region, map_) | beside_beams(stage.rays, stretches, region, BESIDE)

        return found

    if scattering is not None and any(stretch.laser.in_fog for stretch in lasers.stretches):
        fog = LaserInFog(lasers, scattering, check=check, shifted=shifted)
        points = _points_of(fog.stretches, FOG_POINTS, settings.samples)
        by = OverNet(
            fog,
            points,
            beside(fog.stretches),
            expected=fog.unshadowed,
            fewest=max(points // HIDDEN_PART, FEW_HIDDEN),
        )
        parts.append(Part("lasers in fog", LASER, fog, 1, by))
    if scattering is not None and any(stretch.laser.on_surfaces for stretch in lasers.stretches):
        lit = LaserOnSurfaces(lasers, stage, reflection, shadows, surfaces.media, check, shifted)
        elsewhere = None
        if settings.integrator == "control_variates" and lit.screen_dimensions == 2:
            ends = lit.ends
            found, elsewhere = blocks(stage.rays, ends, ends.numbers, scene.camera.region)
            if found:
                own, others = [], []
                beam = np.unique([id(stretch.laser) for stretch in lit.stretches], return_inverse=True)[1]
                for block in found:
                    # Where a stretch ends, the next of its beam begins. What other beams bring is smooth.
                    near = np.isin(beam, beam[ends.stretch[np.append(block.beside, block.light)]])
                    here, far = np.flatnonzero(near), np.flatnonzero(~near)
                    own.append(AroundLight(lit.of_some(here), block.centre))
                    others.append([(lit.of_some(far), len(far))] if far.size else [])
                by = AroundLights(found, own, others)
                parts.append(Part("surfaces where lasers end", LASER, own[0], 1, by))
        near = beside(lit.stretches)

        def and_creases(region: Region, map_: Map) -> np.ndarray:
            if lit.screen_dimensions == 2:
                return near(region, map_) | lit.creases(region, map_)
            # Creases are anywhere through a lens, but beams' ends are bright.
            ends = lit.ends
            return near(region, map_) | beside_images(stage.rays, ends.centre, ends.reach, region)

        points = _points_of(lit.stretches, SURFACE_POINTS, settings.samples, FEW_POINTS // 2)
        # What is mirrored may be too small for pilots: as many points as said.
        by = OverNet(
            lit,
            points,
            and_creases,
            elsewhere=elsewhere,
            at_outlines=FOG_POINTS // SURFACE_POINTS,
            expected=lit.unshadowed,
        )
        parts.append(Part("lasers on surfaces", LASER, lit, 1, by))
    seen = LasersSeen(lasers, stage.rays, stage, reflection, shadows, scattering, check)
    if (seen.stretches or seen.spots) and seen.screen_dimensions > 2:
        parts.append(Part("lasers seen", LASER, seen, 1, Targets(seen.first, seen.targets)))
    elif seen.stretches or seen.spots:
        kinds = [{"spots": spots} for spots in (False, True)]
        touched, means = (tuple(partial(f, **kind) for kind in kinds) for f in (seen.touched, seen.means))
        more = (settings.samples - 1).bit_length()
        points = tuple(min(points << more, MOST_SEEN_POINTS) for points in SEEN_POINTS)
        parts.append(Part("lasers seen", LASER, seen, 1, Seen(touched, means, points)))
    return parts


def _points_of(stretches: Sequence[Stretch], of_one: int, samples: int, fewest: int = FEW_POINTS) -> int:
    """Points of a net of several lasers, whose errors even out; a power of two. of_one : of a single one, for
    one sample. fewest : of many.
    """
    many = _many(stretches)
    fewest = fewest if many > MANY_LASERS - 0.5 else FEW_POINTS
    return max(_growing(1 << round(np.log2(of_one / many**0.5)), samples), fewest)


def _many(stretches: Sequence[Stretch]) -> float:
    """How many lasers of one power would differ as much from one: 1 where one outshines all others."""
    power = {id(stretch.laser): float(stretch.laser.power.sum()) for stretch in stretches}
    shares = np.array(list(power.values())) / sum(power.values())
    return float(1 / np.square(shares).sum())


def cells(region: Region) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of the cells of a region, row by row, numbered from the whole frame's corner."""
    x0, y0, x1, y1 = region
    columns, rows = (np.arange(low // CELL, (high - 1) // CELL + 1) for low, high in ((x0, x1), (y0, y1)))
    x, y = np.meshgrid(columns, rows)
    return x.ravel(), y.ravel()


def cell_of(x: np.ndarray, y: np.ndarray, region: Region) -> np.ndarray:
    """Of pixels of the whole frame, the number of the cell of ``region`` in the order of `cells`."""
    x0, y0, x1, _ = region
    columns = (x1 - 1) // CELL - x0 // CELL + 1
    return ((y // CELL - y0 // CELL) * columns + (x // CELL - x0 // CELL)).astype(np.int32)


def pixels_at(region: Region, x: np.ndarray, y: np.ndarray) -> Pixels:
    """Pixels (B,) of the whole frame in columns and rows of integers."""
    x, y = x.astype(np.int32), y.astype(np.int32)
    return Pixels(x, y, cell_of(x, y, region))
