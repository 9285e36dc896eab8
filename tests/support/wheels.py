"""Packages of the tests' own for pip to find."""

from __future__ import annotations

import sysconfig
import tomllib
import zipfile
from pathlib import Path

from support.builders import REPOSITORY

from frog_blender.engine.native.binding import library_path


def wheel(folder: Path, requirement: str, content: str = "") -> None:
    """A package of one file, as an index would serve it, of the version that is required."""
    folder.mkdir(exist_ok=True)
    name, _, pinned = requirement.partition("==")
    version = pinned or "9.9"
    module = name.replace("-", "_")
    info = f"{module}-{version}.dist-info"
    with zipfile.ZipFile(folder / f"{module}-{version}-py3-none-any.whl", "w") as file:
        file.writestr(f"{module}/__init__.py", content)
        file.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        file.writestr(
            f"{info}/WHEEL", "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        file.writestr(f"{info}/RECORD", "")


def native_wheel(folder: Path) -> None:
    """The wheel of the native library, of the one that was compiled for this environment: compiling takes a minute."""
    version = tomllib.loads((REPOSITORY / "blender_manifest.toml").read_text())["version"]
    tag = "py3-none-" + sysconfig.get_platform().replace("-", "_").replace(".", "_")
    info = f"frog_blender_native-{version}.dist-info"
    metadata = f"Metadata-Version: 2.1\nName: frog-blender-native\nVersion: {version}\n"
    folder.mkdir(exist_ok=True)
    with zipfile.ZipFile(folder / f"frog_blender_native-{version}-{tag}.whl", "w", zipfile.ZIP_DEFLATED) as file:
        for path in (*(REPOSITORY / "packaging/native/frog_blender_native").glob("*.py"), library_path()):
            file.write(path, f"frog_blender_native/{path.name}")
        file.writestr(f"{info}/METADATA", metadata)
        file.writestr(f"{info}/WHEEL", f"Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: false\nTag: {tag}\n")
        file.writestr(f"{info}/RECORD", "")
