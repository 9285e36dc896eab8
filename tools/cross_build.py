"""Builds the native library's wheel for other platforms, so that it keeps compiling there though it runs nowhere here.

    python tools/cross_build.py OUT [--targets windows-x64,macos-arm64] [--wine wine] [--qemu "qemu-aarch64 -L X"]

Zig brings a compiler with the headers and libraries of all of them. What is built is looked at: a library of that
platform's kind that exports all functions of ``frog_native.h``. With ``--wine`` that for Windows x64 draws a Gaussian
(``tests/native/draw_one.cpp``), with ``--qemu`` that for Linux on ARM. The wheels are for trying out what is made of
them (``tools/build_extension.py --platform``); what users get is built on the platforms themselves, by cibuildwheel.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path

import ziglang

ROOT = Path(__file__).resolve().parents[1]
PROJECT = ROOT / "packaging" / "native"
HEADER = ROOT / "frog_blender" / "engine" / "native" / "src" / "frog_native.h"


@dataclass(frozen=True)
class Target:
    """A platform as CMake, Zig and a wheel's tag name it, its library, and how that begins."""

    system: str
    processor: str
    triple: str
    tag: str
    library: str
    magic: bytes


_DLL, _DYLIB, _SO = "frog_native.dll", "libfrog_native.dylib", "libfrog_native.so"
_ELF, _MACH, _PE = b"\x7fELF", b"\xcf\xfa\xed\xfe", b"MZ"
TARGETS = {
    "windows-x64": Target("Windows", "AMD64", "x86_64-windows-gnu", "win_amd64", _DLL, _PE),
    "windows-arm64": Target("Windows", "ARM64", "aarch64-windows-gnu", "win_arm64", _DLL, _PE),
    "macos-arm64": Target("Darwin", "arm64", "aarch64-macos.11.0", "macosx_11_0_arm64", _DYLIB, _MACH),
    "macos-x64": Target("Darwin", "x86_64", "x86_64-macos.11.0", "macosx_11_0_x86_64", _DYLIB, _MACH),
    # The oldest glibc that Blender supports.
    "linux-x64": Target("Linux", "x86_64", "x86_64-linux-gnu.2.28", "manylinux_2_28_x86_64", _SO, _ELF),
    "linux-arm64": Target("Linux", "aarch64", "aarch64-linux-gnu.2.28", "manylinux_2_28_aarch64", _SO, _ELF),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("out", type=Path, help="a folder for the builds; the wheels go into its folder wheels")
    parser.add_argument("--targets", default=",".join(TARGETS), help="default: %(default)s")
    parser.add_argument("--wine", metavar="COMMAND", help="runs what is built for Windows x64")
    parser.add_argument("--qemu", metavar="COMMAND", help="runs what is built for Linux on ARM")
    options = parser.parse_args()
    names = options.targets.split(",")
    if unknown := [name for name in names if name not in TARGETS]:
        parser.error(f"--targets: found {', '.join(unknown)}, expected some of {', '.join(TARGETS)}")
    for command in filter(None, (options.wine, options.qemu)):
        if shutil.which(shlex.split(command)[0]) is None:
            parser.error(f"{command}: there is no such program here")
    for name in names:
        wheel = build(TARGETS[name], options.out.resolve() / name, options.out.resolve() / "wheels")
        check(wheel, TARGETS[name])
        print(f"{name}: {wheel} ({wheel.stat().st_size / 1e6:.1f} MB)", flush=True)
        if emulator := {"windows-x64": options.wine, "linux-arm64": options.qemu}.get(name):
            said = draw(shlex.split(emulator), wheel, TARGETS[name], options.out.resolve() / f"{name}-drawn")
            print(f"  {emulator.split()[0]}: {said}", flush=True)


def build(target: Target, folder: Path, wheels: Path) -> Path:
    """The wheel, in ``wheels``; built in ``folder``."""
    zig = Path(ziglang.__file__).with_name("zig")
    defines = {
        "CMAKE_SYSTEM_NAME": target.system,
        "CMAKE_SYSTEM_PROCESSOR": target.processor,
        "CMAKE_CXX_COMPILER": f"{zig};c++;-target;{target.triple}",
        "CMAKE_SHARED_LINKER_FLAGS": "-s",  # symbols alone are most of a library for Linux
    }
    command = [sys.executable, "-m", "pip", "wheel", "--no-build-isolation", "--no-deps", "--disable-pip-version-check"]
    command += ["--wheel-dir", str(wheels), "--config-settings", f"build-dir={folder}"]
    command += ["--config-settings", "install.strip=false"]  # this machine's knows its own alone
    for name, value in defines.items():
        command += ["--config-settings", f"cmake.define.{name}={value}"]
    environment = os.environ | {"_PYTHON_HOST_PLATFORM": target.tag, "CMAKE_GENERATOR": "Ninja"}
    for path in wheels.glob(f"*-{target.tag}.whl"):
        path.unlink()
    ended = subprocess.run([*command, str(PROJECT)], capture_output=True, text=True, env=environment)
    found = list(wheels.glob(f"*-{target.tag}.whl"))
    if ended.returncode or len(found) != 1:
        sys.exit(f"{target.triple}: {' '.join(command)}\n{ended.stdout}{ended.stderr}")
    return found[0]


def check(wheel: Path, target: Target) -> None:
    """Ends with a sentence where its library is none of that platform's, or lacks a function."""
    with zipfile.ZipFile(wheel) as archive:
        content = archive.read(f"frog_blender_native/{target.library}")
    if not content.startswith(target.magic):
        sys.exit(f"{wheel}: found {content[:4]!r}, expected a library for {target.triple}.")
    functions = set(re.findall(r"\bfrog_\w+(?=\()", HEADER.read_text(encoding="utf-8")))
    missing = sorted(name for name in functions if name.encode() not in content)
    if not functions or missing:
        sys.exit(f"{wheel}: found no {', '.join(missing)}.")


def draw(emulator: list[str], wheel: Path, target: Target, folder: Path) -> str:
    """What the little program said that draws with the wheel's library; ends with a sentence where it failed."""
    folder.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(wheel) as archive:
        (folder / target.library).write_bytes(archive.read(f"frog_blender_native/{target.library}"))
    compiler = [sys.executable, "-m", "ziglang", "c++", "-target", target.triple, "-std=c++17", f"-I{HEADER.parent}"]
    command = [*compiler, str(ROOT / "tests" / "native" / "draw_one.cpp"), "-o", str(folder / "draw_one.exe")]
    for words in (command, [*emulator, "./draw_one.exe", f"./{target.library}"]):
        ended = subprocess.run(words, capture_output=True, text=True, cwd=folder, timeout=600)
        if ended.returncode:
            sys.exit(f"{' '.join(words)}\n{ended.stdout}{ended.stderr}")
    return ended.stdout.strip()


if __name__ == "__main__":
    main()
