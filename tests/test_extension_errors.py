# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes wrong ends with exit code 1 and a clear line; each in its own process, where a crash shows."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

Run = Callable[..., subprocess.CompletedProcess[str]]

PRELUDE = """
sys.path.insert(0, str(dev.ROOT / "tests"))
import os, signal, threading
from extension_scenes import *
cv = sys.modules[dev.MODULE]
session, core = cv.cv_render.session, cv.engine_core
scene = furnished(64, 48)
scene.render.filepath = sys.argv[1]

def raising(error):
    def function(*arguments, **fields):
        raise error
    return function
"""

RENDER = """
try:
    print(bpy.ops.render.render(write_still=True), flush=True)
except RuntimeError as error:
    print("RuntimeError:", error, flush=True)
    sys.exit(1)
"""

# (what happens, what the one line says)
FATAL = {
    "no camera": ("scene.camera = None", "no camera"),
    "panoramic camera": ('scene.camera.data.type = "PANO"', 'Camera "Camera" is panoramic'),
    "camera without a size": ("scene.camera.scale = (0, 0, 0)", 'Camera "Camera" has a scale of zero'),
    "border less than a pixel": (
        "r = scene.render; r.use_border = True; r.border_min_x, r.border_max_x = 0.5, 0.505",
        "too small",
    ),
    "no ray tracer": (
        """
import importlib
sys.modules["embreex"] = sys.modules["embreex.rtcore_scene"] = None
sys.modules["embreex.mesh_construction"] = None
importlib.reload(cv.engine_core.geometry.raytracer)
for module in list(sys.modules.values()):
    if getattr(module, "__name__", "").startswith(cv.__name__) and hasattr(module, "RayTracer"):
        module.RayTracer = cv.engine_core.geometry.raytracer.RayTracer
""",
        "embreex is missing",
    ),
    "too little memory": (
        "cv.cv_render.memory.available = lambda: 1000",
        'Most goes to object "Cube"',
    ),
    "memory runs out": ("session.export_scene = raising(MemoryError())", "Out of memory"),
    "bug before any tile": ("session.export_scene = raising(ValueError('bug'))", "ValueError('bug')"),
    "bug in the renderer": ("core.render = raising(ValueError('bug'))", "ValueError('bug')"),
    "bug while a result is open": (
        "cv.cv_render.passes.np = None",
        "Unexpected error",
    ),
    "bug after the tiles": ("session._tell = raising(ValueError('bug'))", "ValueError('bug')"),
    "bug in progress": ("session.BlenderSink.progress = raising(ValueError('bug'))", "ValueError('bug')"),
    "exit": ("core.render = raising(SystemExit(3))", "SystemExit(3)"),
}


@pytest.mark.parametrize("case", FATAL)
def test_what_cannot_be_rendered_is_one_clear_error(run_script: Run, tmp_path: Path, case: str) -> None:
    setup, line = FATAL[case]
    picture = tmp_path / "picture.exr"
    done = run_script(PRELUDE + setup + RENDER, picture)
    assert done.returncode == 1, done.stderr
    assert line in done.stdout, done.stdout
    assert not picture.exists()


TOLERATED = {
    "not a number": 'add_mesh(scene, "Bad", [(float("nan"), 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])',
    "faces without area": 'add_mesh(scene, "Bad", [(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1, 2)])',
    "empty mesh": 'add_mesh(scene, "Empty", [], [])',
    "no object at all": "[bpy.data.objects.remove(o) for o in list(scene.objects) if o.type == 'MESH']",
    "lights without size": "for kind in ('AREA', 'SUN', 'SPOT'): add_light(scene, kind).scale = (0, 0, 0)",
    "lights without power": "add_light(scene, 'POINT', 0.0); add_light(scene, 'SPOT', -5.0)",
    "objects without size": "add_cube(scene).scale = (0, 0, 0)",
    "objects without material": "add_cube(scene).data.materials.clear()",
    "empty material slots": "add_cube(scene).data.materials.append(None)",
    "no world": "scene.world = None",
    "another object as camera": "scene.camera = scene.objects['Area']",
}


@pytest.mark.parametrize("case", TOLERATED)
def test_what_can_be_rendered_is_rendered(run_script: Run, tmp_path: Path, case: str) -> None:
    picture = tmp_path / "picture.exr"
    check = "p = load(Path(sys.argv[1])); assert np.isfinite(p).all() and (p >= 0).all()"
    done = run_script(PRELUDE + TOLERATED[case] + RENDER + check, picture)
    assert done.returncode == 0, done.stdout + done.stderr
    assert picture.exists()


def test_two_renders_in_one_process(run_script: Run, tmp_path: Path) -> None:
    code = PRELUDE + "scene.camera.data.type = 'PANO'\n"
    code += "try: bpy.ops.render.render()\nexcept RuntimeError: print('refused')\n"
    code += "scene.camera.data.type = 'PERSP'\nbpy.ops.render.render()\n" + RENDER
    done = run_script(code, tmp_path / "picture.exr")
    assert done.returncode == 0 and "refused" in done.stdout, done.stdout + done.stderr
    assert (tmp_path / "picture.exr").exists()


def test_interrupt_ends_the_render_soon(run_script: Run, tmp_path: Path) -> None:
    code = (
        PRELUDE
        + """
scene.cv_render.samples = 1 << 20
# A shell may have started the tests where interrupts are ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
def interrupt():
    print("interrupting", flush=True)
    os.kill(os.getpid(), signal.SIGINT)
threading.Timer(1.5, interrupt).start()
import time
begin = time.monotonic()
import atexit
atexit.register(lambda: print(f"seconds {time.monotonic() - begin:.2f}", flush=True))
"""
        + RENDER
    )
    begin = time.monotonic()
    done = run_script(code, tmp_path / "picture.exr", timeout=60)
    assert "interrupting" in done.stdout
    assert done.returncode == 1, done.stdout + done.stderr
    seconds = float(done.stdout.rsplit("seconds", 1)[1])
    assert seconds < 1.5 + 2 and time.monotonic() - begin < 60
    assert "Interrupted" in done.stdout and "Traceback" not in done.stderr
