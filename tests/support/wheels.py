"""Packages of the tests' own for pip to find."""

from __future__ import annotations

import zipfile
from pathlib import Path


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
