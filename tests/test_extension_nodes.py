# SPDX-License-Identifier: GPL-3.0-or-later
"""Node graphs: what is exported of them, and that it says what Cycles says, pixel by pixel.

Emission at the pixels' centres needs neither lights nor samples: Cycles' picture of one sample, through the
narrowest filter, is compared with the exported expressions themselves.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from extension_scenes import (
    add,
    add_camera,
    add_cube,
    add_light,
    add_mesh,
    diffuse,
    export,
    like_cycles,
    new_scene,
    render,
    surface,
    tree,
)

WIDTH, HEIGHT = 60, 40


def build(name: str, make: Callable[[Nodes], Any]) -> Any:
    """A material that emits the socket, or the (colour, strength), that ``make`` gives."""
    material = surface(name, "ShaderNodeEmission")
    nodes = tree(material)
    glow = next(node for node in nodes.nodes if node.type == "EMISSION")
    made = make(Nodes(nodes))
    for socket, wanted in zip(made if isinstance(made, tuple) else (made,), glow.inputs, strict=False):
        nodes.links.new(socket, wanted)
    return material


class Nodes:
    """Makes nodes of a tree in one line."""

    def __init__(self, nodes: Any) -> None:
        self._tree = nodes

    def __call__(self, kind: str, inputs: dict[Any, Any] | None = None, **options: Any) -> Any:
        """A node of ``kind``; inputs by number, identifier or name, each a value or another node's output."""
        import bpy

        node = self._tree.nodes.new(f"ShaderNode{kind}")
        for name, value in options.items():
            setattr(node, name, value)
        for key, value in (inputs or {}).items():
            known = {socket.name: socket for socket in reversed(node.inputs)}
            known |= {socket.identifier: socket for socket in node.inputs}
            socket = node.inputs[key] if isinstance(key, int) else known[key]
            if isinstance(value, bpy.types.NodeSocket):
                self._tree.links.new(value, socket)
            else:
                socket.default_value = value
        return node

    def coordinate(self, name: str) -> Any:
        return self("TexCoord").outputs[name]

    def number(self) -> Any:
        """From about -1 to 1 over each object."""
        return self("SeparateXYZ", {0: self.coordinate("Object")}).outputs[0]

    def colour(self) -> Any:
        return self("VectorMath", {0: self.coordinate("Object"), 1: (0.4, -0.3, 0.5)}).outputs[0]

    def shown(self, vector: Any) -> Any:
        """A vector of length 1 as a colour."""
        half = (0.5, 0.5, 0.5)
        return self("VectorMath", {0: vector, 1: half, 2: half}, operation="MULTIPLY_ADD").outputs[0]


def image(name: str, **options: Any) -> Any:
    """An image of random pixels."""
    import bpy

    space = options.pop("space", None)
    made = bpy.data.images.new(name, 6, 5, **options)
    if space:
        made.colorspace_settings.name = space
    pixels = np.random.default_rng(4).uniform(0.05, 1, (30, 4)).astype(np.float32)
    if not options.get("alpha"):
        pixels[:, 3] = 1
    made.pixels.foreach_set(pixels.ravel())
    made.update()
    return made


@pytest.fixture
def scene(cv: ModuleType) -> Any:
    scene = new_scene(WIDTH, HEIGHT)
    add_camera(scene, (0, -6, 3), (1.1, 0.05, 0.02))
    return scene


def put_objects(scene: Any, material: Any) -> None:
    """A sheet beyond its texture's borders, and a smooth mirrored ball and a cube with little of its data."""
    import bmesh
    import bpy

    sheet = add_mesh(
        scene,
        "Sheet",
        [(x, y, 0.1 * x * y) for y in (-1, 0, 1) for x in (-1, 0, 1)],
        [(i, i + 1, i + 4, i + 3) for i in (0, 1, 3, 4)],
        material,
        location=(-1.3, 0, 0.3),
        rotation=(0.6, 0.3, 0.4),
    )
    sheet.scale = (1.3, 1.1, 1)
    rng = np.random.default_rng(3)
    for name in ("UVMap", "Second"):
        layer = sheet.data.uv_layers.new(name=name)
        layer.uv.foreach_set("vector", rng.uniform(-0.8, 1.7, 2 * len(sheet.data.loops)).astype(np.float32))
    sheet.data.uv_layers["Second"].active_render = True
    for name, kind, domain, width in (
        ("Bytes", "BYTE_COLOR", "CORNER", 4),
        ("Floats", "FLOAT_COLOR", "POINT", 4),
        ("Faces", "FLOAT_VECTOR", "FACE", 3),
        ("Edges", "FLOAT", "EDGE", 1),
    ):
        data = sheet.data.attributes.new(name, kind, domain).data
        field = {1: "value", 3: "vector", 4: "color"}[width]
        data.foreach_set(field, rng.uniform(0, 1, width * len(data)).astype(np.float32))
    ball = bpy.data.meshes.new("Ball")
    shape = bmesh.new()
    bmesh.ops.create_uvsphere(shape, u_segments=12, v_segments=7, radius=1)
    shape.to_mesh(ball)
    shape.free()
    ball.polygons.foreach_set("use_smooth", [True] * len(ball.polygons))
    ball.uv_layers.new(name="UVMap")
    ball.materials.append(material)
    add(scene, "Ball", ball, (1.3, 0, 0.3), (0.3, 0.4, 0.5)).scale = (-1.1, 0.8, 1)
    cube = add_cube(scene, 1.1, material, location=(0, -1.8, 0.2), rotation=(0.5, 0.3, 0.7))
    cube.data.uv_layers.new(name="UVMap")


def exported_picture(cv: ModuleType) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(H, W, 3) emission at the pixels' centres, (H, W) where there is a surface, and the messages."""

    def engine(name: str) -> ModuleType:
        return importlib.import_module(f"{cv.engine_core.__name__}.{name}")

    scene, messages = export(cv)
    frame = engine("geometry.frame").frame_of(scene)
    triangles, _ = engine("geometry.triangles").gather_triangles(scene.meshes, frame)
    shader = engine("transport.surface_shading").SurfaceShader(scene.materials, triangles, frame)
    y, x = np.divmod(np.arange(WIDTH * HEIGHT), WIDTH)
    rays = engine("transport.camera_rays").CameraRays(scene.camera, frame)
    origins, directions = rays.rays(x, y, np.full((2, len(x), 1), 0.5, np.float32))
    points, _ = engine("geometry.surfaces").Surfaces(triangles).first_hit(origins, directions)
    picture, hit = np.zeros((len(x), 3), np.float32), np.zeros(len(x), bool)
    picture[points.lane] = shader.emission(points, -directions[points.lane].T).T
    hit[points.lane] = True
    return picture.reshape(HEIGHT, WIDTH, 3), hit.reshape(HEIGHT, WIDTH), messages


def blended(kind: str) -> Callable[[Nodes], Any]:
    return lambda n: n(
        "Mix",
        {"Factor_Float": n.number(), "A_Color": n.colour(), "B_Color": (0.7, 0.2, 0.4, 1)},
        data_type="RGBA",
        blend_type=kind,
    ).outputs[2]


def texture(**options: Any) -> Callable[[Nodes], Any]:
    fields = {key: options.pop(key) for key in ("alpha", "float_buffer", "space") if key in options}
    alpha_used = options.pop("alpha_used", False)
    coordinate = options.pop("coordinate", None)

    def make(n: Nodes) -> Any:
        inputs = {"Vector": n.coordinate(coordinate)} if coordinate else {}
        node = n("TexImage", inputs, image=image("Image", **fields), **options)
        return (node.outputs["Color"], node.outputs["Alpha"]) if alpha_used else node.outputs["Color"]

    return make


def ramp(interpolation: str, mode: str = "RGB") -> Callable[[Nodes], Any]:
    def make(n: Nodes) -> Any:
        node = n("ValToRGB", {0: n.number()})
        colours = node.color_ramp
        colours.color_mode, colours.interpolation = mode, interpolation
        colours.elements[0].color = (0.9, 0.1, 0.2, 1)
        colours.elements.new(0.4).color = (0.1, 0.8, 0.3, 0.5)
        return node.outputs["Color"]

    return make


def normal_map(space: str, strength: float) -> Callable[[Nodes], Any]:
    def make(n: Nodes) -> Any:
        colour = texture(space="Non-Color", interpolation="Closest")(n)
        node = n("NormalMap", {"Color": colour, "Strength": strength}, space=space)
        return n.shown(node.outputs[0])

    return make


def mapping(kind: str) -> Callable[[Nodes], Any]:
    inputs = {"Rotation": (0.3, 0.4, 0.5), "Scale": (1.2, -0.7, 2.0)}
    return lambda n: n.shown(
        n("Mapping", {"Vector": n.coordinate("UV")} | inputs, vector_type=kind).outputs[0]
    )


GRAPHS: dict[str, Callable[[Nodes], Any]] = {
    **{
        f"image {interpolation} {extension}": texture(interpolation=interpolation, extension=extension)
        for interpolation, extension in (
            ("Closest", "REPEAT"),
            ("Linear", "CLIP"),
            ("Linear", "MIRROR"),
            ("Cubic", "EXTEND"),
        )
    },
    "image linear": texture(space="Non-Color"),
    "image float": texture(float_buffer=True),
    "image with alpha": texture(alpha=True),
    "image and its alpha": texture(alpha=True, alpha_used=True),
    "image sphere": texture(projection="SPHERE", coordinate="Generated"),
    "image tube": texture(projection="TUBE", coordinate="Generated"),
    "image box": texture(projection="BOX", projection_blend=0.3, coordinate="Object"),
    "image missing": lambda n: n("TexImage").outputs["Color"],
    **{
        name: lambda n, name=name: n.shown(n.coordinate(name))
        for name in ("UV", "Object", "Generated", "Normal", "Reflection")
    },
    "uv map": lambda n: n("UVMap", uv_map="UVMap").outputs[0],
    **{
        f"attribute {name}": lambda n, name=name: n("Attribute", attribute_name=name).outputs["Color"]
        for name in ("Bytes", "Floats", "Faces", "Edges", "Second")
    },
    "colour attribute": lambda n: n("VertexColor", layer_name="Bytes").outputs["Color"],
    **{f"mapping {kind}": mapping(kind) for kind in ("POINT", "TEXTURE", "VECTOR", "NORMAL")},
    **{
        f"geometry {name}": lambda n, name=name: n.shown(n("NewGeometry").outputs[name])
        for name in ("Position", "True Normal", "Tangent", "Incoming", "Backfacing")
    },
    "fresnel": lambda n: n("Fresnel", {"IOR": 1.4}).outputs[0],
    "facing": lambda n: n("LayerWeight", {"Blend": 0.3}).outputs["Facing"],
    **{
        f"normal map {space} {strength}": normal_map(space, strength)
        for space, strength in (("TANGENT", 1.0), ("TANGENT", 0.5), ("OBJECT", 1.0), ("BLENDER_WORLD", 0.7))
    },
    "tangent": lambda n: n.shown(n("Tangent", direction_type="UV_MAP").outputs[0]),
    **{f"ramp {kind}": ramp(kind) for kind in ("LINEAR", "CONSTANT", "B_SPLINE")},
    "ramp HSV": ramp("LINEAR", "HSV"),
    **{
        f"mix {kind}": blended(kind)
        for kind in ("MIX", "OVERLAY", "BURN", "HUE", "SOFT_LIGHT", "LINEAR_LIGHT")
    },
    "math": lambda n: n(
        "Math",
        {0: n("Math", {0: n.number(), 1: 0.3}, operation="PINGPONG").outputs[0], 1: 0.7},
        operation="POWER",
    ).outputs[0],
    "vector math": lambda n: n.shown(
        n("VectorMath", {0: n.colour(), 1: (0.3, 0.5, 1)}, operation="CROSS_PRODUCT").outputs[0]
    ),
    "map range": lambda n: n("MapRange", {0: n.number(), 1: -0.5}, interpolation_type="SMOOTHSTEP").outputs[
        0
    ],
    "checker": lambda n: n("TexChecker", {"Scale": 3.3, "Color1": (0.9, 0.5, 0.1, 1)}).outputs["Color"],
    "gradient": lambda n: n("TexGradient", gradient_type="EASING").outputs["Color"],
    "hue": lambda n: n("HueSaturation", {"Hue": 0.7, "Saturation": 1.3, "Color": n.colour()}).outputs[0],
    "separate": lambda n: n("SeparateColor", {0: n.colour()}, mode="HSL").outputs[1],
    "rotate": lambda n: n.shown(
        n("VectorRotate", {"Vector": n.coordinate("Normal"), "Angle": 0.8}, rotation_type="Y_AXIS").outputs[0]
    ),
    "colour as strength": lambda n: (n("RGB").outputs[0], n.colour()),
    "black body": lambda n: n("Blackbody", {0: 2700.0}).outputs[0],
}


@pytest.mark.parametrize("graph", GRAPHS)
def test_nodes_give_what_those_of_cycles_give(cv: ModuleType, scene: Any, tmp_path: Path, graph: str) -> None:
    put_objects(scene, build("Graph", GRAPHS[graph]))
    like_cycles(scene, 1)
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    theirs = np.maximum(render(scene, tmp_path, "CYCLES")[..., :3], 0)
    ours, hit, messages = exported_picture(cv)
    error = np.abs(ours - theirs)[hit].max(axis=1)
    # From 5 on, Cycles makes the normal of a tangent frame a unit one between the corners, too.
    bound = 0.015 if "TANGENT" in graph else 2e-3
    # Where a texture jumps, or a silhouette is, a pixel may see the other side.
    assert np.quantile(error, 0.98) < bound and np.median(error) < 2e-3
    assert ours[hit].mean() == pytest.approx(theirs[hit].mean(), rel=3e-3)
    assert not messages


# What is exported, and what is said


def exported_material(cv: ModuleType, scene: Any, material: Any) -> tuple[Any, list[str]]:
    add_cube(scene, material=material)
    exported, messages = export(cv)
    return exported.materials[exported.meshes[0].materials], messages


def test_graphs_of_constants_stay_plain_materials(cv: ModuleType, scene: Any) -> None:
    material = build(
        "Constant",
        lambda n: n(
            "Mix",
            {
                "Factor_Float": n("Math", {0: 0.5, 1: 0.5}, operation="MULTIPLY").outputs[0],
                "B_Color": (1, 0, 0, 1),
            }
            | {"A_Color": n("CombineXYZ", {0: 0.2, 1: 0.4, 2: 0.8}).outputs[0]},
            data_type="RGBA",
        ).outputs[2],
    )
    found, messages = exported_material(cv, scene, material)
    assert found.surface is None and not messages
    assert np.allclose(found.emission, (0.4, 0.3, 0.6)) and not found.reflectance.any()


def test_meshes_have_only_the_attributes_that_their_materials_ask_for(cv: ModuleType, scene: Any) -> None:
    put_objects(scene, diffuse("Plain", (1, 1, 1)))
    assert not any(mesh.attributes for mesh in export(cv)[0].meshes)
    for obj in scene.objects:
        if obj.type == "MESH":
            obj.data.materials[0] = build("Seen", lambda n: n("UVMap", uv_map="Second").outputs[0])
    sheet, ball, cube = (mesh.attributes for mesh in export(cv)[0].meshes)
    assert set(sheet) == {"uv:Second"} and not ball and not cube
    assert sheet["uv:Second"].shape == (8, 3, 2)


def test_instances_share_coordinates_and_turn_round_where_mirrored(cv: ModuleType, scene: Any) -> None:
    import bpy

    material = build("Own", lambda n: n.coordinate("Object"))
    cube = add_cube(scene, 1.0, material)
    add(scene, "Mirror", cube.data, (3, 0, 0)).scale = (-2, 1, 1)
    bpy.context.view_layer.update()
    scene_, _ = export(cv)
    (mesh,) = scene_.meshes
    places = mesh.vertices[mesh.triangles] + scene_.origin
    own = mesh.attributes["object"]
    assert np.allclose(places[:12], own[:12], atol=1e-6)
    assert np.allclose(places[12:], own[12:] * (-2, 1, 1) + (3, 0, 0), atol=1e-6)


def test_tangents_of_the_two_sides_of_a_mirrored_map(cv: ModuleType) -> None:
    attributes = importlib.import_module(f"{cv.cv_render.__name__}.export.attributes")
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float)
    positions = np.concatenate([square[[[0, 1, 2], [0, 2, 3]]], (square - (1, 0, 0))[[[0, 1, 2], [0, 2, 3]]]])
    normals = np.broadcast_to((0.0, 0, 1), positions.shape)
    uv = np.abs(positions[..., :2])
    tangents, signs = attributes.tangents_along_u(positions, normals, uv)
    assert np.allclose(tangents[:2], (1, 0, 0)) and np.allclose(tangents[2:], (-1, 0, 0))
    assert signs.tolist() == [1, 1, -1, -1]


def test_missing_image_is_magenta_and_named(cv: ModuleType, scene: Any) -> None:
    import bpy

    lost = bpy.data.images.new("Lost", 4, 4)
    lost.source, lost.filepath = "FILE", "//lost.png"
    material = build("Wall", lambda n: n("TexImage", image=lost).outputs[0])
    found, messages = exported_material(cv, scene, material)
    assert found.surface is not None
    assert messages == ['Material "Wall": image "Lost" is missing ("//lost.png"), it is magenta']


def test_unknown_node_is_one_message_and_its_plain_value(cv: ModuleType, scene: Any) -> None:
    material = diffuse("Stone", (0.2, 0.3, 0.4))
    nodes = tree(material)
    noise = nodes.nodes.new("ShaderNodeTexNoise")
    shader = next(node for node in nodes.nodes if node.type == "BSDF_DIFFUSE")
    nodes.links.new(noise.outputs[1], shader.inputs["Color"])
    found, messages = exported_material(cv, scene, material)
    assert found.surface is None and np.allclose(found.reflectance, (0.2, 0.3, 0.4))
    assert messages == [
        'Material "Stone": node "Noise Texture" (Noise Texture) is not supported yet, '
        '"Color" of "Diffuse BSDF" keeps its plain value'
    ]


def test_colours_become_numbers_at_the_border_of_a_group(cv: ModuleType, scene: Any) -> None:
    import bpy

    group = bpy.data.node_groups.new("Grey", "ShaderNodeTree")
    group.interface.new_socket("Number", in_out="INPUT", socket_type="NodeSocketFloat")
    group.interface.new_socket("Colour", in_out="OUTPUT", socket_type="NodeSocketColor")
    start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    group.links.new(start.outputs[0], end.inputs[0])

    def make(n: Nodes) -> Any:
        red = n("RGB")
        red.outputs[0].default_value = (1, 0, 0, 1)
        node = n("Group")
        node.node_tree = group
        n._tree.links.new(red.outputs[0], node.inputs[0])
        return node.outputs[0]

    found, messages = exported_material(cv, scene, build("Grouped", make))
    assert np.allclose(found.emission, 0.2126, atol=1e-4) and not messages


def test_nodes_of_lights_are_folded_to_constants(cv: ModuleType, scene: Any) -> None:
    lamp = add_light(scene, "POINT", 10).data
    nodes = Nodes(tree(lamp))
    glow = next(node for node in tree(lamp).nodes if node.type == "EMISSION")
    tree(lamp).links.new(nodes("Blackbody", {0: 3000.0}).outputs[0], glow.inputs["Color"])
    tripled = nodes("Math", {0: 1.5, 1: 2.0}, operation="MULTIPLY").outputs[0]
    tree(lamp).links.new(tripled, glow.inputs["Strength"])
    exported, messages = export(cv)
    red, green, blue = exported.lights[0].power
    assert red > green > blue > 0 and not messages
    assert 0.2126 * red + 0.7152 * green + 0.0722 * blue == pytest.approx(30, rel=1e-3)


def test_what_varies_over_a_light_is_told(cv: ModuleType, scene: Any) -> None:
    lamp = add_light(scene, "POINT", 10).data
    glow = next(node for node in tree(lamp).nodes if node.type == "EMISSION")
    tree(lamp).links.new(Nodes(tree(lamp)).coordinate("Normal"), glow.inputs["Color"])
    exported, messages = export(cv)
    assert np.allclose(exported.lights[0].power, 10)
    assert len(messages) == 1 and "(Texture Coordinate) varies" in messages[0]


def test_principled_is_exported_with_all_that_it_can_do(cv: ModuleType, scene: Any) -> None:
    gold = surface(
        "Gold",
        "ShaderNodeBsdfPrincipled",
        **{"Base Color": (0.9, 0.6, 0.1, 1), "Metallic": 1.0, "Roughness": 0.3, "Emission Strength": 2.0},
        **{"Sheen Weight": 0.5, "Transmission Weight": 0.1},
    )
    found, messages = exported_material(cv, scene, gold)
    closure = found.surface
    assert type(closure).__name__ == "Principled" and closure.normal is None and closure.tangent is None
    assert np.allclose(closure.base_color[:, 0], (0.9, 0.6, 0.1)) and closure.roughness == np.float32(0.3)
    assert [message.partition(": ")[2] for message in messages] == [
        f'node "Principled BSDF" (Principled BSDF): {what} is not supported yet, '
        f"it is rendered as if its {name} were 0"
        for name, what in (("Transmission Weight", "transmission"), ("Sheen Weight", "sheen"))
    ]


@pytest.mark.parametrize(
    ("kind", "drawn", "told"),
    [
        ("BsdfTransparent", "Transparent", ""),
        ("BsdfTranslucent", "Translucent", ""),
        ("Holdout", "Holdout", ""),
        ("BsdfGlass", "Glossy", "is rendered without its refraction"),
        ("BsdfMetallic", "Principled", ""),
        ("BsdfToon", "Diffuse", "is rendered as Diffuse BSDF of its base colour"),
        ("SubsurfaceScattering", "Diffuse", "is rendered as Diffuse BSDF of its base colour"),
    ],
)
def test_each_shader_is_drawn_as_its_like(
    cv: ModuleType, scene: Any, kind: str, drawn: str, told: str
) -> None:
    import bpy

    if not hasattr(bpy.types, f"ShaderNode{kind}"):
        pytest.skip("this Blender does not have it")
    found, messages = exported_material(cv, scene, surface("Kind", f"ShaderNode{kind}"))
    drawn_as = type(found.surface).__name__ if found.surface is not None else "Diffuse"
    assert drawn_as == drawn
    assert len(messages) == bool(told) and all(told in message for message in messages)


def test_image_of_several_materials_is_read_once(cv: ModuleType, scene: Any) -> None:
    shared = image("Shared")
    for name in ("A", "B"):
        material = diffuse(name, (1, 1, 1))
        nodes = Nodes(tree(material))
        shader = next(node for node in tree(material).nodes if node.type == "BSDF_DIFFUSE")
        tree(material).links.new(nodes("TexImage", image=shared).outputs[0], shader.inputs["Color"])
        add_cube(scene, material=material)
    _, *materials = export(cv)[0].materials
    used = {id(material.surface.color.inputs[0].function.args[0]) for material in materials}
    assert len(materials) == 2 and len(used) == 1
