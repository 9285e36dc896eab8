"""Build the Blender extension: ``python tools/build_extension.py [--wheels FOLDER] [--output FOLDER]``.

Copies the package with its native library, the manifest and the wheels that Blender's Python lacks into
``build/extension``, then lets Blender's own ``blender_ext.py`` (part of the bpy module) build the zip and validate it.
Without ``--wheels`` the safetensors wheel of this platform is fetched with pip.

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
LEFT_OUT = ("cli", "experiments")
"""Rooms of the package that nothing in Blender uses: the command line and what it alone calls."""


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


def copy_package(target: Path) -> None:
    """What Blender imports of the package: sources, kernels' sources and the native library, no caches."""
    package = ROOT / "frog_blender"
    if not any(path.suffix in LIBRARY_SUFFIXES for path in (package / "engine" / "native").iterdir()):
        raise SystemExit("The native library is not built; build it first (make setup), or the extension cannot draw.")
    caches = shutil.ignore_patterns("__pycache__", "*.pyc")

    def left_out(folder: str, names: list[str]) -> set[str]:
        return caches(folder, names) | (set(LEFT_OUT) if Path(folder) == package else set())

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


def write_manifest(target: Path, wheels: list[str]) -> None:
    text = (ROOT / "blender_manifest.toml").read_text()
    text = text.replace("# platforms = []", f'platforms = ["{blender_platform()}"]')
    text = text.replace(
        "# wheels = []", "wheels = [" + ", ".join(f'"{wheel}"' for wheel in wheels) + "]" if wheels else ""
    )
    (target / "blender_manifest.toml").write_text(text)


def build(output: Path, wheels: Path | None, work: Path) -> Path:
    """Assemble, build and validate; the path of the zip."""
    shutil.rmtree(work, ignore_errors=True)
    copy_package(work)
    write_manifest(work, add_wheels(work, wheels))
    output.mkdir(parents=True, exist_ok=True)
    zip_path = output / f"frog_blender-{version()}-{blender_platform()}.zip"
    tool = [sys.executable, str(blender_ext())]
    for arguments in (
        ["build", "--source-dir", str(work), "--output-filepath", str(zip_path)],
        ["validate", str(zip_path)],
    ):
        if subprocess.run([*tool, *arguments]).returncode:
            raise SystemExit(f"Blender's extension tool failed: {' '.join(arguments)}")
    return zip_path


def main() -> None:
    parser = argparse.ArgumentParser(description="Build the Blender extension.")
    parser.add_argument("--wheels", type=Path, help="folder of wheels to ship instead of fetching them")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="where the zip goes")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "extension", help="where it is assembled")
    parser.add_argument("--expect", metavar="PLATFORM", help="fail on any other platform, such as linux-x64")
    options = parser.parse_args()
    if options.expect not in (None, blender_platform()):
        raise SystemExit(f"This machine is {blender_platform()}, expected {options.expect}.")
    print(build(options.output, options.wheels, options.work))


if __name__ == "__main__":
    main()
