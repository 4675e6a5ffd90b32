# SPDX-License-Identifier: GPL-3.0-or-later
"""The tooling: what is in the zip, what is installed, and what dev.py says."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import conftest
import pytest

import dev

MANIFEST = tomllib.loads((dev.ROOT / "blender_manifest.toml").read_text("utf-8"))


# These run in an environment that dev.py made, and not where they would make one.
of_dev = pytest.mark.skipif(Path(sys.prefix).parent != dev.PRIVATE, reason="not run by dev.py")
RENDER = ("render", "--blender", Path(sys.prefix).name.removeprefix("blender-"))


def run_dev(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(dev.ROOT / "dev.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=600)


def run_python(code: str, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, **options
    )


def test_zip_holds_the_extension_and_nothing_else(extension_zip: Path):
    names = zipfile.ZipFile(extension_zip).namelist()
    files = [name for name in names if not name.endswith("/")]
    assert {"blender_manifest.toml", "__init__.py", "LICENSE", "cv_render/__init__.py"} <= set(files)
    assert {name.partition("/")[0] for name in files} == {*dev.EXTENSION, "wheels"}
    assert not [name for name in files if "__pycache__" in name or name.endswith((".pyc", ".blend", ".obj"))]
    assert extension_zip.stat().st_size < 60e6


def test_zip_names_its_platform_and_holds_just_its_wheels(extension_zip: Path):
    with zipfile.ZipFile(extension_zip) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        wheels = {f"./{name}" for name in archive.namelist() if name.endswith(".whl")}
    assert manifest["platforms"] == [dev.this_platform()]
    assert set(manifest["wheels"]) == wheels
    assert len(wheels) == 3
    without_build = {key: value for key, value in manifest.items() if key not in ("platforms", "wheels")}
    assert without_build == {key: MANIFEST[key] for key in without_build}


def test_zip_passes_blenders_validation(extension_zip: Path):
    dev.packager(sys.executable, "validate", extension_zip)


def test_zip_is_not_made_twice(extension_zip: Path):
    before = extension_zip.stat().st_mtime_ns
    assert dev.build(dev.this_platform()) == extension_zip
    assert extension_zip.stat().st_mtime_ns == before


def test_manifest_agrees_with_pyproject():
    project = dev.PROJECT["project"]
    assert MANIFEST["version"] == project["version"]
    (embreex,) = [item for item in project["dependencies"] if item.startswith("embreex")]
    for wheel in MANIFEST["wheels"]:
        assert Path(wheel).name.startswith(embreex.replace("==", "-") + "-")


def test_manifest_has_a_wheel_for_each_platform_and_python():
    assert set(MANIFEST["platforms"]) == set(dev.PLATFORMS)
    for ending in dev.PLATFORMS.values():
        wheels = [wheel for wheel in MANIFEST["wheels"] if wheel.endswith(f"{ending}.whl")]
        assert [wheel.split("-")[2] for wheel in wheels] == ["cp311", "cp313", "cp314"]


def test_manifest_asks_for_no_permission():
    assert "permissions" not in MANIFEST


@pytest.mark.full
@pytest.mark.parametrize("platform", [name for name in dev.PLATFORMS if name != dev.this_platform()])
def test_zips_of_other_platforms_are_made(platform: str):
    archive = dev.build(platform)
    assert len([name for name in zipfile.ZipFile(archive).namelist() if name.endswith(".whl")]) == 3


def test_bundled_wheel_is_the_one_that_is_loaded(run_script):
    # An embreex of the environment would hide one that is missing from the zip.
    result = run_script(
        """
paths = [path for path in sys.path if "extensions" in path]
import importlib.machinery
print(importlib.machinery.PathFinder.find_spec("embreex", paths).origin)
"""
    )
    assert result.returncode == 0, result.stderr
    assert ".local" in result.stdout


def test_engine_core_needs_no_blender():
    code = "import sys; sys.modules['bpy'] = None; import engine_core; assert 'cv_render' not in sys.modules"
    result = run_python(code, cwd=dev.ROOT)
    assert result.returncode == 0, result.stderr


@pytest.mark.full
def test_pip_installs_engine_core_alone(tmp_path: Path):
    source, target = tmp_path / "source", tmp_path / "target"
    source.mkdir()
    for name in (*dev.EXTENSION, "pyproject.toml", "README.md", "tests"):
        copy = shutil.copytree if (dev.ROOT / name).is_dir() else shutil.copyfile
        copy(dev.ROOT / name, source / name)
    dev.run(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", target, source)
    assert {path.name for path in target.iterdir() if path.suffix != ".dist-info"} == {"engine_core"}
    result = run_python(f"import sys; sys.path.insert(0, {str(target)!r}); import engine_core", cwd=tmp_path)
    assert result.returncode == 0, result.stderr


def test_readme_has_the_apt_line_of_dev():
    assert dev.APT in (dev.ROOT / "README.md").read_text("utf-8")


def test_missing_library_is_one_line_with_what_to_install(monkeypatch, capsys):
    monkeypatch.setattr(dev, "LIBRARIES", {"libnowhere.so.1": "libnowhere1"})
    monkeypatch.setattr(sys, "argv", ["dev.py", "render", __file__])
    assert dev.main() == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "libnowhere.so.1" in lines[0] and dev.APT in lines[0]


def test_missing_venv_package_is_one_line_with_what_to_install(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(dev, "PRIVATE", tmp_path)
    monkeypatch.setattr(dev, "ROOT", tmp_path)
    monkeypatch.setattr(dev, "can_make_environments", lambda python: False)
    monkeypatch.setattr(sys, "argv", ["dev.py", "test"])
    assert dev.main() == 1
    lines = capsys.readouterr().err.splitlines()
    assert "venv" in lines[-1] and dev.APT in lines[-1]


def test_render_of_a_missing_file_is_one_line():
    result = run_dev("render", "nowhere.blend")
    assert result.returncode == 1
    assert result.stderr.splitlines() == ["dev.py: there is no file nowhere.blend"]


@of_dev
def test_render_writes_a_png_and_an_exr(tmp_path: Path):
    blend = dev.ROOT / "example_blends" / "soft_shadow.blend"
    result = run_dev(*RENDER, blend, "-o", tmp_path, "--samples", 1, "--resolution-percentage", 10)
    assert result.returncode == 0, result.stderr
    for name in ("soft_shadow.png", "soft_shadow.exr"):
        assert (tmp_path / name).stat().st_size > 1000
        assert str(tmp_path / name) in result.stdout


@of_dev
def test_render_that_cannot_be_is_one_line(tmp_path: Path, run_script):
    blend = tmp_path / "no_camera.blend"
    result = run_script("bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])", blend)
    assert result.returncode == 0, result.stderr
    result = run_dev(*RENDER, blend, "-o", tmp_path)
    assert result.returncode == 1
    (line,) = result.stderr.splitlines()
    assert line.startswith("dev.py: no_camera.blend: ") and "camera" in line.lower()
    assert not (tmp_path / "no_camera.png").exists()


def test_each_test_of_the_engine_is_in_one_part_and_all_others_in_every():
    files = ["test_dev.py", *["test_engine_fog.py"] * 5, "test_extension_world.py", "test_engine_trial.py"]
    one, other = (conftest.in_part(files, number, 2) for number in range(2))
    assert one == [True, True, False, True, False, True, True, False]
    assert other == [True, False, True, False, True, False, True, True]
    assert all(conftest.in_part(files, 0, 1))


def test_requirements_follow_included_groups():
    found = dev.requirements("blender-5.2")
    assert any(item.startswith("pytest==") for item in found)
    assert all("==" in item for item in found)
