# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests share: the built zip, Blender with that zip installed, and scripts run apart.

`engine_core` is imported as it stands in the repository; `cv_render` only out of the zip.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import compress, count
from pathlib import Path
from types import ModuleType

import pytest

import dev

# A script on its own starts where the fixture `cv` does: Blender open, the extension enabled.
PREAMBLE = """
import sys
sys.path.insert(0, {root!r})
from pathlib import Path
import dev
bpy = dev.open_blender(Path({archive!r}), Path({resources!r}))
"""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--full", action="store_true", help="run the long tests as well")
    parser.addoption("--part", default="0/1", help="NUMBER/OF: which part of engine_core's own tests")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    number, of = map(int, config.getoption("--part").split("/"))
    full = config.getoption("--full")
    chosen = [item for item in items if full or not item.get_closest_marker("full")]
    chosen = list(compress(chosen, in_part([item.path.name for item in chosen], number, of)))
    config.hook.pytest_deselected(items=list(set(items).difference(chosen)))
    items[:] = chosen


def in_part(files: list[str], number: int, of: int) -> list[bool]:
    """Whether tests, by their files, are of a part: each ``of``-th of the engine's, and all else."""
    turn = count()
    return [not name.startswith("test_engine_") or next(turn) % of == number for name in files]


@pytest.fixture(scope="session")
def extension_zip() -> Path:
    """The extension for this platform, made anew if a source has changed."""
    return dev.build(dev.this_platform())


@pytest.fixture(scope="session")
def resources(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Blender's private folder, where the extension is installed once a session."""
    return tmp_path_factory.mktemp("resources")


@pytest.fixture(scope="session")
def cv(extension_zip: Path, resources: Path) -> Iterator[ModuleType]:
    """The extension's root module, installed from its zip and enabled in this process's bpy."""
    bpy = dev.open_blender(extension_zip, resources)
    yield sys.modules[dev.MODULE]
    bpy.ops.preferences.addon_disable(module=dev.MODULE)


@pytest.fixture(scope="session")
def run_script(extension_zip: Path, resources: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """``run_script(code, *arguments, timeout=120)`` in a process of its own, where a crash is a result.

    The code finds `bpy` with an empty scene and the extension enabled, and its arguments in sys.argv.
    """
    preamble = PREAMBLE.format(root=str(dev.ROOT), archive=str(extension_zip), resources=str(resources))

    def run(code: str, *arguments: object, timeout: float = 120) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", preamble + code, *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, timeout=timeout)

    return run
