"""Everything there is to check and measure on a machine with an NVIDIA GPU, in one command from a checkout:

    PYTHONPATH=. python benchmarks/gpu.py [--capture DIR] --out OUT [--build]

It needs torch with CUDA and numpy; what needs more (pytest, OpenCV, PyAV, safetensors, gsplat, the native library) is
left out with a word where that is missing. ``--build`` builds the native library first, with CMake.
Every part runs in a process of its own: where one fails, the others go on, and the exit status is 1.
OUT/gpu.json holds the figures, OUT/gpu.md the same as tables, OUT/*.log what the parts said.
``--device cpu`` is a rehearsal without a GPU: sizes are tiny, and its figures mean nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS = ROOT / "benchmarks"
GPU_TESTS = "tests/cuda/test_on_gpu.py"
CPU_COMPARISON = f"{GPU_TESTS}::test_a_large_image_and_many_gaussians_agree_with_the_cpu"
LIMIT_SECONDS = 3600  # of one part
TRAINING = """
import json, sys
from frog_blender import engine
found = engine.train(sys.argv[1], sys.argv[2], **json.loads(sys.argv[3]))
print(json.dumps({"psnr": found.psnr, "gaussians": found.num_gaussians, "train_seconds": found.seconds}))
"""


class LeftOut(Exception):
    """Why a part, or some of it, cannot be done here: no failure."""


class Failed(Exception):
    """What went wrong in a part; ``result`` is what it found before."""

    def __init__(self, reason: str, result: dict[str, Any] | None = None) -> None:
        super().__init__(reason)
        self.result = result or {}


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


def attempt(part: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The part's figures, with its time; "failed" or "left out" say why it is not whole."""
    started = time.monotonic()
    try:
        result = part()
    except LeftOut as error:
        result = {"left out": str(error)}
    except Failed as error:
        result = {**error.result, "failed": str(error)}
    except Exception as error:
        result = {"failed": f"{type(error).__name__}: {error}"}
    return {**result, "seconds": round(time.monotonic() - started, 1)}


def report(results: dict[str, dict[str, Any]]) -> str:
    """Markdown: a heading a part, its plain figures as a list, its runs as a table."""
    lines = []
    for name, result in results.items():
        lines += [f"## {name}", ""]
        lines += [f"- {key}: {_text(value)}" for key, value in result.items() if key != "runs"]
        runs = result.get("runs") or []
        keys = list(dict.fromkeys(key for run in runs for key in run))
        if runs:
            lines += ["", f"| {' | '.join(keys)} |", f"|{'---|' * len(keys)}"]
            lines += [f"| {' | '.join(_text(run.get(key)) for key in keys)} |" for run in runs]
        lines.append("")
    return "\n".join(lines)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    return "" if value is None else " ".join(str(value).split())


class Check:
    """The parts, for one set of options. Each returns its figures as plain values."""

    def __init__(self, options: argparse.Namespace) -> None:
        self.options = options
        self.rehearsal = options.device == "cpu"
        self.environment = dict(os.environ)
        paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
        self.environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
        self.native = ""  # why there is no native library

    def start(self, name: str, arguments: list[str], statuses: tuple[int, ...] = (0,)) -> str:
        """The standard output of another interpreter, kept in a log; Failed with its last line when it fails."""
        try:
            done = subprocess.run(
                [sys.executable, *arguments],
                capture_output=True,
                text=True,
                cwd=ROOT,
                env=self.environment,
                timeout=LIMIT_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise Failed(f"not ready after {LIMIT_SECONDS} s") from error
        self._log(name).write_text(f"{done.stdout}\n{done.stderr}", encoding="utf-8")
        if done.returncode not in statuses:
            raise Failed(f"{self.last_word(name)} (status {done.returncode})")
        return done.stdout

    def _log(self, name: str) -> Path:
        return self.options.out / f"{name}.log"

    def last_word(self, name: str) -> str:
        """The last line of a part's log, and where to read on."""
        said = self._log(name).read_text(encoding="utf-8").strip().splitlines()
        return f"{said[-1] if said else 'it said nothing'}; see {self._log(name)}"

    def machine(self) -> dict[str, Any]:
        """What this is; raises Failed where torch sees no GPU."""
        import numpy
        import torch

        found: dict[str, Any] = {
            "python": platform.python_version(),
            "torch": torch.__version__,
            "numpy": numpy.__version__,
            "cuda": torch.version.cuda,
        }
        asked = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
        if shutil.which("nvidia-smi"):
            done = subprocess.run(asked, capture_output=True, text=True, check=False)
            found["driver"] = done.stdout.strip() or done.stderr.strip()
        if torch.cuda.is_available():
            properties = torch.cuda.get_device_properties(0)
            found["device"] = properties.name
            found["capability"] = f"{properties.major}.{properties.minor}"
            found["memory_gb"] = round(properties.total_memory / 1e9, 1)
        found["missing"] = self.missing("pytest", "cv2", "av", "safetensors", "gsplat", "tqdm") or "nothing"
        ask = "from frog_blender.engine.native import binding; print(binding.instruction_set())"
        try:
            found["native library"] = self.start("native", ["-c", ask]).strip()
        except Failed as error:
            self.native = str(error)
            found["native library"] = "none (--build makes it)"
        if not torch.cuda.is_available() and not self.rehearsal:
            raise Failed("torch sees no CUDA device", found)
        return found

    def kernels(self) -> dict[str, Any]:
        """The CUDA rasterizer's tests on the device."""
        if missing := self.missing("pytest", "safetensors"):
            raise LeftOut(f"{missing} is not installed")
        arguments = ["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", GPU_TESTS]
        if self.native:
            arguments += ["--deselect", CPU_COMPARISON]
        said = self.start("kernels", arguments).strip().splitlines()
        result = {"tests": said[-1] if said else ""}
        if self.native:
            result["left out"] = "the comparison with the CPU, which needs the native library"
        if "skipped" in result["tests"] and "passed" not in result["tests"] and not self.rehearsal:
            reasons = [line for line in said if line.startswith("SKIPPED")]
            raise Failed(f"every test was skipped: {reasons[-1] if reasons else ''}", result)
        return result

    def rasterizer(self) -> dict[str, Any]:
        """Forward and backward on generated scenes, ours and gsplat's."""
        backends = ["cpu"] if self.rehearsal else ["cuda", *self.gsplat_backends()]
        scenes = ["tiny"] if self.rehearsal else ["100k_b", "1M_b"]
        arguments = [str(BENCHMARKS / "rasterizer.py"), "--json", "--scene", *scenes, "--backend", *backends]
        said = self.start("rasterizer", arguments, statuses=(0, 1))
        records = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
        keys = ("scene", "backend", "forward_s", "backward_s", "peak_device_mb", "pairs")
        result = {"runs": [{key: record.get(key) for key in keys} for record in records]}
        if len(records) < len(scenes) * len(backends):
            ended = f"{len(records)} of {len(scenes) * len(backends)} runs came to their end"
            raise Failed(f"{ended}: {self.last_word('rasterizer')}", result)
        return result

    def steps(self) -> dict[str, Any]:
        """Whole training steps, with our rasterizer and with gsplat's."""
        arguments = [str(BENCHMARKS / "gpu_step.py"), "--device", self.options.device]
        arguments += ["--rasterizers", "ours", *self.gsplat_backends()]
        result: dict[str, Any] = {"learned": "a generated scene"}
        if self.options.capture and not (missing := self.missing("cv2", "av")):
            arguments += ["--capture", str(self.options.capture)]
            result["learned"] = str(self.options.capture)
        elif self.options.capture:
            result["left out"] = f"the capture: {missing} is not installed"
        if self.rehearsal:
            arguments += ["--counts", "500", "--steps", "2", "--scene", "tiny", "--scale", "0.25"]
        said = self.start("steps", arguments, statuses=(0, 1))
        result["runs"] = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
        failed = [run["failed"] for run in result["runs"] if "failed" in run]
        if failed or not result["runs"]:
            raise Failed(failed[0] if failed else self.last_word("steps"), result)
        return result

    def training(self) -> dict[str, Any]:
        """The draft recipe on the capture, from decoding to its PSNR (of at most 30 images)."""
        if not self.options.capture:
            raise LeftOut("there is no --capture")
        if missing := self.missing("cv2", "av", "safetensors"):
            raise LeftOut(f"{missing} is not installed")
        chosen = {"recipe": "draft", "device": self.options.device, "overwrite": True}
        chosen |= {"steps": 5, "scale": 0.25} if self.rehearsal else {}
        folders = [str(self.options.capture), str(self.options.out / "draft.frog")]
        said = self.start("training", ["-c", TRAINING, *folders, json.dumps(chosen)])
        return {**chosen, **json.loads(said.splitlines()[-1])}

    @staticmethod
    def missing(*packages: str) -> str:
        """Those that are not installed, in a list for people; empty where none is missing."""
        return ", ".join(name for name in packages if find_spec(name) is None)

    @staticmethod
    def gsplat_backends() -> list[str]:
        """What to add to a list of backends where gsplat is installed."""
        return [] if find_spec("gsplat") is None else ["gsplat"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--capture", type=Path, help="a capture's folder")
    parser.add_argument("--out", type=Path, required=True, help="folder for figures and logs")
    parser.add_argument("--build", action="store_true", help="build the native library first")
    parser.add_argument("--device", choices=["cuda", "cpu"], default="cuda", help="cpu: a rehearsal")
    options = parser.parse_args()
    options.out = options.out.resolve()
    options.out.mkdir(parents=True, exist_ok=True)
    options.capture = options.capture.resolve() if options.capture else None
    check = Check(options)
    parts: dict[str, Callable[[], dict[str, Any]]] = {}
    if options.build:

        def built() -> dict[str, Any]:
            check.environment["FROG_NATIVE_LIBRARY"] = str(build(ROOT / "build" / "gpu"))
            return {"library": check.environment["FROG_NATIVE_LIBRARY"]}

        parts["native library"] = built
    parts |= {"machine": check.machine, "rasterizer tests": check.kernels, "rasterizer": check.rasterizer}
    parts |= {"training step": check.steps, "draft training": check.training}
    results: dict[str, dict[str, Any]] = {}
    for name, part in parts.items():
        print(f"{name} ...", file=sys.stderr, flush=True)
        results[name] = attempt(part)
        print(report({name: results[name]}), flush=True)
        (options.out / "gpu.json").write_text(json.dumps(results, indent=1), encoding="utf-8")
        (options.out / "gpu.md").write_text(report(results), encoding="utf-8")
        if name == "machine" and "failed" in results[name]:
            break
    if not check.gsplat_backends():
        print("gsplat is not installed: its half of the comparison is left out.")
    failed = [name for name, result in results.items() if "failed" in result]
    print(f"Failed: {', '.join(failed)}." if failed else "Nothing failed.")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
