# SPDX-License-Identifier: GPL-3.0-or-later
"""VIOLIN: a violin and its bow, leaning on a wall in the light of two area lamps.

It is modelled lying on its back, in decimetres: x across, y from the button to the scroll, z out of the
belly, whose edge is at z = 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .model import Lamp, Model, Surface, Thing, View, diffuse
from .shapes import Shape, ball, box, grid_faces, joined, revolved

OUTLINE = (
    ((0.00, 0.00), (0.62, 0.00), (1.04, 0.30), (1.04, 0.78)),
    ((1.04, 0.78), (1.04, 1.10), (0.88, 1.22), (0.95, 1.44)),
    ((0.95, 1.44), (0.72, 1.46), (0.56, 1.66), (0.56, 1.90)),
    ((0.56, 1.90), (0.56, 2.16), (0.66, 2.32), (0.82, 2.36)),
    ((0.82, 2.36), (0.76, 2.54), (0.84, 2.64), (0.84, 2.86)),
    ((0.84, 2.86), (0.84, 3.28), (0.52, 3.52), (0.00, 3.56)),
)
"""Right half of the body from button to neck, cubic Bezier curves: bout, corner, waist, corner, bout."""
F_HOLE = (
    ((0.25, 2.13), (0.22, 2.24), (0.33, 2.28), (0.37, 2.17)),
    ((0.37, 2.17), (0.40, 2.05), (0.42, 1.87), (0.46, 1.75)),
    ((0.46, 1.75), (0.52, 1.61), (0.66, 1.62), (0.62, 1.75)),
)
RIBS, ARCH, SPINE = 0.32, 0.17, (0.8, 2.9)
"""Height of the ribs and of the arches, and the y between which the arches have their ridge."""


def bezier(curves: Sequence[Sequence[tuple[float, float]]], points: int) -> np.ndarray:
    """(curves * points + 1, 2) along cubic curves, one after the other."""
    t = np.linspace(0, 1, points, endpoint=False)[:, None]
    parts = []
    for a, b, c, d in np.array(curves, float):
        parts.append((1 - t) ** 3 * a + 3 * t * (1 - t) ** 2 * b + 3 * t**2 * (1 - t) * c + t**3 * d)
    return np.concatenate([*parts, [curves[-1][-1]]])


def body_outline(points: int = 24) -> np.ndarray:
    """(M, 2) counterclockwise, seen from above the belly."""
    right = bezier(OUTLINE, points)
    left = right[-2:0:-1] * (-1, 1)
    return np.concatenate([right, left])


def plate(edge: np.ndarray, height: float, rings: int = 26) -> Shape:
    """An arched plate over the outline ``edge`` (M, 2), its rings rounder the further inside they are."""
    frequency = np.fft.fftfreq(len(edge), 1 / len(edge))
    spectrum = np.fft.fft(edge, axis=0)
    vertices = []
    for r in np.linspace(1, 0, rings):
        # The corners fade away from the edge to the ridge.
        ring = np.fft.ifft(spectrum * np.exp(-((frequency * (1 - r) / 9) ** 2))[:, None], axis=0).real
        ridge = np.stack([0 * ring[:, 0], np.clip(ring[:, 1], *SPINE)], -1)
        flat = ridge + r * (ring - ridge)
        # A channel inside the edge, then the arch.
        rise = 0.5 + 0.5 * np.cos(np.pi * np.minimum(1, r / 0.9))
        rise += 0.10 * np.clip((r - 0.9) / 0.1, 0, 1) ** 2
        vertices.append(np.column_stack([flat, np.full(len(edge), height * rise)]))
    return np.concatenate(vertices), grid_faces(rings, len(edge), around=True)[:, :: -1 if height < 0 else 1]


def band(edge: np.ndarray, top: float, bottom: float) -> Shape:
    """A wall along the outline."""
    rows = [np.column_stack([edge, np.full(len(edge), z)]) for z in (bottom, top)]
    return np.concatenate(rows), grid_faces(2, len(edge), around=True)


def tube(centres: np.ndarray, radius: Sequence[float] | float, width: float = 1.0, sides: int = 10) -> Shape:
    """A round rod along ``centres`` (N, 3), across x ``width`` times as thick, with closed ends."""
    along = np.gradient(centres, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, np.where(np.abs(along[:, :1]) > 0.9, (0, 1, 0), (1, 0, 0)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(along, across)
    turn = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    radius = np.broadcast_to(radius, len(centres))[:, None, None]
    ring = np.cos(turn)[:, None] * across[:, None] + width * np.sin(turn)[:, None] * other[:, None]
    vertices = centres[:, None] + radius * ring
    ends = np.repeat(centres[[0, -1]], sides, axis=0).reshape(2, sides, 3)
    vertices = np.concatenate([ends[:1], vertices, ends[1:]])
    return vertices.reshape(-1, 3), grid_faces(len(vertices), sides, around=True)


def board(y: Sequence[float], half: Sequence[float], top: Sequence[float], under: Sequence[float]) -> Shape:
    """A tapering board along y with a rounded top and a flat underside, given at some places."""
    places = np.linspace(0, 1, 25)
    y, half, top, under = (np.interp(places, np.linspace(0, 1, len(v)), v) for v in (y, half, top, under))
    side = np.linspace(-1, 1, 11)
    arc = np.stack([side, 1 - 0.55 * side**2], -1)
    profile = np.concatenate([arc, [(1, 0), (-1, 0)]])
    x = half[:, None] * profile[:, 0]
    z = under[:, None] + (top - under)[:, None] * profile[:, 1]
    vertices = np.stack([x, np.broadcast_to(y[:, None], x.shape), z], -1)
    middle = vertices.mean(axis=1, keepdims=True) + np.zeros_like(vertices)
    vertices = np.concatenate([middle[:1], vertices, middle[-1:]])
    return vertices.reshape(-1, 3), grid_faces(len(vertices), len(profile), around=True)


def f_holes(belly: np.ndarray) -> Shape:
    """Both holes, as inlays just above the belly (V, 3)."""
    line = bezier(F_HOLE, 16)
    along = np.gradient(line, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], -1) / np.linalg.norm(along, axis=1, keepdims=True)
    place = np.linspace(-1, 1, len(line))[:, None]
    width = 0.012 + 0.024 * np.exp(-((place / 0.5) ** 2))
    strip = np.concatenate([line + width * normal, line - width * normal])
    faces = [grid_faces(2, len(line))]
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(turn), np.sin(turn)], -1)
    flat = [strip]
    for centre, radius in (((0.262, 2.115), 0.042), ((0.605, 1.765), 0.056)):
        start = sum(len(part) for part in flat)
        flat += [centre + 1e-6 * circle, centre + radius * circle]
        faces.append(start + grid_faces(2, len(turn), around=True))
    points = np.concatenate(flat)
    distance = ((points[:, None] - belly[None, :, :2]) ** 2).sum(axis=-1)
    weight = np.exp(-distance / 0.03**2)
    z = (weight * belly[:, 2]).sum(axis=1) / weight.sum(axis=1) + 0.012
    left = np.column_stack([points, z]) * (-1, 1, 1), np.concatenate(faces)
    return joined(left, (left[0] * (-1, 1, 1), left[1][:, ::-1]))


def scroll() -> Shape:
    """Pegbox and scroll: one rod that ends in a spiral."""
    turn = np.linspace(0, 5.2 * np.pi / 2, 90)
    radius = 0.23 * np.exp(-0.16 * turn)
    spiral = np.stack([0 * turn, 5.60 + radius * np.sin(turn), -0.33 + radius * np.cos(turn)], -1)
    box_ = np.linspace((0, 4.80, 0.12), spiral[0], 30, endpoint=False)
    thickness = np.concatenate([np.linspace(0.13, 0.085, 30), 0.085 * np.exp(-0.11 * turn)])
    centres = np.concatenate([box_, spiral])
    width = np.concatenate([np.full(30, 0.95), 1.0 + 0.16 * turn])
    vertices, faces = tube(centres, thickness, sides=14)
    # The eye of the scroll stands out sideways.
    vertices = vertices.reshape(-1, 14, 3)
    vertices[:, :, 0] *= np.concatenate([width[:1], width, width[-1:]])[:, None]
    return vertices.reshape(-1, 3), faces


def turned(shape: Shape, x: float, y: float, z: float) -> Shape:
    """A shape about the z axis, laid along x and moved."""
    vertices, faces = shape
    return vertices[:, [2, 0, 1]] + (x, y, z), faces


def leaning(things: dict[str, Shape], tilt: float, roll: float, x: float) -> dict[str, Shape]:
    """Things that belong together, set on the floor z = 0 and leant on the wall y = 0 at ``x``."""
    c, s, cr, sr = np.cos(tilt), np.sin(tilt), np.cos(roll), np.sin(roll)
    rolled = np.array([[cr, sr, 0], [-sr, cr, 0], [0, 0, 1]])
    upright = np.array([[1, 0, 0], [0, s, -c], [0, c, s]])
    placed = {name: (vertices @ (upright @ rolled).T, faces) for name, (vertices, faces) in things.items()}
    every = np.concatenate([vertices for vertices, _ in placed.values()])
    shift = np.array([x, -every[:, 1].max(), -every[:, 2].min()])
    return {name: (vertices + shift, faces) for name, (vertices, faces) in placed.items()}


def violin() -> dict[str, Shape]:
    edge = body_outline()
    belly, back = plate(edge, ARCH), plate(edge, -0.8 * ARCH)
    back = back[0] - (0, 0, RIBS + 0.04), back[1]
    inner = (edge - (0, 1.78)) * (0.965, 0.985) + (0, 1.78)
    rim = 0.1 * ARCH
    strings = []
    for i, x in enumerate((-1.5, -0.5, 0.5, 1.5)):
        height = 0.02 * (1 - abs(x) / 1.5)
        path = [
            (0.06 * x, 1.42, 0.40 + height),
            (0.115 * x, 1.95, 0.50 + height),
            (0.055 * x, 4.84, 0.235 + height / 2),
            (0.03 * x, 4.98 + 0.13 * i, 0.15 - 0.075 * i),
        ]
        pieces = [np.linspace(a, b, 12, endpoint=False) for a, b in zip(path[:-1], path[1:], strict=True)]
        strings.append(tube(np.concatenate([*pieces, [path[-1]]]), 0.009 - 0.0012 * i, sides=6))
    knob = [(0, -0.36), (0.07, -0.35), (0.10, -0.24), (0.05, -0.14), (0.03, -0.10), (0.03, 0.16), (0, 0.17)]
    pegs = []
    for i in range(4):
        vertices, faces = revolved(knob, 16)
        sign = 1 if i % 2 else -1
        vertices = vertices * (0.45, 1, -sign)
        peg = turned((vertices, faces if sign < 0 else faces[:, ::-1]), 0, 4.98 + 0.13 * i, 0.07 - 0.085 * i)
        pegs.append(peg)
    rest, faces = ball(1.0, cells=10)
    chin_rest = rest * (0.40, 0.30, 0.06) + (-0.42, 0.42, 0.20), faces
    bridge, faces = box((0.46, 0.05, 0.36))
    waist = 1 - 0.28 * np.sin(np.pi * bridge[:, 2:] / 0.36)
    bridge = bridge * np.hstack([waist, np.ones((8, 2))]) + (0, 1.95, 0.14)
    return {
        "Belly": joined(belly, band(edge, rim, -0.04)),
        "Back": joined(back, band(edge, -RIBS, -RIBS - 0.04 - 0.08 * ARCH)),
        "Ribs": band(inner, -0.02, -RIBS - 0.02),
        "F-holes": f_holes(belly[0]),
        "Neck": board((3.45, 3.6, 4.9), (0.16, 0.14, 0.11), (0.14, 0.16, 0.17), (-0.34, -0.10, 0.02)),
        "Fingerboard": board((2.42, 4.86), (0.21, 0.12), (0.36, 0.225), (0.28, 0.15)),
        "Tailpiece": board((0.10, 1.46), (0.10, 0.24), (0.24, 0.40), (0.16, 0.33)),
        "Chin rest": chin_rest,
        "Bridge": (bridge, faces),
        "Scroll": scroll(),
        "Pegs": joined(*pegs),
        "Strings": joined(*strings),
    }


def bow() -> dict[str, Shape]:
    """Lies along y, its frog at the bottom, the stick bent towards the hair."""
    y = np.linspace(0, 7.3, 60)
    bend = 0.20 * (1 - (2 * y / 7.3 - 1) ** 2)
    stick = tube(np.stack([0 * y, y, 0.22 - bend], -1), np.linspace(0.043, 0.028, 60))
    tip = tube(np.array([(0, 7.22, 0.23), (0, 7.32, 0.12), (0, 7.30, 0.0)]), (0.035, 0.04, 0.03))
    hair, faces = box((0.09, 6.7, 0.008))
    frog, frog_faces = box((0.09, 0.5, 0.20))
    return {
        "Stick": joined(stick, tip),
        "Hair": (hair + (0, 3.95, 0.0), faces),
        "Frog": (frog + (0, 0.45, 0.0), frog_faces),
    }


def model() -> Model:
    def lacquer(name: str, colour: Sequence[float], roughness: float) -> Surface:
        return Surface(name, "Principled", {"base_color": colour, "roughness": roughness})

    spruce, maple = lacquer("Spruce", (0.50, 0.17, 0.035), 0.28), lacquer("Maple", (0.34, 0.10, 0.025), 0.28)
    ebony, steel = lacquer("Ebony", (0.018, 0.015, 0.014), 0.35), lacquer("Gut", (0.75, 0.72, 0.66), 0.4)
    black, pale = diffuse("Dark", (0.004, 0.003, 0.003)), diffuse("Horsehair", (0.82, 0.80, 0.74))
    surfaces = {
        "Belly": spruce, "Back": maple, "Ribs": maple, "F-holes": black, "Neck": maple, "Scroll": maple,
        "Fingerboard": ebony, "Tailpiece": ebony, "Chin rest": ebony, "Pegs": ebony, "Frog": ebony,
        "Bridge": diffuse("Bridge", (0.62, 0.44, 0.24)), "Strings": steel,
        "Stick": lacquer("Pernambuco", (0.25, 0.07, 0.02), 0.3), "Hair": pale,
    }  # fmt: skip
    flat = ("Bridge", "Hair", "Frog", "F-holes")
    shapes = leaning(violin(), 0.20, -0.10, -0.35) | leaning(bow(), 0.16, 0.17, 1.75)
    quad = np.array([(0, 1, 2, 3)])
    floor = np.array([(-12, -14, 0), (12, -14, 0), (12, 0, 0), (-12, 0, 0)], float)
    wall = np.array([(-12, 0, 0), (12, 0, 0), (12, 0, 12), (-12, 0, 12)], float)
    things = [
        Thing("Floor", (floor, quad), diffuse("Floor", (0.46, 0.34, 0.24))),
        Thing("Wall", (wall, quad), diffuse("Wall", (0.62, 0.63, 0.60))),
        *(Thing(name, shape, surfaces[name], name not in flat) for name, shape in shapes.items()),
    ]
    lamps = [
        Lamp("Window", "AREA", (-6.0, -6.0, 7.0), 800, (1.0, 0.93, 0.82), (0, -0.8, 2.4),
             properties={"shape": "RECTANGLE", "size": 2.6, "size_y": 3.6}),
        Lamp("Sky", "AREA", (6.2, -5.0, 4.2), 340, (0.62, 0.78, 1.0), (0, -0.5, 2.2),
             properties={"shape": "SQUARE", "size": 2.2}),
    ]  # fmt: skip
    return Model(View((1.2, -13.5, 4.0), (0.45, -0.4, 2.85), lens=41), things, lamps, size=(1280, 720))
