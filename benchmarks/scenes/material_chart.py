# SPDX-License-Identifier: GPL-3.0-or-later
"""A chart of materials: a smooth ball or a steep sheet of each over a floor, under an area light, a sun and
a weak world. A material is data and one function of its nodes; bpy comes with `build`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

COLUMNS, ROWS = 8, 6
RADIUS = 0.4
"""Of a ball, in a tile of edge 1."""


class Nodes:
    """Makes nodes of a tree in one line."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def __call__(self, kind: str, inputs: dict[Any, Any] | None = None, **options: Any) -> Any:
        """A node of ``kind``; inputs by number, identifier or name, each a value or another's output."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for name, value in options.items():
            setattr(node, name, value)
        for key, value in (inputs or {}).items():
            known = {socket.name: socket for socket in reversed(node.inputs)}
            known |= {socket.identifier: socket for socket in node.inputs}
            socket = node.inputs[key] if isinstance(key, int) else known[key]
            if hasattr(value, "is_output"):
                self.tree.links.new(value, socket)
            else:
                socket.default_value = value
        return node

    def coordinate(self, name: str) -> Any:
        return self("TexCoord").outputs[name]

    def diffuse(self, colour: Any, **inputs: Any) -> Any:
        return self("BsdfDiffuse", {"Color": colour, **inputs})


@dataclass(frozen=True)
class Sample:
    """One material of the chart.

    shader : of `Nodes`, the node whose first output is the surface.
    texture : what is shown is a texture, on a surface that is but diffuse. sheet : not on a ball.
    """

    name: str
    shader: Callable[[Nodes], Any]
    texture: bool = False
    sheet: bool = False


SAND, SEA, ROSE, WHITE = (0.8, 0.6, 0.35, 1), (0.1, 0.35, 0.7, 1), (0.8, 0.25, 0.3, 1), (1.0, 1.0, 1.0, 1)


def _shader(kind: str, options: dict[str, Any] | None = None, **inputs: Any) -> Callable[[Nodes], Any]:
    """A shader of one node; inputs' names with _ for a blank."""
    named = {name.replace("_", " "): value for name, value in inputs.items()}
    return lambda n: n(kind, named, **(options or {}))


def _principled(**inputs: Any) -> Callable[[Nodes], Any]:
    return _shader("BsdfPrincipled", **inputs)


def _glossy(distribution: str, **inputs: Any) -> Callable[[Nodes], Any]:
    return _shader("BsdfAnisotropic", {"distribution": distribution}, **{"Color": SAND, **inputs})


def _mixed(n: Nodes, factor: Any, first: Any, second: Any) -> Any:
    return n("MixShader", {0: factor, 1: first.outputs[0], 2: second.outputs[0]})


def _coloured(make: Callable[[Nodes], Any]) -> Callable[[Nodes], Any]:
    """A diffuse surface in the colour that ``make`` gives."""
    return lambda n: n.diffuse(make(n))


def image(n: Nodes, alpha: bool = False, space: str = "sRGB", **inputs: Any) -> Any:
    """An image node of 6 x 5 random pixels."""
    import bpy

    image = bpy.data.images.new("Patches", 6, 5, alpha=alpha)
    image.colorspace_settings.name = space
    pixels = np.random.default_rng(4).uniform(0.05, 1, (30, 4)).astype(np.float32)
    if not alpha:
        pixels[:, 3] = 1
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    return n("TexImage", inputs, image=image)


def _ramp(n: Nodes) -> Any:
    node = n(
        "ValToRGB", {0: n("TexGradient", {0: n.coordinate("Object")}, gradient_type="EASING").outputs[1]}
    )
    node.color_ramp.elements[0].color, node.color_ramp.elements[1].color = ROSE, SEA
    node.color_ramp.elements.new(0.4).color = SAND
    return node.outputs[0]


def _mapped(n: Nodes) -> Any:
    turned = {"Vector": n.coordinate("UV"), "Rotation": (0.3, 0.4, 0.5), "Scale": (3.0, 2.0, 1.0)}
    return image(n, Vector=n("Mapping", turned).outputs[0]).outputs[0]


def tilted(n: Nodes, strength: float = 0.6) -> Any:
    """A normal map of smooth bumps."""
    import bpy

    x, y = np.meshgrid(np.arange(32), np.arange(32))
    slopes = 0.5 + 0.35 * np.stack([np.sin(x * np.pi / 8), np.sin(y * np.pi / 8)], -1)
    pixels = np.concatenate([slopes, np.full((32, 32, 1), 0.9), np.ones((32, 32, 1))], -1)
    image = bpy.data.images.new("Bumps", 32, 32, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels.foreach_set(pixels.astype(np.float32).ravel())
    image.update()
    texture = n("TexImage", {}, image=image)
    return n("NormalMap", {"Color": texture.outputs[0], "Strength": strength}).outputs[0]


def _grey(n: Nodes) -> Any:
    return n("TexChecker", {"Vector": n.coordinate("UV"), "Scale": 8.0}).outputs[1]


def _metal(base: Any, roughness: float, **inputs: Any) -> Callable[[Nodes], Any]:
    return _principled(Base_Color=base, Metallic=1.0, Roughness=roughness, **inputs)


CHART = (
    Sample("diffuse", _shader("BsdfDiffuse", Color=SAND)),
    Sample("diffuse, roughness 0.4", _shader("BsdfDiffuse", Color=SAND, Roughness=0.4)),
    Sample("diffuse, roughness 1", _shader("BsdfDiffuse", Color=SEA, Roughness=1.0)),
    Sample("translucent", _shader("BsdfTranslucent", Color=SAND), sheet=True),
    Sample("multiscatter GGX 0.3", _glossy("MULTI_GGX", Roughness=0.3)),
    Sample("multiscatter GGX 0.5", _glossy("MULTI_GGX", Roughness=0.5)),
    Sample("multiscatter GGX 1", _glossy("MULTI_GGX", Roughness=1.0)),
    Sample("GGX 0.3", _glossy("GGX", Roughness=0.3)),
    Sample("GGX 0.8", _glossy("GGX", Roughness=0.8)),
    Sample("Beckmann 0.3", _glossy("BECKMANN", Roughness=0.3)),
    Sample("Beckmann 0.7", _glossy("BECKMANN", Roughness=0.7)),
    Sample("Ashikhmin-Shirley 0.3", _glossy("ASHIKHMIN_SHIRLEY", Roughness=0.3)),
    Sample("Ashikhmin-Shirley 0.7", _glossy("ASHIKHMIN_SHIRLEY", Roughness=0.7)),
    Sample("anisotropy 0.7", _glossy("MULTI_GGX", Roughness=0.4, Anisotropy=0.7)),
    Sample("anisotropy 0.5, turned", _glossy("GGX", Roughness=0.5, Anisotropy=0.5, Rotation=0.2)),
    Sample("anisotropy -0.5, Beckmann", _glossy("BECKMANN", Roughness=0.5, Anisotropy=-0.5)),
    Sample("principled", _principled()),
    Sample("plastic", _principled(Base_Color=ROSE, Roughness=0.3, IOR=1.6)),
    Sample("clay", _principled(Base_Color=SAND, Roughness=1.0, Diffuse_Roughness=1.0)),
    Sample("no specular", _principled(Base_Color=SAND, Specular_IOR_Level=0.0)),
    Sample("specular level 1, tint", _principled(Specular_IOR_Level=1.0, Specular_Tint=ROSE, Roughness=0.3)),
    Sample("index 2.5", _principled(Base_Color=SEA, IOR=2.5, Roughness=0.4)),
    Sample("index 0.8", _principled(Base_Color=SEA, IOR=0.8, Roughness=0.4)),
    Sample("metal 0.3", _metal((0.95, 0.7, 0.3, 1), 0.3)),
    Sample("metal 0.6, edge tint", _metal(SAND, 0.6, Specular_Tint=SEA)),
    Sample("brushed metal", _metal(SAND, 0.4, Anisotropic=0.8, Anisotropic_Rotation=0.1)),
    Sample("half metal", _principled(Base_Color=ROSE, Metallic=0.5, Roughness=0.5)),
    Sample("coat", _principled(Base_Color=ROSE, Roughness=0.6, Coat_Weight=1.0, Coat_Roughness=0.2)),
    Sample(
        "tinted coat on metal",
        _metal(WHITE, 0.5, Coat_Weight=0.7, Coat_Roughness=0.3, Coat_IOR=1.8, Coat_Tint=SEA),
    ),
    Sample("alpha 0.4", _principled(Base_Color=SEA, Alpha=0.4)),
    Sample(
        "glowing under a coat",
        _principled(Emission_Color=ROSE, Emission_Strength=0.3, Coat_Weight=0.8, Coat_Tint=SAND),
    ),
    Sample("transparent", _shader("BsdfTransparent", Color=(0.9, 0.5, 0.2, 1)), sheet=True),
    Sample(
        "half holdout", lambda n: _mixed(n, 0.5, n.diffuse(SAND), n("Holdout"))
    ),
    Sample(
        "varnish by Fresnel",
        lambda n: _mixed(
            n,
            n("Fresnel", {0: 1.6}).outputs[0],
            n.diffuse(ROSE),
            n("BsdfAnisotropic", {"Color": WHITE, "Roughness": 0.3}),
        ),
    ),
    Sample(
        "diffuse + glow",
        lambda n: n(
            "AddShader", {0: n.diffuse(SEA).outputs[0], 1: n("Emission", {0: ROSE, 1: 0.1}).outputs[0]}
        ),
    ),
    Sample("bumpy diffuse", lambda n: n.diffuse(SAND, Normal=tilted(n))),
    Sample("bumpy gloss", lambda n: n("BsdfAnisotropic", {"Roughness": 0.4, "Normal": tilted(n)})),
    Sample("checked roughness", lambda n: n("BsdfPrincipled", {"Base Color": SAND, "Roughness": _grey(n)})),
    Sample(
        "leaf", lambda n: _mixed(n, 0.5, n.diffuse(SAND), n("BsdfTranslucent", {"Normal": tilted(n)})),
        sheet=True,
    ),
    Sample("image", _coloured(lambda n: image(n).outputs[0]), texture=True),
    Sample("mapped image", _coloured(_mapped), texture=True),
    Sample(
        "checker",
        _coloured(lambda n: n("TexChecker", {"Color1": ROSE, "Color2": SEA}).outputs[0]),
        texture=True,
    ),
    Sample("ramp", _coloured(_ramp), texture=True),
    Sample(
        "colour attribute",
        _coloured(lambda n: n("VertexColor", layer_name="Paint").outputs[0]),
        texture=True,
    ),
    Sample(
        "colour by layer weight",
        _coloured(lambda n: n("LayerWeight", {0: 0.4}).outputs["Facing"]),
        texture=True,
    ),
    Sample("colour by Fresnel", _coloured(lambda n: n("Fresnel", {0: 1.3}).outputs[0]), texture=True),
    Sample(
        "alpha by image",
        lambda n: n("BsdfPrincipled", {"Base Color": ROSE, "Alpha": image(n, alpha=True).outputs[1]}),
        sheet=True,
    ),
    Sample(
        "glow by image",
        lambda n: n("Emission", {0: image(n, Vector=n.coordinate("UV")).outputs[0], 1: 0.5}),
        texture=True,
    ),
)  # fmt: skip
assert len(CHART) == COLUMNS * ROWS


def tiles(picture: np.ndarray) -> np.ndarray:
    """(materials, T, T, C) of a picture (H, W, C), row 0 at the bottom, in CHART's order."""
    height, width, channels = picture.shape
    edge = height // ROWS
    parts = picture[::-1].reshape(ROWS, edge, COLUMNS, width // COLUMNS, channels).transpose(0, 2, 1, 3, 4)
    return parts.reshape(-1, edge, width // COLUMNS, channels)


def means(picture: np.ndarray) -> np.ndarray:
    """(materials, C) of the middles of the tiles of a picture (H, W, C), where nothing but them is seen."""
    parts = tiles(picture)
    edge = parts.shape[1]
    row, column = np.abs(np.mgrid[:edge, :edge] + 0.5 - edge / 2) / edge
    ball, sheet = np.hypot(row, column) < 0.9 * RADIUS, (row < 0.3) & (column < 0.2)
    chosen = (part[sheet if sample.sheet else ball] for part, sample in zip(parts, CHART, strict=True))
    return np.array([part.mean(axis=0) for part in chosen])


def build(edge: int) -> None:
    """Leave the chart as bpy's open file; a tile has ``edge`` pixels in a row."""
    import bpy

    from example_blends import studio

    scene = studio.empty_stage((0.2, 0.22, 0.25), (COLUMNS * edge, ROWS * edge))
    floor = studio.material("Floor", (0.5, 0.5, 0.5))
    studio.place("Floor", bpy.data.meshes.new("Floor"))
    corners = [(-9, -8, -0.5), (9, -8, -0.5), (9, 8, -0.5), (-9, 8, -0.5)]
    bpy.data.objects["Floor"].data.from_pydata(corners, [], [(0, 1, 2, 3)])
    bpy.data.objects["Floor"].data.materials.append(floor)
    for i, sample in enumerate(CHART):
        y, x = divmod(i, COLUMNS)
        mesh = _sheet(sample.name) if sample.sheet else _ball(sample.name)
        mesh.materials.append(_material(sample))
        where = (x - (COLUMNS - 1) / 2, (ROWS - 1) / 2 - y, 0)
        studio.place(
            sample.name, mesh, where, rotation_euler=(0, 1.0, 0) if sample.sheet else (0.9, 0.3, 0.2)
        )
    studio.light("AREA", (3, -4, 5), 400.0, (1.0, 0.9, 0.8), (0, 0, 0), shape="SQUARE", size=5.0)
    studio.light("SUN", (-4, 0, 3), 1.0, (0.8, 0.9, 1.0), (0, 0, 0), angle=0.6)
    camera = studio.camera((0, 0, 20), (0, 0, 0), lens=50)
    camera.data.type, camera.data.ortho_scale = "ORTHO", COLUMNS
    camera.matrix_world = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 20, 1))
    scene.camera = camera


def _material(sample: Sample) -> Any:
    import bpy

    material = bpy.data.materials.new(sample.name)
    if material.node_tree is None:
        material.use_nodes = True
    material.node_tree.nodes.clear()
    n = Nodes(material.node_tree)
    n("OutputMaterial", {"Surface": sample.shader(n).outputs[0]})
    return material


def _ball(name: str) -> Any:
    import bmesh
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.uv_layers.new(name="UVMap")
    shape = bmesh.new()
    shape.from_mesh(mesh)
    bmesh.ops.create_uvsphere(shape, u_segments=32, v_segments=16, radius=RADIUS, calc_uvs=True)
    shape.to_mesh(mesh)
    shape.free()
    mesh.polygons.foreach_set("use_smooth", [True] * len(mesh.polygons))
    paint = mesh.attributes.new("Paint", "FLOAT_COLOR", "POINT").data
    colours = np.random.default_rng(5).uniform(0, 1, (len(paint), 4)).astype(np.float32)
    paint.foreach_set("color", colours.ravel())
    return mesh


def _sheet(name: str) -> Any:
    import bpy

    mesh = bpy.data.meshes.new(name)
    x, y = 0.45, 0.35
    mesh.from_pydata([(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)], [], [(0, 1, 2, 3)])
    layer = mesh.uv_layers.new(name="UVMap")
    layer.uv.foreach_set("vector", np.float32([0, 0, 1, 0, 1, 1, 0, 1]))
    return mesh
