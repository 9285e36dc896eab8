"""The native library without an installation, by CMake and a C++ compiler (for ``gpu.py --build``)."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from gpu_report import Failed

ROOT = Path(__file__).resolve().parents[1]


def build(folder: Path) -> Path:
    """Builds the native library into ``folder`` and returns its path; Failed without CMake or where it fails."""
    if shutil.which("cmake") is None:
        raise Failed("there is no CMake")
    folder.mkdir(parents=True, exist_ok=True)
    configure = ["cmake", "-S", str(ROOT), "-B", str(folder), "-DCMAKE_BUILD_TYPE=Release"]
    for command in (configure, ["cmake", "--build", str(folder)]):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise Failed(f"{' '.join(command[:3])} ...: {(done.stderr or done.stdout).strip()[-500:]}")
    return folder / "libfrog_native.so"
