# SPDX-License-Identifier: GPL-3.0-or-later
"""A sunflower of 10,000 instances: seeds by geometry nodes, petals by vertices, a meadow by collection."""

import math

import bpy
import numpy as np

from . import shapes, studio

SEEDS, PETALS, TUFTS = 9000, 89, 911
GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


def seed_positions() -> np.ndarray:
    """(SEEDS, 3) points of a sunflower's head on a shallow dome of radius 3."""
    i = np.arange(SEEDS) + 0.5
    radius, angle = 3 * np.sqrt(i / SEEDS), i * GOLDEN_ANGLE
    height = 0.75 * np.cos(radius * np.pi / 6.4)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1)


def instancing_nodes(seeds: bpy.types.Collection) -> bpy.types.NodeTree:
    """Geometry nodes that put a member of ``seeds`` on each point, chosen by its attribute ``kind``."""
    tree = bpy.data.node_groups.new("Seeds on points", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeInstanceOnPoints", "NodeGroupOutput")
    source, instance, target = (tree.nodes.new(kind) for kind in kinds)
    members = tree.nodes.new("GeometryNodeCollectionInfo")
    members.inputs["Collection"].default_value = seeds
    members.inputs["Separate Children"].default_value = True
    members.inputs["Reset Children"].default_value = True
    instance.inputs["Pick Instance"].default_value = True
    for name, kind, socket in (
        ("kind", "INT", "Instance Index"),
        ("tilt", "FLOAT_VECTOR", "Rotation"),
        ("size", "FLOAT", "Scale"),
    ):
        attribute = tree.nodes.new("GeometryNodeInputNamedAttribute")
        attribute.data_type = kind
        attribute.inputs["Name"].default_value = name
        tree.links.new(attribute.outputs["Attribute"], instance.inputs[socket])
    tree.links.new(source.outputs["Geometry"], instance.inputs["Points"])
    tree.links.new(members.outputs[0], instance.inputs["Instance"])
    tree.links.new(instance.outputs["Instances"], target.inputs["Geometry"])
    for column, node in enumerate((source, members, instance, target)):
        node.location = (220 * column, 0)
    return tree


def seed_head(collection: bpy.types.Collection) -> None:
    """The dome of seeds: one point each, tilted away from the axis and larger towards the rim."""
    points = seed_positions()
    radius, angle = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    cloud = studio.mesh("Seed points", points, np.empty((0, 3), int))
    # Spirals of 34 arms: neighbours along an arm are of one colour.
    kind = (np.arange(SEEDS) % 34) * len(collection.objects) // 34
    tilt = np.stack([np.zeros(SEEDS), 0.5 * (radius / 3) ** 2, angle], -1)
    for name, type_, field, values in (
        ("kind", "INT", "value", kind),
        ("tilt", "FLOAT_VECTOR", "vector", tilt),
        ("size", "FLOAT", "value", 0.028 + 0.011 * radius / 3),
    ):
        cloud.attributes.new(name, type_, "POINT").data.foreach_set(field, values.ravel().tolist())
    head = studio.place("Seed head", cloud)
    head.modifiers.new("Seeds on points", "NODES").node_group = instancing_nodes(collection)


def petals() -> None:
    """One petal at every vertex of a ring, turned by the vertex' normal."""
    along, across = np.meshgrid(np.linspace(0, 1, 9), np.linspace(-1, 1, 5), indexing="ij")
    width = 0.19 * np.sin(np.pi * along**0.8) ** 0.75
    lift = 0.3 * np.sin(2.2 * along) - 0.55 * along**2 + 0.12 * across**2 * np.sin(np.pi * along)
    # Vertex duplis turn the object's +Y (its track axis) to the vertex' normal.
    shape = np.stack([across * width, 1.35 * along, lift], -1).reshape(-1, 3)
    yellow = studio.material("Petal", (0.93, 0.58, 0.04))
    leaf = studio.mesh("Petal", shape, shapes.grid_faces(9, 5), yellow, True)
    angle = np.arange(PETALS) * GOLDEN_ANGLE
    outward = np.stack([np.cos(angle), np.sin(angle), np.zeros(PETALS)], -1)
    ring = studio.mesh("Petal ring", 2.88 * outward, np.empty((0, 3), int))
    parent = studio.place("Petal ring", ring, (0, 0, -0.05), instance_type="VERTS")
    parent.use_instance_vertices_rotation = True
    petal = studio.place("Petal", leaf)
    petal.parent, petal.track_axis, petal.up_axis = parent, "POS_Y", "Z"


def meadow(random: np.random.Generator) -> None:
    """Tufts of grass as collection instances around the flower."""
    t, turn = np.linspace(0, 1, 5)[:, None], np.arange(7)[:, None, None] * (2 * np.pi / 7)
    side, bend = 0.045 * (1 - t**2) * np.array([[-1.0, 1.0]]), random.uniform(0.1, 0.6, (7, 1, 1)) * t**2
    x, y = side * np.cos(turn) - bend * np.sin(turn), side * np.sin(turn) + bend * np.cos(turn)
    blades = np.stack(np.broadcast_arrays(x, y, 0.9 * t), -1)
    faces = np.concatenate([shapes.grid_faces(5, 2) + 10 * i for i in range(7)])
    green = studio.material("Grass", (0.09, 0.27, 0.06))
    tuft = bpy.data.collections.new("Tuft")
    tuft.objects.link(
        bpy.data.objects.new("Tuft", studio.mesh("Tuft", blades.reshape(-1, 3), faces, green, True))
    )
    # Where the camera sees ground: a ring about the flower that is open towards the camera.
    radius = 4.9 + 9.0 * np.arange(TUFTS) / TUFTS
    angle = np.pi * (1.25 * (np.arange(TUFTS) * GOLDEN_ANGLE / (2 * np.pi) % 1) - 0.125)
    for i in range(TUFTS):
        position = (radius[i] * math.cos(angle[i]), radius[i] * math.sin(angle[i]), -0.6)
        placed = studio.place(f"Tuft {i}", None, position, rotation_euler=(0, 0, 2 * np.pi * random.random()))
        placed.scale = (random.uniform(0.8, 1.5),) * 3
        placed.instance_type, placed.instance_collection = "COLLECTION", tuft


def build() -> None:
    studio.empty_stage(world=(0.10, 0.13, 0.20))
    kinds = bpy.data.collections.new("Seed kinds")
    for i, colour in enumerate(
        [(0.10, 0.05, 0.03), (0.42, 0.18, 0.05), (0.80, 0.42, 0.06), (0.30, 0.10, 0.05)]
    ):
        data = studio.ball(f"Seed {i}", 1.0, studio.material(f"Seed {i}", colour), cells=2)
        made = bpy.data.objects.new(f"Seed {i}", data)
        made.scale = (1.5, 0.8, 1.0)
        kinds.objects.link(made)
    seed_head(kinds)
    petals()
    meadow(np.random.default_rng(5))
    ground = studio.extruded("Ground", [(-80, 0), (80, 0)], 160, studio.material("Earth", (0.12, 0.15, 0.06)))
    studio.place("Ground", ground, (0, 0, -0.6))
    studio.light("SUN", (0, 0, 9), 3.0, (1.0, 0.88, 0.70), (5, 3.5, 3.5), angle=0.03)
    studio.camera((0.0, -9.6, 6.6), (0.0, -0.15, 0.0), lens=42)
