"""Compiles the native library for other platforms, so that it keeps compiling there though it runs nowhere here.

    python tools/cross_build.py OUT [--targets windows-x64,macos-arm64]

Zig brings a compiler with the headers and libraries of all of them. What is built is looked at: a library of that
platform's kind that exports all functions of ``frog_native.h``.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import ziglang

ROOT = Path(__file__).resolve().parents[1]
HEADER = ROOT / "frog_blender" / "engine" / "native" / "src" / "frog_native.h"


@dataclass(frozen=True)
class Target:
    """A platform as CMake and Zig name it, and how its libraries begin."""

    system: str
    processor: str
    triple: str
    magic: bytes


_ELF, _MACH, _PE = b"\x7fELF", b"\xcf\xfa\xed\xfe", b"MZ"
TARGETS = {
    "windows-x64": Target("Windows", "AMD64", "x86_64-windows-gnu", _PE),
    "windows-arm64": Target("Windows", "ARM64", "aarch64-windows-gnu", _PE),
    "macos-arm64": Target("Darwin", "arm64", "aarch64-macos", _MACH),
    "macos-x64": Target("Darwin", "x86_64", "x86_64-macos", _MACH),
    # The oldest glibc that Blender supports.
    "linux-x64": Target("Linux", "x86_64", "x86_64-linux-gnu.2.28", _ELF),
    "linux-arm64": Target("Linux", "aarch64", "aarch64-linux-gnu.2.28", _ELF),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path, help="a folder for the builds")
    parser.add_argument("--targets", default=",".join(TARGETS), help="default: %(default)s")
    options = parser.parse_args()
    names = options.targets.split(",")
    if unknown := [name for name in names if name not in TARGETS]:
        parser.error(f"--targets: found {', '.join(unknown)}, expected some of {', '.join(TARGETS)}")
    for name in names:
        library = build(TARGETS[name], options.out / name)
        check(library, TARGETS[name])
        print(f"{name}: {library} ({library.stat().st_size / 1e6:.1f} MB)", flush=True)


def build(target: Target, folder: Path) -> Path:
    """The library, built in ``folder``."""
    zig = Path(ziglang.__file__).with_name("zig")
    configure = [
        *("cmake", "-S", str(ROOT), "-B", str(folder), "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release"),
        f"-DCMAKE_SYSTEM_NAME={target.system}",
        f"-DCMAKE_SYSTEM_PROCESSOR={target.processor}",
        f"-DCMAKE_CXX_COMPILER={zig};c++;-target;{target.triple}",
    ]
    for command in (configure, ["cmake", "--build", str(folder)]):
        ended = subprocess.run(command, capture_output=True, text=True)
        if ended.returncode:
            sys.exit(f"{target.triple}: {' '.join(command)}\n{ended.stdout}{ended.stderr}")
    return next(path for path in folder.glob("libfrog_native.*") if path.suffix in (".dll", ".dylib", ".so"))


def check(library: Path, target: Target) -> None:
    """Ends with a sentence where it is none of that platform's, or lacks a function."""
    content = library.read_bytes()
    if not content.startswith(target.magic):
        sys.exit(f"{library}: found {content[:4]!r}, expected a library for {target.triple}.")
    functions = set(re.findall(r"\bfrog_\w+(?=\()", HEADER.read_text(encoding="utf-8")))
    missing = sorted(name for name in functions if name.encode() not in content)
    if not functions or missing:
        sys.exit(f"{library}: found no {', '.join(missing)}.")


if __name__ == "__main__":
    main()
