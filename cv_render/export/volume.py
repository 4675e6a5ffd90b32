# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes: what feeds the Volume socket of a material or world, as a medium that is the same everywhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from ...engine_core import Volume
from ...engine_core.shading.arithmetic import saturate
from ...engine_core.shading.colour import blackbody
from ...engine_core.shading.points import ShadingPoints
from ...engine_core.shading.textures import ImagePixels
from ...engine_core.shading.values import Value, attributes_of, compute, value_at
from .messages import Messages, named
from .nodes import Graph, Node, Socket, described, output_node, plain_value
from .phases import lobes

POINTS_EACH_WAY = 24
"""Of the lattice over a mesh's box that what varies is averaged on."""

STEFAN_BOLTZMANN = 5.670373e-8 * 1e-6
"""W/(m2 K4) times the factor that Cycles gives blackbody emission."""


@dataclass
class Terms:
    """What volume nodes add to a medium, numbers or expressions.

    scattering : (coefficient, anisotropy) of each phase function. absorption, emission : RGB each.
    """

    scattering: list[tuple[Any, Any]] = field(default_factory=list)
    absorption: list[Any] = field(default_factory=list)
    emission: list[Any] = field(default_factory=list)

    def add(self, other: Terms) -> None:
        self.scattering += other.scattering
        self.absorption += other.absorption
        self.emission += other.emission

    def values(self) -> list[Any]:
        return [*(value for pair in self.scattering for value in pair), *self.absorption, *self.emission]


@dataclass(frozen=True)
class Region:
    """Where something that varies is averaged: the box of a mesh.

    low, high : (3,) its corners in the object's space. matrix : (4, 4), to the world.
    """

    low: np.ndarray
    high: np.ndarray
    matrix: np.ndarray

    @classmethod
    def of(cls, vertices: np.ndarray, matrix: Any) -> Region:
        """Around a mesh of (V, 3) ``vertices``, some of which may not be finite."""
        corners = vertices[np.isfinite(vertices).all(axis=1)].astype(np.float64)
        low, high = (corners.min(axis=0), corners.max(axis=0)) if len(corners) else np.zeros((2, 3))
        return cls(low, high, np.array(matrix, np.float64))

    def points(self) -> ShadingPoints:
        """A lattice in the box; UV maps and other attributes of meshes are 0 inside, as in Cycles."""
        axis = (np.arange(POINTS_EACH_WAY, dtype=np.float32) + np.float32(0.5)) / POINTS_EACH_WAY
        generated = np.stack([a.ravel() for a in np.meshgrid(axis, axis, axis)])
        inside = self.low[:, None] + generated * (self.high - self.low)[:, None]
        world = (self.matrix[:3, :3] @ inside + self.matrix[:3, 3:]).astype(np.float32)
        count = generated.shape[1]
        known = {
            "generated": generated,
            "object": inside.astype(np.float32),
            "world": world,
            "object_to_world": np.repeat(
                self.matrix[:3, :3].T.reshape(9, 1).astype(np.float32), count, axis=1
            ),
        }
        up = np.zeros((3, count), np.float32)
        up[2] = 1

        def attributes(name: str, width: int) -> np.ndarray:
            return known.get(name, np.zeros((width, count), np.float32))

        return ShadingPoints(world, up, up, up, np.zeros(count, bool), attributes)


@dataclass(frozen=True)
class Fog:
    """The medium of a material or world.

    name : of the material. problems : what of it is not drawn as asked, told for each object that has it.
    """

    name: str
    terms: Terms
    problems: list[str]

    @property
    def varies(self) -> bool:
        return any(isinstance(value, Value) for value in self.terms.values())

    def volume(self, region: Region | None) -> tuple[Volume | None, list[str]]:
        """The medium, None if it is nothing, and what is to be said of it.

        region : None has what varies left out.
        """
        problems, terms = list(self.problems), self.terms
        average = Average(region if self.varies else None)
        rows: dict[float, np.ndarray] = {}
        for coefficient, anisotropy in terms.scattering:
            sigma, g = average.of(coefficient, 3), average.of(anisotropy, 1)
            if (sigma > 0).any():
                g = float(np.clip(g[0], -1, 1))
                rows[g] = rows.get(g, 0) + np.maximum(sigma, 0)
        absorption, emission = (
            sum((average.of(value, 3) for value in values), np.zeros(3))
            for values in (terms.absorption, terms.emission)
        )
        if average.varied:
            what = "it is left out where it does" if region is None else "its mean is drawn"
            problems.append(f"varies from place to place, which is not supported yet: {what}")
        for name in sorted(attributes_of(tuple(terms.values()))):
            kind, colon, layer = name.partition(":")
            if colon:
                problems.append(f'{_KINDS.get(kind, kind)} "{layer}" is 0 inside of meshes, as in Cycles')
        if (absorption < 0).any() or (emission < 0).any():
            problems.append("absorbs or emits less than nothing, which is nothing")
        if not (rows or (absorption > 0).any() or (emission > 0).any()):
            return None, problems
        volume = Volume(
            scattering=np.array(list(rows.values())) if rows else 0.0,
            absorption=np.maximum(absorption, 0),
            anisotropy=list(rows) or 0.0,
            emission=np.maximum(emission, 0),
            name=self.name,
        )
        return volume, problems


_KINDS = {"uv": "UV map", "color": "colour attribute", "attribute": "attribute"}


class Average:
    """Means over a region; nothing for what varies if there is none.

    varied : whether anything has differed from place to place so far.
    """

    def __init__(self, region: Region | None) -> None:
        self._points = region.points() if region else None
        self.varied = False

    def of(self, value: Any, channels: int) -> np.ndarray:
        """(channels,) float64."""
        if isinstance(value, Value) and self._points is None:
            self.varied = True
            return np.zeros(channels)
        array = np.asarray(value_at(value, self._points), np.float64)
        array = np.nan_to_num(array.reshape(1, -1) if array.ndim < 2 else array, posinf=0, neginf=0)
        self.varied |= bool((array != array[:, :1]).any())
        return np.broadcast_to(array.mean(axis=1), channels)


def read_fog(datablock: Any, messages: Messages, images: dict[int, ImagePixels] | None = None) -> Fog | None:
    """The medium of a material or world; None if nothing is linked to its output's Volume."""
    output = output_node(datablock)
    if output is None:
        return None
    socket = Socket(output.inputs["Volume"])
    if not socket.source().socket.is_output:
        return None
    problems: list[str] = []
    terms = _terms(partial(VolumeGraph, named(datablock), messages, images, problems), socket, 1.0)
    return Fog(datablock.name, terms, list(dict.fromkeys(problems)))


class VolumeGraph(Graph):
    """The inputs of one volume node, for which ``unknown`` names what nobody can compute.

    problems : where they are told, for whoever uses the volume to pass on.
    """

    def __init__(
        self,
        owner: str,
        messages: Messages,
        images: dict[int, ImagePixels] | None,
        problems: list[str],
    ) -> None:
        super().__init__(owner, messages, images)
        self._problems = problems
        self.unknown: list[str] = []

    def tell(self, problem: str) -> None:
        self._problems.append(problem)

    def unsupported(self, socket: Socket, source: Socket) -> Value | np.ndarray:
        self.unknown.append(described(source))
        return plain_value(socket.socket)


def _terms(new_graph: Callable[[], VolumeGraph], socket: Socket, weight: Any) -> Terms:
    """What a shader input is fed with, times ``weight``."""
    source = socket.source()
    if not source.socket.is_output:
        return Terms()
    kind = source.node.type
    graph = new_graph()
    node = Node(graph, source)
    if source.socket.type != "SHADER":
        # Cycles takes a colour for emission.
        found = Terms(emission=[graph.value(socket)])
    elif kind in ("ADD_SHADER", "MIX_SHADER"):
        return _sum(new_graph, node, weight)
    elif kind in VOLUMES:
        found = VOLUMES[kind](node)
    else:
        graph.tell(f"{described(source)} is no volume and is left out")
        return Terms()
    if graph.unknown:
        what = " and ".join(dict.fromkeys(graph.unknown))
        if what == described(source):
            graph.tell(f"{what} is not supported yet and is left out")
        else:
            graph.tell(f"{what}, not supported yet, feeds {described(source)}, which is left out")
        return Terms()
    return Terms(
        [(compute(np.multiply, weight, sigma), g) for sigma, g in found.scattering],
        [compute(np.multiply, weight, sigma) for sigma in found.absorption],
        [compute(np.multiply, weight, emission) for emission in found.emission],
    )


def _sum(new_graph: Callable[[], VolumeGraph], node: Node, weight: Any) -> Terms:
    *factors, first, second = node.socket.inputs()
    weights = [weight, weight]
    if factors:
        factor = compute(saturate, node.graph.value(factors[0]))
        if node.graph.unknown:
            what = " and ".join(dict.fromkeys(node.graph.unknown))
            node.graph.tell(f"{what}, not supported yet, feeds {described(node.socket)}: halves are mixed")
            factor = 0.5
        weights = [compute(lambda w, f: w * (1 - f), weight, factor), compute(np.multiply, weight, factor)]
    terms = Terms()
    for part, socket in zip(weights, (first, second), strict=True):
        if isinstance(part, Value) or np.any(part):
            terms.add(_terms(new_graph, socket, part))
    return terms


def _positive(value: Any) -> Any:
    return compute(lambda a: np.maximum(a, 0), value)


def _scattering(node: Node, sigma: Any) -> list[tuple[Any, Any]]:
    return [(compute(np.multiply, sigma, share), g) for share, g in lobes(node)]


def _scatter(node: Node) -> Terms:
    """Without absorption: its colour is what it scatters of each."""
    return Terms(_scattering(node, compute(np.multiply, node["Color"], _positive(node["Density"]))))


def _absorption(node: Node) -> Terms:
    density = _positive(node["Density"])
    return Terms(absorption=[compute(lambda colour, density: (1 - colour) * density, node["Color"], density)])


def _principled(node: Node) -> Terms:
    # Attributes that scale density, colour and temperature are OpenVDB grids: no mesh has one.
    density, colour = _positive(node["Density"]), node["Color"]
    terms = Terms(
        [(compute(np.multiply, colour, density), next(lobes(node))[1])],
        [compute(_absorbed, colour, node["Absorption Color"], density)],
        [compute(_emitted, node["Emission Color"], node["Emission Strength"])],
    )
    intensity = node["Blackbody Intensity"]
    if isinstance(intensity, Value) or intensity > 0:
        terms.emission.append(compute(_glow, intensity, node["Blackbody Tint"], node["Temperature"]))
    return terms


def _absorbed(colour: np.ndarray, absorption: np.ndarray, density: np.ndarray) -> np.ndarray:
    """What is not scattered, but for what the root of the absorption colour lets pass."""
    passing = np.maximum(1 - np.sqrt(np.maximum(absorption, 0)), 0)
    return np.maximum(1 - colour, 0) * passing * density


def _emitted(colour: np.ndarray, strength: np.ndarray) -> np.ndarray:
    return colour * np.maximum(strength, 0)


def _glow(intensity: np.ndarray, tint: np.ndarray, kelvin: np.ndarray) -> np.ndarray:
    """Emission of a black body by Stefan and Boltzmann's law, of which ``intensity`` 0 leaves the T^4."""
    kelvin, share = np.maximum(np.float64(kelvin), 0), np.maximum(intensity, 0)
    radiance = STEFAN_BOLTZMANN / np.pi * (1 + share * (kelvin**4 - 1))
    return tint * blackbody(kelvin) * np.where(share > 0, radiance, 0)


def _coefficients(node: Node) -> Terms:
    """Coefficients as they are, from 4.5 on."""
    return Terms(
        _scattering(node, node["Scatter Coefficients"]),
        [node["Absorption Coefficients"]],
        [node["Emission Coefficients"]],
    )


def _emission(node: Node) -> Terms:
    return Terms(emission=[compute(np.multiply, node["Color"], node["Strength"])])


VOLUMES: dict[str, Callable[[Node], Terms]] = {
    "VOLUME_SCATTER": _scatter,
    "VOLUME_ABSORPTION": _absorption,
    "PRINCIPLED_VOLUME": _principled,
    "VOLUME_COEFFICIENTS": _coefficients,
    "EMISSION": _emission,
    "BACKGROUND": _emission,
}
"""By Blender's node type; what it adds to the medium."""
