"""Build the Blender extension: ``python tools/build_extension.py [--edition player] [--wheels FOLDER]``.

Copies the package with its native library, the manifest and the wheels that Blender's Python lacks into
``build/extension``, then lets Blender's own ``blender_ext.py`` (part of the bpy module) build the zip and validate it.
Without ``--wheels`` the safetensors wheel of this platform is fetched with pip.

The *player* imports, scrubs, edits, renders and exports; the rooms that train, calibrate and install torch are left
out of it, and with them every path to code from elsewhere. ``--index FOLDER`` puts the zip of the edition that trains
into a folder that Blender can use as a repository, once a web server serves it.

The zip is for the platform that it is built on, because of the native library; .github/workflows/extension.yml builds
on all of them.
"""

from __future__ import annotations

import argparse
import platform
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
REQUIREMENTS = ["safetensors>=0.4.3"]  # numpy comes with Blender
LIBRARY_SUFFIXES = (".so", ".dylib", ".dll")
LEFT_OUT = ("cli", "experiments", "engine/distributed")
"""Rooms of the package that nothing in Blender uses: the command line and what it alone calls."""
TRAINING = (
    "training_task",
    "calibration_task",
    "scene_capture",
    "torch_install",
    "viewport/live.py",
    "engine/api.py",
    "engine/training",
    "engine/model",
    "engine/evaluation",
    "engine/capture/calibration",
    "engine/capture/synchronization",
    "engine/capture/quality",
    *(
        f"operators/{name}.py"
        for name in (
            "calibrate",
            "capture_cameras",
            "capture_scene",
            "click_points",
            "install_torch",
            "open_capture",
            "show_result",
            "train",
            "training_result",
        )
    ),
    *(
        f"ui/{name}.py"
        for name in (
            "calibration_panel",
            "capture_panel",
            "capture_reading",
            "capture_summary",
            "contact_sheet",
            "points_overlay",
            "presets",
            "preview_image",
            "remote_settings",
            "report_images",
            "rig_images",
            "rig_overlay",
            "rig_settings",
            "scene_capture_panel",
            "status_bar",
            "torch_environment",
            "train_panel",
            "training_choices",
            "training_settings",
            "training_time",
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
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]


def blender_ext() -> Path:
    """Blender's command line for extensions, inside the bpy module; SystemExit with a sentence if there is none."""
    import importlib.util

    spec = importlib.util.find_spec("bpy")
    found = sorted(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")) if spec else []
    if not found:
        raise SystemExit("The bpy module is not installed here; it brings the tool that builds extensions.")
    return found[-1]


def copy_package(target: Path, edition: str) -> None:
    """What Blender imports of the package: sources, kernels' sources and the native library, no caches."""
    package = ROOT / "frog_blender"
    if not any(path.suffix in LIBRARY_SUFFIXES for path in (package / "engine" / "native").iterdir()):
        raise SystemExit("The native library is not built; build it first (make setup), or the extension cannot draw.")
    caches = shutil.ignore_patterns("__pycache__", "*.pyc")

    unwanted = {*LEFT_OUT, *(TRAINING if edition == "player" else ())}
    if gone := [name for name in unwanted if not (package / name).exists()]:
        raise SystemExit(f"{gone[0]}: there is no such part of the package any more; mend LEFT_OUT or TRAINING.")

    def left_out(folder: str, names: list[str]) -> set[str]:
        place = Path(folder).relative_to(package)
        return caches(folder, names) | {name for name in names if (place / name).as_posix() in unwanted}

    shutil.copytree(package, target, ignore=left_out)
    for name in ("LICENSE", "README.md"):
        if (ROOT / name).is_file():
            shutil.copy2(ROOT / name, target)


def add_wheels(target: Path, source: Path | None) -> list[str]:
    """Put the wheels into ``wheels/``, from a folder or with pip, and return their paths in the extension."""
    folder = target / "wheels"
    folder.mkdir()
    if source is not None:
        for wheel in sorted(source.glob("*.whl")):
            shutil.copy2(wheel, folder)
    else:
        options = ["--only-binary=:all:", "--no-deps", "--quiet", "--disable-pip-version-check"]
        command = [sys.executable, "-m", "pip", "download", *options, "--dest", str(folder), *REQUIREMENTS]
        if subprocess.run(command).returncode:
            raise SystemExit("The wheels could not be fetched; give a folder that has them with --wheels.")
    return [f"./wheels/{wheel.name}" for wheel in sorted(folder.glob("*.whl"))]


def write_manifest(target: Path, wheels: list[str], edition: str) -> None:
    text = (ROOT / "blender_manifest.toml").read_text()
    for line, instead in PLAYER.items() if edition == "player" else ():
        if line not in text:
            raise SystemExit(f"The manifest has no line {line.strip()!r} any more; mend PLAYER.")
        text = text.replace(line, instead)
    text = text.replace("# platforms = []", f'platforms = ["{blender_platform()}"]')
    text = text.replace(
        "# wheels = []", "wheels = [" + ", ".join(f'"{wheel}"' for wheel in wheels) + "]" if wheels else ""
    )
    (target / "blender_manifest.toml").write_text(text)


def build(output: Path, wheels: Path | None, work: Path, edition: str) -> Path:
    """Assemble, build and validate; the path of the zip."""
    shutil.rmtree(work, ignore_errors=True)
    copy_package(work, edition)
    write_manifest(work, add_wheels(work, wheels), edition)
    output.mkdir(parents=True, exist_ok=True)
    name = "frog_blender_player" if edition == "player" else "frog_blender"
    zip_path = output / f"{name}-{version()}-{blender_platform()}.zip"
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
    parser.add_argument("--wheels", type=Path, help="folder of wheels to ship instead of fetching them")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="where the zip goes")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "extension", help="where it is assembled")
    parser.add_argument("--expect", metavar="PLATFORM", help="fail on any other platform, such as linux-x64")
    options = parser.parse_args()
    if options.expect not in (None, blender_platform()):
        raise SystemExit(f"This machine is {blender_platform()}, expected {options.expect}.")
    if options.index is not None and options.edition == "player":
        parser.error("--index is for the edition that trains: Blender's own repository serves the player.")
    zip_path = build(options.output, options.wheels, options.work, options.edition)
    if options.index is not None:
        add_to_index(zip_path, options.index)
    print(zip_path)


if __name__ == "__main__":
    main()
