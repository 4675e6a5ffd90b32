#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""CV Render's one tool: `python3 dev.py --help` says what it does.

It needs nothing but Python's standard library, keeps all it makes in `.dev/` and `dist/`, and reads
every version from pyproject.toml. Commands that need Blender go on in the Python of an environment
that has the `bpy` wheel.
"""

from __future__ import annotations

import sys

if sys.version_info < (3, 11):  # noqa: UP036
    sys.exit(f"dev.py needs Python 3.11 or newer, this is {sys.version.split()[0]}")

import argparse
import ctypes
import hashlib
import io
import os
import platform
import re
import shutil
import signal
import subprocess
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack, redirect_stdout
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parent
PRIVATE = ROOT / ".dev"
LOG = PRIVATE / "blender.log"
DIST = ROOT / "dist"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
BLENDERS: dict[str, str] = PROJECT["tool"]["cv-render"]["python"]
FULL: list[str] = PROJECT["tool"]["cv-render"]["full"]

EXTENSION = ("blender_manifest.toml", "__init__.py", "LICENSE", "cv_render", "engine_core")
MODULE = "bl_ext.user_default.cv_render"
# Blender's name of a platform -> the end of its wheels' names, which is pip's name of it.
PLATFORMS = {
    "linux-x64": "manylinux_2_28_x86_64",
    "windows-x64": "win_amd64",
    "macos-arm64": "macosx_13_0_arm64",
    "macos-x64": "macosx_13_0_x86_64",
}

# What bpy loads from the system, and the Debian package that has it.
LIBRARIES = {
    "libGL.so.1": "libgl1",
    "libICE.so.6": "libice6",
    "libSM.so.6": "libsm6",
    "libX11.so.6": "libx11-6",
    "libXext.so.6": "libxext6",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXrender.so.1": "libxrender1",
    "libXxf86vm.so.1": "libxxf86vm1",
    "libgomp.so.1": "libgomp1",
    "libxkbcommon.so.0": "libxkbcommon0",
}
APT = " ".join(["apt-get install -y python3-venv", *sorted(LIBRARIES.values())])


class Failure(Exception):
    """What the user reads, in one line, before exit code 1."""


class Missing(Failure):
    """The system lacks a package."""


def say(text: str) -> None:
    print(f"dev.py: {text}", file=sys.stderr, flush=True)


def run(*command: object) -> None:
    """Run a command that has to succeed."""
    try:
        subprocess.run([str(part) for part in command], check=True)
    except subprocess.CalledProcessError as error:
        raise Failure(f"{Path(error.cmd[0]).name} {' '.join(error.cmd[1:4])} ... failed") from error


# Environments


def interpreters(version: str) -> Iterator[str]:
    """Every Python of this ``version`` that is found: this one, those on the PATH, and pyenv's."""
    names = [sys.executable, shutil.which(f"python{version}"), shutil.which("python3")]
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    names += sorted(pyenv.glob(f"{version}.*/bin/python{version}"))
    for name in dict.fromkeys(str(name) for name in names if name):
        probe = [name, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
        if subprocess.run(probe, capture_output=True, text=True).stdout.strip() == version:
            yield name


def can_make_environments(python: str) -> bool:
    """Whether a Python has what Debian keeps apart, in python3-venv."""
    return not subprocess.run([python, "-c", "import ensurepip, venv"], capture_output=True).returncode


def find_python(version: str) -> str | None:
    """A Python of this version that can make environments; None if there is no Python of it at all."""
    found = list(interpreters(version))
    for python in found:
        if can_make_environments(python):
            return python
    if found:
        raise Missing(f"{found[0]} lacks its venv package: {APT}")
    return None


def requirements(*groups: str) -> list[str]:
    """What pyproject.toml pins for the project and these dependency groups."""
    found = []
    for group in groups:
        for item in PROJECT["dependency-groups"][group]:
            found += requirements(item["include-group"]) if isinstance(item, dict) else [item]
    return found


def environment(name: str, version: str, wanted: list[str]) -> Path | None:
    """The Python of an environment that has all that is ``wanted``; None without a Python for it."""
    folder = PRIVATE / name
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    stamp = folder / "requirements.txt"
    if python.exists() and stamp.exists() and set(wanted) <= set(stamp.read_text("utf-8").splitlines()):
        return python
    base = find_python(version)
    if base is None:
        return None
    say(f"setting up {folder.relative_to(ROOT)} with Python {version} (once, takes a minute or two)")
    stamp.unlink(missing_ok=True)
    run(base, "-m", "venv", folder)
    run(python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *wanted)
    stamp.write_text("\n".join(wanted), "utf-8")
    return python


def blender(version: str, *groups: str) -> Path | None:
    """The Python of the environment with this Blender."""
    project = PROJECT["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["exr"]
    wanted = wanted + requirements(f"blender-{version}", *groups)
    return environment(f"blender-{version}", BLENDERS[version], wanted)


def any_blender(versions: list[str], *groups: str) -> Path:
    """The first of these Blenders that this machine can have."""
    check_system()
    for version in versions:
        if python := blender(version, *groups):
            return python
    raise Failure(f"no Python found for Blender {' or '.join(versions)}: it needs {pythons(versions)}")


def pythons(versions: list[str]) -> str:
    return " or ".join(f"Python {BLENDERS[version]}" for version in versions)


def check_system() -> None:
    """Say what to install before bpy says it with a traceback."""
    if sys.platform != "linux":
        return
    missing = []
    for library in LIBRARIES:
        try:
            ctypes.CDLL(library)
        except OSError:
            missing.append(library)
    if missing:
        raise Missing(f"Blender needs {', '.join(missing)}: {APT}")


# The extension


def this_platform() -> str:
    system = {"win32": "windows", "darwin": "macos"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    machine = {"amd64": "x64", "x86_64": "x64", "aarch64": "arm64"}.get(machine, machine)
    name = f"{system}-{machine}"
    if name not in PLATFORMS:
        raise Failure(
            f"embreex, which traces the rays, has no wheel for {name}; it has for {', '.join(PLATFORMS)}"
        )
    return name


def source_files() -> list[Path]:
    """All files of the extension but the wheels."""
    found = []
    for name in EXTENSION:
        path = ROOT / name
        found += [path] if path.is_file() else path.rglob("*")
    return sorted(path for path in found if path.is_file() and "__pycache__" not in path.parts)


def fingerprint(files: list[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        digest.update(f"{path.relative_to(ROOT)}\0".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def download(wheel: str, python: str | Path) -> Path:
    """A wheel of this name, unmodified from the package index, below .dev/wheels."""
    folder = PRIVATE / "wheels"
    target = folder / wheel
    if not target.exists():
        name, version, interpreter, abi, platforms = target.stem.split("-")
        say(f"downloading {name} {version} for {interpreter} on {platforms.split('.')[-1]}")
        run(
            *(python, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--dest", folder),
            *("--no-deps", "--only-binary=:all:", "--implementation", "cp", "--abi", abi),
            *("--python-version", interpreter[2:], "--platform", platforms.split(".")[-1]),
            f"{name}=={version}",
        )
        if not target.exists():
            raise Failure(f"the package index has no {wheel}: correct the name in blender_manifest.toml")
    return target


def build(platform_name: str, python: str | Path = sys.executable) -> Path:
    """The extension's zip for one platform, made anew only if a source changed.

    ``python`` has bpy, whose own packager makes and checks the zip.
    """
    text = (ROOT / "blender_manifest.toml").read_text("utf-8")
    manifest = tomllib.loads(text)
    target = DIST / f"{manifest['id']}-{manifest['version']}-{platform_name.replace('-', '_')}.zip"
    stamp = PRIVATE / f"{target.stem}.sha256"
    state = fingerprint([*source_files(), ROOT / "dev.py"])
    if target.exists() and stamp.exists() and stamp.read_text("utf-8") == state:
        return target

    DIST.mkdir(exist_ok=True)
    PRIVATE.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=PRIVATE, prefix="stage-") as temporary:
        stage = Path(temporary) / manifest["id"]
        for path in source_files():
            copy = stage / path.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)
        (stage / "wheels").mkdir()
        for wheel in manifest["wheels"]:
            if wheel.endswith(f"{PLATFORMS[platform_name]}.whl"):
                shutil.copyfile(download(Path(wheel).name, python), stage / wheel)
            else:
                text = text.replace(f'    "{wheel}",\n', "")
        text = re.sub(r"^platforms = .*$", f'platforms = ["{platform_name}"]', text, flags=re.MULTILINE)
        (stage / "blender_manifest.toml").write_text(text, "utf-8")

        made = Path(temporary) / target.name
        packager(python, "build", "--source-dir", stage, "--output-filepath", made)
        packager(python, "validate", made)
        os.replace(made, target)
    stamp.write_text(state, "utf-8")
    return target


def packager(python: str | Path, command: str, *arguments: object) -> None:
    """Blender's `extension build` or `extension validate`, without a Blender."""
    find = "import importlib.util as util; print(util.find_spec('bpy').submodule_search_locations[0])"
    bpy = Path(
        subprocess.run([python, "-c", find], capture_output=True, text=True, check=True).stdout.strip()
    )
    (script,) = bpy.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    (tags,) = bpy.glob("*/scripts/modules/_bpy_internal/extensions/tags.py")
    options = ("--valid-tags", tags) if command == "validate" else ()
    result = subprocess.run(
        [str(part) for part in (python, script, command, *options, *arguments)],
        capture_output=True,
        text=True,
    )
    if result.returncode:
        raise Failure(f"extension {command}: {' '.join((result.stdout + result.stderr).split())}")


def open_blender(archive: Path, resources: Path) -> ModuleType:
    """bpy with an empty scene and the extension of ``archive`` enabled; in an environment's own Python.

    The extension is installed below ``resources``, Blender's private folder, once for each ``archive``.
    """
    resources.mkdir(parents=True, exist_ok=True)
    os.environ["BLENDER_USER_RESOURCES"] = str(resources)  # read when bpy is first imported
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    stamp = resources / "installed.sha256"
    state = hashlib.sha256(archive.read_bytes()).hexdigest()
    if stamp.exists() and stamp.read_text("utf-8") == state:
        bpy.ops.preferences.addon_enable(module=MODULE)
    else:
        stamp.unlink(missing_ok=True)
        bpy.ops.extensions.package_install_files(
            filepath=str(archive), repo="user_default", enable_on_install=True, overwrite=True
        )
        stamp.write_text(state, "utf-8")
    if MODULE not in bpy.context.preferences.addons:
        stamp.unlink(missing_ok=True)
        raise Failure(f"Blender {bpy.app.version_string} did not take {archive}")
    return bpy


class Console(io.TextIOWrapper):
    """Standard output less Blender's echo of errors: they come as exceptions, and are told once."""

    def write(self, text: str) -> int:
        return len(text) if text.startswith("Error: ") else super().write(text)


def open_this_blender() -> ModuleType:
    """`open_blender` with the zip of the sources as they are, in this environment's own folder.

    From now on Blender's chatter goes to .dev/blender.log; what the engine prints is still seen.
    """
    archive = build(this_platform())
    sys.stdout = Console(os.fdopen(os.dup(1), "wb"), encoding="utf-8", line_buffering=True)
    sys.stderr = os.fdopen(os.dup(2), "w", buffering=1)
    with open(LOG, "w") as log, redirect_stdout(log):
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
        return open_blender(archive, Path(sys.prefix) / "resources")


# Commands


def in_blender(arguments: argparse.Namespace) -> int | None:
    """Run the same command line in an environment with bpy; None where this is that Python already."""
    python = any_blender([arguments.blender] if arguments.blender else list(BLENDERS))
    if os.path.samefile(sys.prefix, python.parent.parent):
        return None
    code = subprocess.call([python, __file__, *sys.argv[1:]])
    if code < 0:
        raise Failure(f"Blender crashed (signal {-code}); its last words are in {LOG}")
    return code


def render(arguments: argparse.Namespace) -> int:
    """Render one frame of a .blend into a PNG and a 32-bit EXR."""
    if not arguments.file.is_file():
        raise Failure(f"there is no file {arguments.file}")
    if (code := in_blender(arguments)) is not None:
        return code

    bpy = open_this_blender()
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl+C ends it at once: nothing is half written
    try:
        bpy.ops.wm.open_mainfile(filepath=str(arguments.file.resolve()), load_ui=False)
        scene = bpy.context.scene
        scene.render.engine = arguments.engine
        if arguments.samples is not None:
            getattr(scene, arguments.engine.lower()).samples = arguments.samples
        if arguments.resolution_percentage is not None:
            scene.render.resolution_percentage = arguments.resolution_percentage
        if arguments.frame is not None:
            scene.frame_set(arguments.frame)
        bpy.ops.render.render()
        save_picture(bpy, scene, arguments.output.resolve(), arguments.file.stem)
    except RuntimeError as error:
        raise Failure(f"{arguments.file.name}: {str(error).strip().removeprefix('Error: ')}") from error
    return 0


def save_picture(bpy: ModuleType, scene: object, folder: Path, name: str) -> None:
    """Write what was rendered: as it is seen into a PNG, as radiance into a 32-bit EXR."""
    image = scene.render.image_settings
    if hasattr(image, "media_type"):  # Blender 5
        image.media_type = "IMAGE"
    folder.mkdir(parents=True, exist_ok=True)
    for suffix, file_format, depth in ((".png", "PNG", "8"), (".exr", "OPEN_EXR", "32")):
        image.file_format = file_format
        image.color_depth = depth
        target = folder / (name + suffix)
        bpy.data.images["Render Result"].save_render(str(target), scene=scene)
        print(f"wrote {target}")


def test(arguments: argparse.Namespace) -> int:
    """Run the tests on every supported Python that is found; further options go to pytest."""
    check_system()
    versions = [version for version in BLENDERS if arguments.full or version not in FULL]
    if arguments.blender:
        versions = [arguments.blender]
    found = {version: python for version in versions if (python := blender(version))}
    if not found:
        raise Failure(f"no Python found to test with: wanted {pythons(versions)}")
    for version in versions:
        if version not in found:
            say(f"Blender {version} is left out: no Python {BLENDERS[version]} found")
    options = ["--full"] * arguments.full + arguments.options
    everything = not any((ROOT / option.partition("::")[0]).exists() for option in options)
    if everything:
        options.append("tests")
    if len(found) > 1:
        build(this_platform(), next(iter(found.values())))  # or each would, at the same time
    # Most tests keep one core busy, so all Pythons run at once: the first is seen at work, the others
    # speak when it is done.
    code, running = 0, []
    with ExitStack() as stack:
        for number, (version, python) in enumerate(found.items()):
            # `engine_core` knows no Blender, and its own tests take most of the time.
            part = [f"--part={number}/{len(found)}"] if everything and not arguments.full else []
            told = stack.enter_context(tempfile.TemporaryFile("w+")) if running else None
            ask = subprocess.DEVNULL if running else None
            command = [python, "-m", "pytest", *part, *options]
            process = subprocess.Popen(command, cwd=ROOT, stdin=ask, stdout=told, stderr=told)
            running.append((version, process, told))
        for version, process, told in running:
            say(f"testing with Blender {version} on Python {BLENDERS[version]}")
            code = process.wait() or code
            if told:
                told.seek(0)
                shutil.copyfileobj(told, sys.stdout)
                sys.stdout.flush()
    return code


def make_zips(arguments: argparse.Namespace) -> int:
    """Make the extension's zip for this platform, or for all."""
    python = any_blender(list(BLENDERS))
    for name in PLATFORMS if arguments.all_platforms else [this_platform()]:
        print(build(name, python))
    return 0


def shell(arguments: argparse.Namespace) -> int:
    """Open a Python prompt with `bpy`, the extension enabled."""
    if (code := in_blender(arguments)) is not None:
        return code
    import code as prompt

    prompt.interact(banner=">>> import bpy", local={"bpy": open_this_blender()}, exitmsg="")
    return 0


def bench(arguments: argparse.Namespace) -> int:
    """Run a benchmark; further options go to it."""
    names = sorted(path.stem for path in (ROOT / "benchmarks").glob("[a-z]*.py"))
    if arguments.name not in names:
        raise Failure(f"the benchmarks are {', '.join(names)}")
    python = any_blender([arguments.blender] if arguments.blender else list(BLENDERS), "bench")
    build(this_platform(), python)
    return subprocess.call([python, "-m", f"benchmarks.{arguments.name}", *arguments.options], cwd=ROOT)


def lint(arguments: argparse.Namespace) -> int:
    """Check the code with ruff, formatting too."""
    version = f"{sys.version_info[0]}.{sys.version_info[1]}"
    python = environment("lint", version, requirements("lint"))
    check, layout = (["--fix"], []) if arguments.fix else ([], ["--check"])
    code = subprocess.call([python, "-m", "ruff", "check", *check], cwd=ROOT)
    return subprocess.call([python, "-m", "ruff", "format", *layout], cwd=ROOT) or code


def clean(arguments: argparse.Namespace) -> int:
    """Remove all that dev.py and the tests made: environments, wheels, zips and caches."""
    made = [PRIVATE, DIST, ROOT / ".ruff_cache", *ROOT.glob("*.egg-info")]
    made += [path for name in ("__pycache__", ".pytest_cache") for path in ROOT.rglob(name)]
    for path in made:
        shutil.rmtree(path, ignore_errors=True)
    return 0


def check(arguments: argparse.Namespace) -> int:
    """Print the command that installs what the system lacks, or nothing."""
    try:
        check_system()
        for version in dict.fromkeys(BLENDERS.values()):
            find_python(version)
    except Missing as lack:
        say(str(lack))
        print(APT)
        return 1
    return 0


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="dev.py", description=__doc__.partition("\n")[0], allow_abbrev=False)
    commands = top.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, function: object) -> argparse.ArgumentParser:
        added = commands.add_parser(
            name, help=function.__doc__, description=function.__doc__, allow_abbrev=False
        )
        added.set_defaults(function=function)
        return added

    frame = command("render", render)
    frame.add_argument("file", type=Path, metavar="FILE.blend")
    frame.add_argument("-o", "--output", type=Path, default=Path(), metavar="FOLDER")
    frame.add_argument("--engine", default="CV_RENDER", choices=("CV_RENDER", "CYCLES"))
    frame.add_argument("--samples", type=int, metavar="N", help="instead of what the file says; so below")
    frame.add_argument("--resolution-percentage", type=int, metavar="N")
    frame.add_argument("--frame", type=int, metavar="N")
    tests = command("test", test)
    tests.add_argument("--full", action="store_true", help="the long ones too, and Blender " + " ".join(FULL))
    command("build", make_zips).add_argument("--all-platforms", action="store_true")
    prompt = command("shell", shell)
    benchmark = command("bench", bench)
    benchmark.add_argument("name", nargs="?", metavar="NAME", help="without it: says which there are")
    benchmark.add_argument("options", nargs=argparse.REMAINDER, help="the benchmark's own")
    for added in (frame, tests, prompt, benchmark):
        added.add_argument(
            "--blender", choices=BLENDERS, help="instead of all, or of the first that is found"
        )
    command("lint", lint).add_argument("--fix", action="store_true", help="mend what ruff can")
    command("clean", clean)
    command("check", check)
    return top


def main() -> int:
    top = parser()
    arguments, others = top.parse_known_args()
    if arguments.function is test:
        arguments.options = others
    elif others:
        top.error(f"unrecognized arguments: {' '.join(others)}")
    try:
        return arguments.function(arguments)
    except Failure as failure:
        say(str(failure))
        return 1
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
