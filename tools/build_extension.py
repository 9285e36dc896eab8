"""Build the Blender extension: ``python tools/build_extension.py [--edition player] [--wheels FOLDER]``.

Copies the package, the manifest and the wheels that Blender's Python lacks into ``build/extension``, then lets
Blender's own ``blender_ext.py`` (part of the bpy module) build the zip and validate it. The native library is in a
wheel as well, that of ``packaging/native``. Wheels that ``--wheels`` does not have are fetched (safetensors) or built
(the native library, for the platform that this runs on).

The *player* imports, scrubs, edits, renders and exports; the rooms that train, calibrate and install torch are left
out of it, and with them every path to code from elsewhere. ``--index FOLDER`` puts the zip of the edition that trains
into a folder that Blender can use as a repository, once a web server serves it.

The zip is for one platform, because of the wheels: this machine's, or with ``--platform`` that of given wheels.
.github/workflows/extension.yml builds them all.
"""

from __future__ import annotations

import argparse
import importlib.util
import platform
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NATIVE, SAFETENSORS = "frog_blender_native", "safetensors"
REQUIREMENT = "safetensors>=0.4.3"  # numpy comes with Blender
TAGS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_17_x86_64"),
    "linux-arm64": ("manylinux_2_28_aarch64", "manylinux_2_17_aarch64"),
    "macos-arm64": ("macosx_11_0_arm64",),
    "macos-x64": ("macosx_11_0_x86_64",),
    "windows-x64": ("win_amd64",),
    "windows-arm64": ("win_arm64",),
}
"""The platforms that Blender runs on, each with the tags of wheels that it takes for certain, the newest first."""
LIBRARY_SUFFIXES = (".so", ".dylib", ".dll")
LEFT_OUT = ("cli", "research")
"""Rooms of the package that nothing in Blender uses: the command line, and research, which stands on the Python API."""
TRAINING = (
    "scene_capture",
    *(
        f"tasks/{name}.py"
        for name in (
            "calibration",
            "clocks",
            "installation",
            "package_folders",
            "packages",
            "scene_capture",
            "training",
            "training_request",
        )
    ),
    "viewport/live.py",
    "option_properties.py",
    "engine/api.py",
    "engine/distributed",
    "engine/given_options.py",
    "engine/options.py",
    "engine/recipes.py",
    "engine/setting.py",
    "engine/io/pip.py",
    "engine/io/pip_process.py",
    "engine/training",
    "engine/model",
    "engine/evaluation",
    "engine/capture/calibration",
    "engine/capture/synchronization",
    "engine/capture/quality_check.py",
    "engine/capture/quality_samples.py",
    *(
        f"operators/{name}.py"
        for name in (
            "calibrate",
            "capture_cameras",
            "capture_scene",
            "install_torch",
            "live_view",
            "open_capture",
            "show_result",
            "train",
        )
    ),
    *(
        f"ui/{name}.py"
        for name in (
            "capture_panel",
            "capture_reading",
            "capture_summary",
            "preview_image",
            "rig_overlay",
            "rig_settings",
            "status_bar",
            "graphics_card",
            "torch_environment",
            "train_panel",
            "training_settings",
        )
    ),
)
"""Rooms and files of the package that the player has not: what trains, and what installs packages for it."""
PLAYER = {
    'name = "FRoG"': 'name = "FRoG Player"',
    'tagline = "Train, scrub and render dynamic Gaussian scenes from video"': (
        'tagline = "Scrub, edit, render and export dynamic Gaussian scenes"'
    ),
    'files = "Read captures, write and read trained .frog scenes"': 'files = "Read and write Gaussian scenes"',
    'network = "Install torch and pycolmap when their buttons are pressed"\n': "",
}
"""Lines of the player's manifest in place of those of the edition that trains."""


def blender_platform() -> str:
    """This machine as the manifest names it, such as ``linux-x64``."""
    system = {"Linux": "linux", "Darwin": "macos", "Windows": "windows"}[platform.system()]
    machine = "arm64" if platform.machine().lower() in {"arm64", "aarch64"} else "x64"
    return f"{system}-{machine}"


def version() -> str:
    """The extension's, as its manifest says."""
    return str(tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"])


def blender_ext() -> Path:
    """Blender's command line for extensions, inside the bpy module; SystemExit with a sentence if there is none."""
    spec = importlib.util.find_spec("bpy")
    place = Path(spec.origin).parent if spec is not None and spec.origin else None
    found = sorted(place.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")) if place else []
    if not found:
        raise SystemExit("The bpy module is not installed here; it brings the tool that builds extensions.")
    return found[-1]


def copy_package(target: Path, edition: str) -> None:
    """What Blender imports of the package: sources and kernels' sources, no caches and no native library."""
    package = ROOT / "frog_blender"
    rubbish = shutil.ignore_patterns("__pycache__", "*.pyc", *(f"*{suffix}" for suffix in LIBRARY_SUFFIXES))

    unwanted = {*LEFT_OUT, *(TRAINING if edition == "player" else ())}
    if gone := [name for name in unwanted if not (package / name).exists()]:
        raise SystemExit(f"{gone[0]}: there is no such part of the package any more; mend LEFT_OUT or TRAINING.")

    def left_out(folder: str, names: list[str]) -> set[str]:
        place = Path(folder).relative_to(package)
        return rubbish(folder, names) | {name for name in names if (place / name).as_posix() in unwanted}

    shutil.copytree(package, target, ignore=left_out)
    for name in ("LICENSE", "README.md"):
        if (ROOT / name).is_file():
            shutil.copy2(ROOT / name, target)


def fits(wheel: Path, target: str) -> bool:
    """Whether a wheel is for a platform, by the end of its name: such as ``manylinux_2_28_x86_64`` for linux-x64."""
    tags = wheel.stem.split("-")[-1].split(".")
    system, machine = re.split(r"(?:_[0-9]+)*_", TAGS[target][0], maxsplit=1)
    systems = (system, "linux") if system == "manylinux" else (system,)
    return any(
        tag == "any" or (tag.startswith(systems) and tag.endswith((f"_{machine}", "_universal2"))) for tag in tags
    )


def add_wheels(folder: Path, source: Path | None, target: str) -> list[str]:
    """Put the wheels for ``target`` into ``folder``, as they are, and return their paths in the extension."""
    folder.mkdir()
    for wheel in sorted(source.glob("*.whl")) if source is not None else ():
        if fits(wheel, target):
            shutil.copy2(wheel, folder)
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    if not list(folder.glob(f"{SAFETENSORS}-*")):
        platforms = [] if target == blender_platform() else [f"--platform={tag}" for tag in TAGS[target]]
        options = ["--only-binary=:all:", "--no-deps", *platforms, "--dest", str(folder)]
        if subprocess.run([*pip, "download", *options, REQUIREMENT]).returncode:
            raise SystemExit(f"The wheel of {SAFETENSORS} could not be fetched; give a folder that has it (--wheels).")
    if not list(folder.glob(f"{NATIVE}-*")):
        if target != blender_platform():
            raise SystemExit(f"{source or '--wheels'}: found no wheel of {NATIVE} for {target}, expected one.")
        isolated = [] if importlib.util.find_spec("scikit_build_core") is None else ["--no-build-isolation"]
        options = ["--no-deps", *isolated, "--wheel-dir", str(folder), str(ROOT / "packaging" / "native")]
        if subprocess.run([*pip, "wheel", *options]).returncode:
            raise SystemExit(f"The wheel of {NATIVE} could not be built; give a folder that has it (--wheels).")
    wheels = sorted(wheel.name for wheel in folder.glob("*.whl"))
    if len({name.split("-")[0] for name in wheels}) < len(wheels):
        raise SystemExit(f"{source}: found {', '.join(wheels)} for {target}, expected one wheel of each package.")
    if not any(name.startswith(f"{NATIVE}-{version()}-") for name in wheels):
        raise SystemExit(f"{source}: found {', '.join(wheels)}, expected {NATIVE} {version()}.")
    return [f"./wheels/{name}" for name in wheels]


def write_manifest(target: Path, wheels: list[str], edition: str, platform_name: str) -> None:
    text = (ROOT / "blender_manifest.toml").read_text()
    for line, instead in PLAYER.items() if edition == "player" else ():
        if line not in text:
            raise SystemExit(f"The manifest has no line {line.strip()!r} any more; mend PLAYER.")
        text = text.replace(line, instead)
    listed = ", ".join(f'"{wheel}"' for wheel in wheels)
    for line, instead in (
        ("# platforms = []", f'platforms = ["{platform_name}"]'),
        ("# wheels = []", f"wheels = [{listed}]"),
    ):
        text = text.replace(line, instead)
    (target / "blender_manifest.toml").write_text(text)


def build(output: Path, wheels: Path | None, work: Path, edition: str, target: str) -> Path:
    """Assemble, build and validate; the path of the zip."""
    shutil.rmtree(work, ignore_errors=True)
    copy_package(work, edition)
    write_manifest(work, add_wheels(work / "wheels", wheels, target), edition, target)
    output.mkdir(parents=True, exist_ok=True)
    name = "frog_blender_player" if edition == "player" else "frog_blender"
    zip_path = output / f"{name}-{version()}-{target}.zip"
    run_tool("build", "--source-dir", str(work), "--output-filepath", str(zip_path))
    run_tool("validate", str(zip_path))
    return zip_path


def add_to_index(zip_path: Path, folder: Path) -> None:
    """Put a zip into the folder of a repository, and list what it holds now."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy2(zip_path, folder)
    run_tool("server-generate", "--repo-dir", str(folder))


def run_tool(*arguments: str) -> None:
    if subprocess.run([sys.executable, str(blender_ext()), *arguments]).returncode:
        raise SystemExit(f"Blender's extension tool failed: {' '.join(arguments)}")


def main() -> None:
    parser = argparse.ArgumentParser(description="Build the Blender extension.")
    parser.add_argument("--edition", choices=("training", "player"), default="training")
    parser.add_argument("--index", type=Path, help="folder of a repository that the zip is put into")
    parser.add_argument("--wheels", type=Path, help="folder of wheels to ship instead of fetching and building them")
    parser.add_argument("--platform", choices=TAGS, default=blender_platform(), help="default: %(default)s")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="where the zip goes")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "extension", help="where it is assembled")
    options = parser.parse_args()
    if options.index is not None and options.edition == "player":
        parser.error("--index is for the edition that trains: Blender's own repository serves the player.")
    zip_path = build(options.output, options.wheels, options.work, options.edition, options.platform)
    if options.index is not None:
        add_to_index(zip_path, options.index)
    print(zip_path)


if __name__ == "__main__":
    main()
