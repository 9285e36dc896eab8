"""The native library without an installation: with CMake, or with a C++ compiler alone (for ``gpu.py --build``)."""

from __future__ import annotations

import platform
import shutil
import subprocess
from pathlib import Path

from gpu_report import Failed

ROOT = Path(__file__).resolve().parents[1]


def build(folder: Path) -> Path:
    """Builds the native library into ``folder`` and returns its path; Failed when there is no way or it fails."""
    folder.mkdir(parents=True, exist_ok=True)
    library = folder / "libfrog_native.so"
    compiler = next((name for name in ("g++", "clang++", "c++") if shutil.which(name)), None)
    if compiler is None:
        raise Failed("there is no C++ compiler")
    if shutil.which("cmake"):
        commands = [
            ["cmake", "-S", str(ROOT), "-B", str(folder), "-DCMAKE_BUILD_TYPE=Release"],
            ["cmake", "--build", str(folder)],
        ]
    else:
        source = ROOT / "frog_blender/engine/native/src"
        flags = "-std=gnu++17 -O3 -fPIC -fvisibility=hidden -fno-math-errno -fno-trapping-math -ffp-contract=fast -w"
        common = [compiler, *flags.split()]
        names = ["api", "thread_pool", "frame", "binning", "backward", "deformation", "isa_baseline"]
        objects, commands = [], []
        if platform.machine() in ("x86_64", "AMD64"):
            common.append("-DFROG_X86=1")
            avx512 = "-mavx512f -mavx512dq -mavx512vl -mavx512bw -mfma -mprefer-vector-width=512"
            for name, extra in (("isa_avx2", "-mavx2 -mfma"), ("isa_avx512", avx512)):
                objects.append(str(folder / f"{name}.o"))
                commands.append([*common, *extra.split(), "-c", str(source / f"{name}.cpp"), "-o", objects[-1]])
        sources = [str(source / f"{name}.cpp") for name in names]
        commands.append([*common, "-shared", *sources, *objects, "-pthread", "-o", str(library)])
    for command in commands:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise Failed(f"{' '.join(command[:3])} ...: {(done.stderr or done.stdout).strip()[-500:]}")
    return library
