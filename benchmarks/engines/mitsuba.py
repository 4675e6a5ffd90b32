# SPDX-License-Identifier: GPL-3.0-or-later
"""Mitsuba 3 beside Blender, in a process of its own: both bring an LLVM, which do not get on in one.

Blender's side writes the scene as arrays and asks for pictures, line by line; the other side (this
module run as a program) answers each line with the seconds it took.
"""

from __future__ import annotations

import ctypes.util
import json
import os
import subprocess
import sys
import time
from glob import glob
from pathlib import Path
from typing import Any, TextIO

import numpy as np

LLVM = 19
"""Mitsuba refuses 14 and older, and 15 has no code for some processors."""


class Unavailable(Exception):
    """Why Mitsuba does not race."""


class Mitsuba:
    """The open Blender scene in Mitsuba's `direct` integrator with multijittered samples."""

    name, family = "Mitsuba 3 (LLVM)", "mitsuba"
    sample_counts = (16, 64, 144, 324, 729)
    """Its multijittered sampler takes squares only."""

    def __init__(self, python: str, folder: Path) -> None:
        """python : an interpreter that has mitsuba. folder : where the scene's arrays may lie."""
        arrays = folder / "mitsuba.npz"
        np.savez(arrays, **scene_arrays())
        self._worker = subprocess.Popen(
            [python, "-m", "benchmarks.engines.mitsuba", str(arrays)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        answer = self._ask()
        if "error" in answer:
            self.close()
            raise Unavailable(answer["error"])

    def _ask(self) -> dict[str, Any]:
        line = self._worker.stdout.readline()
        return json.loads(line) if line else {"error": f"its process ended ({self._worker.wait()})"}

    def render(self, samples: int, seed: int, path: Path) -> float:
        """Render into an EXR; seconds from the loaded scene to the closed file."""
        import bpy

        render = bpy.context.scene.render
        question = (render.resolution_x, render.resolution_y, samples, seed, str(path))
        self._worker.stdin.write(json.dumps(question) + "\n")
        self._worker.stdin.flush()
        answer = self._ask()
        if "error" in answer:
            raise Unavailable(answer["error"])
        return answer["seconds"]

    def close(self) -> None:
        self._worker.stdin.close()
        self._worker.wait()


def scene_arrays() -> dict[str, np.ndarray]:
    """The open scene as arrays: triangles, lights, camera; Unavailable if it has what Mitsuba has not."""
    import bpy

    depsgraph = bpy.context.evaluated_depsgraph_get()
    arrays: dict[str, np.ndarray] = {}
    meshes = lights = 0
    for instance in depsgraph.object_instances:
        thing, matrix = instance.object, np.array(instance.matrix_world)
        if thing.type == "LIGHT":
            arrays |= {f"light{lights}_{key}": np.array(v) for key, v in _light(thing.data, matrix).items()}
            lights += 1
        elif thing.type == "MESH" and len(thing.data.polygons):
            mesh = thing.data
            mesh.calc_loop_triangles()
            corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
            mesh.loop_triangles.foreach_get("loops", corners)
            of_loop = np.empty(len(mesh.loops), np.int32)
            mesh.loops.foreach_get("vertex_index", of_loop)
            points = np.empty((len(mesh.vertices), 3), np.float32)
            mesh.vertices.foreach_get("co", points.ravel())
            normals = np.empty((len(mesh.loops), 3), np.float32)
            mesh.corner_normals.foreach_get("vector", normals.ravel())
            arrays[f"mesh{meshes}_points"] = points[of_loop[corners]] @ matrix[:3, :3].T + matrix[:3, 3]
            arrays[f"mesh{meshes}_normals"] = normals[corners] @ np.linalg.inv(matrix[:3, :3])
            arrays[f"mesh{meshes}_surface"] = np.array(json.dumps(_surface(mesh.materials[0])))
            meshes += 1
    world = bpy.context.scene.world.node_tree.nodes["Background"].inputs["Color"].default_value[:3]
    camera = bpy.context.scene.camera
    arrays["world"] = np.array(world)
    arrays["camera"] = np.array(camera.matrix_world) @ np.diag([-1.0, 1, -1, 1])
    arrays["field_of_view"] = np.degrees(2 * np.arctan(camera.data.sensor_width / 2 / camera.data.lens))
    arrays["counts"] = np.array([meshes, lights])
    return arrays


def _light(light: Any, matrix: np.ndarray) -> dict[str, Any]:
    power = np.array(light.color) * light.energy
    if light.type == "AREA":
        round_, long = light.shape in ("DISK", "ELLIPSE"), light.shape in ("RECTANGLE", "ELLIPSE")
        size = np.array([light.size, light.size_y if long else light.size])
        area = np.prod(size) * (np.pi / 4 if round_ else 1)
        # Mitsuba's rectangle is [-1, 1]^2 and faces +Z.
        to_world = matrix @ np.diag([*size / 2, 1, 1]) @ np.diag([1.0, -1, -1, 1])
        shape = "disk" if round_ else "rectangle"
        return {"shape": shape, "matrix": to_world, "radiance": power / (np.pi * area)}
    radius = light.shadow_soft_size
    if light.type == "POINT" and radius > 0 and not light.use_soft_falloff:
        to_world = matrix @ np.diag([radius] * 3 + [1])
        return {"shape": "sphere", "matrix": to_world, "radiance": power / (4 * np.pi**2 * radius**2)}
    raise Unavailable(f"it has no equal to this {light.type.lower()} light of Blender's")


def _surface(material: Any) -> dict[str, Any]:
    """A plugin of Mitsuba: a BSDF, or an area emitter."""
    (output,) = (node for node in material.node_tree.nodes if node.type == "OUTPUT_MATERIAL")
    shader = output.inputs["Surface"].links[0].from_node
    if any(socket.is_linked for socket in shader.inputs):
        raise Unavailable(f"{material.name!r} has textures, which are not handed over")

    def value(name: str) -> Any:
        found = shader.inputs[name].default_value
        return {"type": "rgb", "value": list(found)[:3]} if hasattr(found, "__len__") else found

    if shader.type == "BSDF_DIFFUSE":
        return {"type": "diffuse", "reflectance": value("Color")}
    if shader.type in ("BSDF_GLOSSY", "BSDF_ANISOTROPIC"):
        # A conductor without losses but its colour; its roughness is Blender's squared.
        return {"type": "roughconductor", "material": "none", "distribution": "ggx",
                "alpha": value("Roughness") ** 2, "specular_reflectance": value("Color")}  # fmt: skip
    if shader.type == "BSDF_PRINCIPLED":
        return {"type": "principled", "base_color": value("Base Color"), "roughness": value("Roughness"),
                "metallic": value("Metallic"), "clearcoat": value("Coat Weight")}  # fmt: skip
    if shader.type == "EMISSION":
        radiance = value("Color")
        radiance["value"] = [value("Strength") * channel for channel in radiance["value"]]
        return {"type": "area", "radiance": radiance}
    raise Unavailable(f"it has no equal to {shader.name}")


# The other side


def load(arrays: Any) -> Any:
    """The Mitsuba scene of `scene_arrays`, without its sensor."""
    import mitsuba as mi

    parts: dict[str, Any] = {"type": "scene"}
    meshes, lights = arrays["counts"]
    for i in range(meshes):
        points, normals = arrays[f"mesh{i}_points"], arrays[f"mesh{i}_normals"]
        surface = json.loads(str(arrays[f"mesh{i}_surface"]))
        properties = mi.Properties()
        if surface["type"] == "area":
            properties["emitter"] = mi.load_dict(surface)
        else:
            properties["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": surface})
        mesh = mi.Mesh(f"mesh{i}", len(points), len(points) // 3, has_vertex_normals=True, props=properties)
        values = mi.traverse(mesh)
        values["vertex_positions"] = points.astype(np.float32).ravel()
        values["vertex_normals"] = normals.astype(np.float32).ravel()
        values["faces"] = np.arange(len(points), dtype=np.uint32)
        values.update()
        parts[f"mesh{i}"] = mesh
    for i in range(lights):
        parts[f"light{i}"] = {
            "type": str(arrays[f"light{i}_shape"]),
            "to_world": mi.ScalarTransform4f(arrays[f"light{i}_matrix"]),
            "emitter": {
                "type": "area",
                "radiance": {"type": "rgb", "value": arrays[f"light{i}_radiance"].tolist()},
            },
        }
    if arrays["world"].any():
        parts["world"] = {"type": "constant", "radiance": {"type": "rgb", "value": arrays["world"].tolist()}}
    return mi.load_dict(parts)


def serve(arrays: Any, answers: TextIO) -> None:
    """Answer every line (width, height, samples, seed, path) of standard input with the seconds it took."""
    import mitsuba as mi

    scene = load(arrays)
    integrator = mi.load_dict({"type": "direct"})
    print(json.dumps({}), file=answers, flush=True)
    for line in sys.stdin:
        width, height, samples, seed, path = json.loads(line)
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": float(arrays["field_of_view"]),
                "fov_axis": "larger",
                "to_world": mi.ScalarTransform4f(arrays["camera"]),
                "film": {
                    "type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb",
                    "component_format": "float32", "rfilter": {"type": "box"},
                },
                "sampler": {"type": "multijitter", "sample_count": samples},
            }
        )  # fmt: skip
        start = time.perf_counter()
        picture = mi.render(scene, sensor=sensor, integrator=integrator, spp=samples, seed=seed)
        mi.Bitmap(picture).write(path)
        print(json.dumps({"seconds": time.perf_counter() - start}), file=answers, flush=True)


def main(path: str) -> None:
    """Serve, or say in one line why not."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # where Mitsuba may talk
    found = ctypes.util.find_library(f"LLVM-{LLVM}")
    libraries = [found] if found else sorted(glob(f"/usr/lib/*/libLLVM*.so*{LLVM}*"))
    if libraries:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", libraries[0])
    try:
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        import drjit

        drjit.llvm.Float(1) + 1
    except (ImportError, RuntimeError) as error:
        reason = f"needs the mitsuba package and libllvm{LLVM} ({' '.join(str(error).split())[:200]})"
        print(json.dumps({"error": reason}), file=answers, flush=True)
        return
    with np.load(path) as arrays:
        serve(dict(arrays), answers)


if __name__ == "__main__":
    main(sys.argv[1])
