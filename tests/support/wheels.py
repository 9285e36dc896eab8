"""Packages of the tests' own for pip to find."""

import sysconfig
import tomllib
import zipfile
from pathlib import Path

from support.builders import REPOSITORY

from frog_blender.engine.native.binding import library_path


def wheel(folder: Path, requirement: str, content: str = "") -> None:
    """A package of one file, as an index would serve it, of the version that is required."""
    name, _, pinned = requirement.partition("==")
    _write(folder, name, pinned or "9.9", "py3-none-any", {"__init__.py": content.encode()})


def native_wheel(folder: Path) -> None:
    """The wheel of the native library, of the one that was compiled for this environment: compiling takes a minute."""
    version = tomllib.loads((REPOSITORY / "blender_manifest.toml").read_text())["version"]
    tag = "py3-none-" + sysconfig.get_platform().replace("-", "_").replace(".", "_")
    paths = *(REPOSITORY / "packaging/native/frog_blender_native").glob("*.py"), library_path()
    _write(folder, "frog-blender-native", version, tag, {path.name: path.read_bytes() for path in paths})


def _write(folder: Path, name: str, version: str, tag: str, files: dict[str, bytes]) -> None:
    module, purelib = name.replace("-", "_"), str(tag.endswith("any")).lower()
    about = {
        "METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n",
        "WHEEL": f"Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: {purelib}\nTag: {tag}\n",
        "RECORD": "",
    }
    folder.mkdir(exist_ok=True)
    with zipfile.ZipFile(folder / f"{module}-{version}-{tag}.whl", "w", zipfile.ZIP_DEFLATED) as archive:
        for file, content in files.items():
            archive.writestr(f"{module}/{file}", content)
        for file, text in about.items():
            archive.writestr(f"{module}-{version}.dist-info/{file}", text)
