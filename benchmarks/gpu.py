"""Everything there is to check and measure on a machine with an NVIDIA GPU, in one command of eight minutes at most:

    PYTHONPATH=. python benchmarks/gpu.py --out OUT --build [--capture DIR] [--only PART ...] [--seconds N]

It needs torch with CUDA and numpy, and no network; what needs more (pytest, OpenCV, PyAV, safetensors, gsplat, CMake,
compute-sanitizer, the native library) is left out with a word where that is missing. ``--build`` builds the native
library first. Without ``--capture`` that is the room of the examples.

Parts come in the order of their worth. Each has seconds of its own and those that the parts before it left; what is
still running then is ended, and what it said until then counts. Each runs in processes of its own: where one fails, the
others go on, and the exit status is 1. ``--only`` names some, ``--list`` lists them.

OUT/gpu.json holds the figures, OUT/gpu.md the same as tables, with what was asked and what was found on top; both are
written after every part. OUT/gpu.log is what the processes said. ``--device cpu`` is a rehearsal without a GPU: sizes
are tiny, and its figures mean nothing.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS = ROOT / "benchmarks"
ROOM = ROOT / "examples" / "captures" / "room"
GPU_TESTS = "tests/cuda/test_on_gpu.py"
CPU_COMPARISON = f"{GPU_TESTS}::test_a_large_image_and_many_gaussians_agree_with_the_cpu"
CHECKED_TESTS = "automatic or giants or pose or after_the_backward"  # by compute-sanitizer
TOTAL_SECONDS = 480.0
REHEARSAL_SECONDS = 3600.0
LEAST_SECONDS = 8.0  # with fewer a part is not begun: torch alone takes as long to load
SEEDS = (0, 1, 2)
COMPARED_STEPS = 1000

Figures = dict[str, Any]

MACHINE = """
import json, platform, subprocess, shutil, numpy, torch
found = {"python": platform.python_version(), "torch": torch.__version__, "numpy": numpy.__version__}
found["cuda"] = torch.version.cuda
if shutil.which("nvidia-smi"):
    asked = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    done = subprocess.run(asked, capture_output=True, text=True)
    found["driver"] = done.stdout.strip() or done.stderr.strip()
if torch.cuda.is_available():
    properties = torch.cuda.get_device_properties(0)
    found["device"], found["capability"] = properties.name, f"{properties.major}.{properties.minor}"
    found["memory_gb"] = round(properties.total_memory / 1e9, 1)
print(json.dumps(found))
"""
NATIVE = "from frog_blender.engine.native import binding; print(binding.instruction_set())"
GSPLAT = """
import importlib.util, pathlib
from torch.utils.cpp_extension import _get_build_directory
compiled = list(pathlib.Path(_get_build_directory("gsplat_cuda", False)).glob("*.so"))
print("ready" if compiled or importlib.util.find_spec("gsplat.csrc") else "not compiled")
"""


class LeftOut(Exception):
    """Why a part, or some of it, cannot be done here: no failure."""


class Failed(Exception):
    """What went wrong in a part; ``result`` is what it found before."""

    def __init__(self, reason: str, result: Figures | None = None) -> None:
        super().__init__(reason)
        self.result = result or {}


@dataclass
class Run:
    """A process that has ended.

    Attributes:
        said: its standard output.
        failed: why it is not whole; "" where it is.
    """

    said: str
    failed: str

    @property
    def records(self) -> list[Figures]:
        """The lines that are JSON objects."""
        return [json.loads(line) for line in self.said.splitlines() if line.startswith("{") and line.endswith("}")]


def attempt(part: Callable[[], Figures]) -> Figures:
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


def report(results: dict[str, Figures]) -> str:
    """Markdown: a heading a part, its plain figures as a list, its lists of records as tables."""
    lines = []
    for name, result in results.items():
        tables = {key: value for key, value in result.items() if isinstance(value, list) and value}
        lines += [f"## {name}", ""]
        lines += [f"- {key}: {_text(value)}" for key, value in result.items() if not isinstance(value, list)]
        for key, rows in tables.items():
            lines += ["", *([] if key == "runs" else [f"{key}:", ""]), *table(rows)]
        lines.append("")
    return "\n".join(lines)


def table(rows: list[Figures]) -> list[str]:
    """Lines of Markdown, with a column for every key."""
    keys = list(dict.fromkeys(key for row in rows for key in row))
    lines = [f"| {' | '.join(keys)} |", f"|{'---|' * len(keys)}"]
    return lines + [f"| {' | '.join(_text(row.get(key)) for key in keys)} |" for row in rows]


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_text(one)}" for key, one in value.items())
    return "" if value is None else " ".join(str(value).split()).replace("|", "/")


NOT_MEASURED = "not measured"


def asked_and_found(results: dict[str, Figures]) -> list[Figures]:
    """A row for everything that is asked of the GPU: what was asked, what was found, and whether that is enough."""
    rows: list[Figures] = []

    def add(what: str, asked: str, found: float | None, enough: Callable[[float], bool] | None, unit: str = "") -> None:
        text = NOT_MEASURED if found is None else f"{found:.4g}{unit}"
        met = "" if found is None or enough is None else "yes" if enough(found) else "NO"
        rows.append({"what": what, "asked": asked, "found": text, "met": met})

    tests = results.get("gpu tests", {})
    add(
        "GPU tests that fail or do not end",
        "0",
        None if "passed" not in tests else tests["not passed"],
        lambda n: n == 0,
    )
    for row in results.get("rasterizer", {}).get("ratios") or [{"scene": "100k_b"}, {"scene": "1M_b"}]:
        for name in ("forward", "backward"):
            add(f"gsplat's {name} over ours, {row['scene']}", ">= 1.5", row.get(name), lambda ratio: ratio >= 1.5)
        add(f"our memory over gsplat's, {row['scene']}", "<= 1", row.get("memory"), lambda ratio: ratio <= 1)
    for row in results.get("steps", {}).get("ratios") or [{"gaussians": "all", "images": "regions"}]:
        for name in ("before", "gsplat"):
            where = f"{row['gaussians']} Gaussians, {row['images']}"
            add(f"step of {name} over ours, {where}", "the more the better", row.get(name), None)
    profiles = results.get("profile", {}).get("runs", [])
    ours = [run for run in profiles if run.get("way") == "ours" and run.get("kernels")]
    for run in ours or [{"gaussians": "all"}]:
        where = f"{run['gaussians']} Gaussians"
        launches = sum(run[name] for name in ("kernels", "copies", "fills")) if ours else None
        add(f"launches a step with copies and fills, {where}", "<= 30", launches, lambda count: count <= 30)
        add(f"waits a step that idle the GPU, {where}", "0", run.get("waits_that_idle"), lambda count: count == 0)
        add(f"share of a step that the GPU is busy, {where}", "the more the better", run.get("busy_share"), None)
    room = results.get("draft", {})
    add("draft of the capture, whole", "<= 8 s", room.get("total_s"), lambda spent: spent <= 8, " s")
    add("draft's quality", "as on a CPU", room.get("psnr"), None, " dB")
    long = results.get("take", {})
    where = f", {long['take']}" if "take" in long else ""
    expected = long.get("recipe_would_take_s")
    add(f"standard's own steps, extrapolated{where}", "<= 180 s", expected, lambda spent: spent <= 180, " s")
    add(
        f"its quality after {_text(long.get('trained_s')) or 60} s", "as after all steps", long.get("psnr"), None, " dB"
    )
    both = results.get("cpu and gpu", {})
    noise = both.get("seeds_differ_db", 0.3)
    difference = both.get("difference_db")
    add("GPU's quality less the CPU's", f"within {noise:.2g} dB", difference, lambda one: abs(one) <= noise, " dB")
    checked = results.get("memory check", {}).get("errors")
    add("errors that compute-sanitizer finds", "0", checked, lambda count: count == 0)
    return rows


def ratios(runs: list[Figures], same: tuple[str, ...], by: str, figures: dict[str, str]) -> list[Figures]:
    """For every scene or size: each figure of each other way over ours.

    Args:
        same: keys whose values are those of one scene or size.
        by: the key that tells the ways apart.
        figures: by name in the result, the key of what is divided.
    """
    found: list[Figures] = []
    ours = [run for run in runs if run.get(by) in ("ours", "cuda")]
    for own in ours:
        for other in runs:
            if other is own or any(other.get(key) != own.get(key) for key in same):
                continue
            pairs = {name: (other.get(key), own.get(key)) for name, key in figures.items()}
            values = {name: round(a / b, 3) for name, (a, b) in pairs.items() if a and b}
            found.append({**{key: own[key] for key in same}, "over ours": other[by], **values})
    return found


class Check:
    """The parts, for one set of options. Each returns its figures as plain values.

    Attributes:
        deadline: when the running part has to end, on the monotonic clock.
    """

    def __init__(self, options: argparse.Namespace, work: Path) -> None:
        self.options, self.work = options, work
        self.rehearsal = options.device == "cpu"
        self.capture: Path = options.capture or ROOM
        self.environment = dict(os.environ)
        paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
        self.environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
        self.cache, self.draft_cache = work / "cache", work / "draft-cache"
        self.environment["FROG_CACHE"] = str(self.cache)
        self.native = ""  # why there is no native library
        self.gsplat = "gsplat was not looked for"
        self.deadline = 0.0
        self._log = options.out / "gpu.log"
        self._log.write_text("", encoding="utf-8")

    @property
    def left(self) -> float:
        """Seconds of the running part."""
        return self.deadline - time.monotonic()

    def run_together(self, commands: Iterable[list[str]], **environment: str) -> list[Run]:
        """Runs commands side by side until all have ended or the part's time is over; what they start ends with them.

        What was said until then is kept either way, here and in the log.
        """
        started: list[tuple[list[str], subprocess.Popen[bytes], list[Path]]] = []
        try:
            for number, command in enumerate(commands):
                files = [self.work / f"{number}.{name}" for name in ("out", "err")]
                with files[0].open("wb") as out, files[1].open("wb") as err:
                    own = self.environment | environment
                    process = subprocess.Popen(
                        command, stdout=out, stderr=err, cwd=ROOT, env=own, start_new_session=True
                    )
                started.append((command, process, files))
            return [self._ended(*one) for one in started]
        finally:
            for _, process, _ in started:
                kill_group(process)

    def _ended(self, command: list[str], process: subprocess.Popen[bytes], files: list[Path]) -> Run:
        """What a process came to, once it or the part's time is over."""
        failed = ""
        try:
            process.wait(max(0.1, self.left))
        except subprocess.TimeoutExpired:
            failed = "its time was over"
            kill_group(process)
        said, complained = (file.read_text(encoding="utf-8", errors="replace") for file in files)
        with self._log.open("a", encoding="utf-8") as log:
            log.write(f"$ {' '.join(command)[:300]}\n{said}\n{complained}\n[status {process.returncode}] {failed}\n\n")
        if process.returncode and not failed:
            last = (complained.strip() or said.strip() or "it said nothing").splitlines()[-1]
            failed = f"{last} (status {process.returncode}); see {self._log}"
        return Run(said, failed)

    def run_python(self, *arguments: str, **environment: str) -> Run:
        """One interpreter; see ``run_together``."""
        return self.run_together([[sys.executable, *arguments]], **environment)[0]

    def benchmark(self, name: str, *arguments: object, **environment: str) -> Run:
        """One of the benchmarks beside this one."""
        return self.run_python(str(BENCHMARKS / name), *map(str, arguments), **environment)

    # Parts -----------------------------------------------------------------------------------------------------------

    def native_library(self) -> Figures:
        """Built with CMake into build/gpu, with ``--build``; else what there is."""
        if self.options.build:
            if shutil.which("cmake") is None:
                raise Failed("there is no CMake")
            folder = ROOT / "build" / "gpu"
            folder.mkdir(parents=True, exist_ok=True)
            configure = ["cmake", "-S", str(ROOT), "-B", str(folder), "-DCMAKE_BUILD_TYPE=Release"]
            for command in (configure, ["cmake", "--build", str(folder), "--parallel", str(os.cpu_count() or 1)]):
                if (built := self.run_together([command])[0]).failed:
                    raise Failed(built.failed)
            self.environment["FROG_NATIVE_LIBRARY"] = str(folder / "libfrog_native.so")
        found = self.run_python("-c", NATIVE)
        if found.failed:
            self.native = found.failed
            raise LeftOut(f"there is none (--build makes it): {found.failed}")
        return {"instruction set": found.said.strip()}

    def machine(self) -> Figures:
        """What this is; Failed where torch sees no GPU."""
        run = self.run_python("-c", MACHINE)
        if run.failed:
            raise Failed(run.failed)
        found = run.records[-1]
        found["cores"] = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        packages = ("pytest", "hypothesis", "cv2", "av", "safetensors", "gsplat", "tqdm")
        found["missing"] = missing(*packages) or "nothing"
        found["compute-sanitizer"] = str(sanitizer() or "none")
        if missing("gsplat"):
            self.gsplat = "gsplat is not installed"
        elif not self.rehearsal:  # one that is to be compiled at first use would take minutes of every part
            asked = self.run_python("-c", GSPLAT)
            ready = asked.said.strip() == "ready"
            self.gsplat = "" if ready else f"gsplat is not ready: {asked.failed or asked.said.strip()}"
        found["gsplat"] = self.gsplat or "ready"
        if "device" not in found and not self.rehearsal:
            raise Failed("torch sees no CUDA device", found)
        return found

    def gpu_tests(self) -> Figures:
        """All tests in tests/cuda that want a GPU."""
        if lacking := missing("pytest", "safetensors"):
            raise LeftOut(f"{lacking} is not installed")
        names = [str(path.relative_to(ROOT)) for path in sorted((ROOT / "tests" / "cuda").glob("test_*on_gpu.py"))]
        arguments = ["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", *names]
        if self.native:
            arguments += ["--deselect", CPU_COMPARISON]
        run = self.run_python(*arguments)
        said = run.said.strip().splitlines()
        counted = counts_of(said[-1]) if said else {}
        result: Figures = {"files": ", ".join(names), "said": said[-1] if said else ""}
        if "passed" in counted:
            result |= {"passed": counted["passed"], "not passed": counted.get("failed", 0) + counted.get("error", 0)}
        if self.native:
            result["left out"] = "the comparison with the CPU, which needs the native library"
        if run.failed:
            raise Failed(run.failed, result)
        if "passed" not in counted and not self.rehearsal:
            reasons = [line for line in said if line.startswith("SKIPPED")]
            raise Failed(f"every test was skipped: {reasons[-1] if reasons else ''}", result)
        return result

    def rasterizer(self) -> Figures:
        """Forward, backward and memory on generated scenes, ours and gsplat's."""
        backends = ["cpu"] if self.rehearsal else ["cuda", *self._gsplat()]
        scenes = ["tiny"] if self.rehearsal else ["100k_b", "1M_b"]
        run = self.benchmark("rasterizer.py", "--json", "--scene", *scenes, "--backend", *backends)
        keys = ("scene", "backend", "forward_s", "backward_s", "peak_device_mb", "pairs")
        runs = [{key: record.get(key) for key in keys} for record in run.records]
        divided = {"forward": "forward_s", "backward": "backward_s", "gsplat memory": "peak_device_mb"}
        found = ratios(runs, ("scene",), "backend", divided)
        for row in found:
            if memory := row.pop("gsplat memory", None):
                row["memory"] = round(1 / memory, 3)
        result = {"runs": runs, "ratios": found, **self._without_gsplat()}
        if run.failed:
            raise Failed(run.failed, result)
        return result

    def steps(self) -> Figures:
        """Whole training steps: ours, of torch's own operations, and those with gsplat's rasterizer."""
        run = self.benchmark("gpu_step.py", *self._material(), "--ways", "ours", "before", *self._gsplat())
        result = {"learned": self._learned(), **self._without_gsplat(), "runs": run.records}
        found: dict[tuple[int, str], Figures] = {}
        for row in ratios(run.records, ("gaussians", "images"), "way", {"ratio": "back_to_back_ms"}):
            key = row["gaussians"], row["images"]
            own = found.setdefault(key, {"gaussians": row["gaussians"], "images": row["images"]})
            own[row["over ours"]] = row.get("ratio")
        result["ratios"] = list(found.values())
        return self._whole(run, result)

    def profile(self) -> Figures:
        """Kernels, launches and waits of a usual step."""
        run = self.benchmark("gpu_profile.py", *self._material("20000", "300000"), "--ways", "ours", "before")
        result: Figures = {"learned": self._learned(), "runs": []}
        for record in run.records:
            kernels = record.pop("kernels_by_name", [])
            calls = record.pop("waits_by_call", {})
            result["runs"].append(record | {"waits by call": _text(calls)})
            result[f"kernels of {record['way']}, {record['gaussians']} Gaussians"] = kernels
        return self._whole(run, result)

    def draft(self) -> Figures:
        """The draft recipe on the capture, from opening it to the file, by phases; with an empty cache but for the
        kernels, which are compiled once on every machine."""
        self._needs_capture()
        if (kernels := self.cache / "kernels").is_dir():
            shutil.copytree(kernels, self.draft_cache / "kernels")
        sizes = ["--steps", 3, *self._smaller()] if self.rehearsal else []
        where = ["--work", self.work, "--device", self.options.device]
        run = self.benchmark("gpu_training.py", "draft", self.capture, *where, *sizes, FROG_CACHE=str(self.draft_cache))
        return self._whole(run, {"capture": str(self.capture), **(run.records or [{}])[-1]})

    def take(self) -> Figures:
        """A drawn take of 20 x 300 images, trained for a minute."""
        if lacking := missing("cv2"):
            raise LeftOut(f"{lacking} is not installed")
        sizes = ["--cameras", "3", "--frames", "3", "--seconds", "1", "--scene", "tiny"] if self.rehearsal else []
        run = self.benchmark("gpu_training.py", "take", "--device", self.options.device, *sizes)
        records = run.records
        last = records.pop() if records and "take" in records[-1] else {}
        return self._whole(run, {**last, "runs": records})

    def both_devices(self) -> Figures:
        """The same short draft on CPU and GPU, all side by side: quality alone is compared, so speed may suffer."""
        self._needs_capture()
        seeds = SEEDS[:1] if self.rehearsal else SEEDS
        steps = 3 if self.rehearsal else COMPARED_STEPS
        threads = max(1, ((os.cpu_count() or 1) - len(seeds)) // len(seeds))
        commands = []
        for seed in seeds:
            for device in dict.fromkeys((self.options.device, "cpu")):
                sizes: list[object] = ["--device", device, "--seed", seed, "--steps", steps, "--threads", threads]
                sizes += self._smaller() if self.rehearsal else []
                script = [sys.executable, str(BENCHMARKS / "gpu_training.py"), "seed", str(self.capture)]
                commands.append([*script, "--work", str(self.work), *map(str, sizes)])
        runs = self.run_together(commands, FROG_CACHE=str(self.draft_cache))
        records = [record for run in runs for record in run.records]
        result = {**compared(records), "runs": records}
        failed = next((run.failed for run in runs if run.failed), "")
        if failed:
            raise Failed(failed, result)
        return result

    def memory_check(self) -> Figures:
        """A few GPU tests under compute-sanitizer."""
        program = sanitizer()
        if program is None:
            raise LeftOut("compute-sanitizer was not found")
        if self.rehearsal:
            raise LeftOut("there is no GPU to check")
        command = [str(program), "--tool", "memcheck", "--error-exitcode", "9", sys.executable, "-m", "pytest", "-q"]
        command += ["-p", "no:cacheprovider", "-k", CHECKED_TESTS, GPU_TESTS]
        # Torch's own pool would hide what lies beside an allocation.
        run = self.run_together([command], PYTORCH_NO_CUDA_MEMORY_CACHING="1")[0]
        lines = run.said.splitlines()
        found = [line.split("ERROR SUMMARY:")[1].split() for line in lines if "ERROR SUMMARY:" in line]
        tests = next((line for line in reversed(lines) if " passed" in line or " failed" in line), "")
        result: Figures = {"tests": CHECKED_TESTS, "said": tests}
        if found:
            result["errors"] = sum(int(words[0]) for words in found)
        if run.failed:
            raise Failed(run.failed, result)
        return result

    def _material(self, *counts: str) -> list[object]:
        """Arguments of the benchmarks of steps: what is learned, and of how many Gaussians."""
        arguments: list[object] = ["--device", self.options.device]
        if self.rehearsal:
            return [*arguments, "--counts", "500", "--steps", "2", "--scene", "tiny"]
        arguments += ["--counts", *counts] if counts else ["--steps", "60"]
        return arguments if missing("cv2", "av") else [*arguments, "--capture", self.capture]

    def _learned(self) -> str:
        return "a generated scene" if self.rehearsal or missing("cv2", "av") else str(self.capture)

    def _needs_capture(self) -> None:
        if lacking := missing("cv2", "av", "safetensors"):
            raise LeftOut(f"{lacking} is not installed")

    def _smaller(self) -> list[object]:
        """For a rehearsal; a capture that is named is taken as it is."""
        return [] if self.options.capture else ["--scale", 0.25]

    def _gsplat(self) -> list[str]:
        return [] if self.gsplat else ["gsplat"]

    def _without_gsplat(self) -> Figures:
        return {"left out": self.gsplat} if self.gsplat else {}

    @staticmethod
    def _whole(run: Run, result: Figures) -> Figures:
        """The result; Failed with it where the run, or one of its records, is not whole."""
        records = run.records
        failed = next((record["failed"] for record in records if "failed" in record), run.failed)
        if failed or not records:
            raise Failed(failed or "it found nothing", result)
        return result


def kill_group(process: subprocess.Popen[bytes]) -> None:
    """Ends a process that leads a group, and what it started."""
    with contextlib.suppress(OSError):  # where they have ended
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def missing(*packages: str) -> str:
    """Those that are not installed, in a list for people; empty where none is missing."""
    return ", ".join(name for name in packages if find_spec(name) is None)


def sanitizer() -> Path | None:
    """compute-sanitizer on the path, in a CUDA toolkit or in a wheel."""
    if found := shutil.which("compute-sanitizer"):
        return Path(found)
    spec = find_spec("nvidia")
    wheels = [Path(place) for place in (spec.submodule_search_locations or [])] if spec else []
    toolkits = sorted(Path("/usr/local").glob("cuda*"), reverse=True)
    places = [*toolkits, Path("/opt/cuda"), *(folder for wheel in wheels for folder in wheel.glob("*"))]
    names = ("bin/compute-sanitizer", "compute-sanitizer/compute-sanitizer")
    return next((place / name for place in places for name in names if (place / name).is_file()), None)


def counts_of(line: str) -> dict[str, int]:
    """What pytest's last line counts: {"passed": 35} and the like."""
    words = line.replace(",", " ").replace("errors", "error").split()
    return {name: int(count) for count, name in pairwise(words) if count.isdecimal()}


def compared(records: list[Figures]) -> Figures:
    """What the seeds' records of two devices come to: mean PSNR of each, their difference, and how far seeds differ."""
    values: dict[str, dict[int, float]] = {}
    for record in records:
        values.setdefault(record["device"], {})[record["seed"]] = record["psnr"]
    result: Figures = {f"{device}_psnr": statistics.fmean(by_seed.values()) for device, by_seed in values.items()}
    both = sorted(values.get("cpu", {}).keys() & values.get("cuda", {}).keys())
    if both:
        result["difference_db"] = statistics.fmean(values["cuda"][seed] - values["cpu"][seed] for seed in both)
        result["seeds_compared"] = len(both)
    spreads = [max(by_seed.values()) - min(by_seed.values()) for by_seed in values.values() if len(by_seed) > 1]
    return result | ({"seeds_differ_db": max(spreads)} if spreads else {})


PARTS: dict[str, tuple[float, Callable[[Check], Figures]]] = {
    "machine": (20, Check.machine),
    "native library": (45, Check.native_library),
    "gpu tests": (60, Check.gpu_tests),
    "steps": (60, Check.steps),
    "profile": (40, Check.profile),
    "draft": (40, Check.draft),
    "rasterizer": (45, Check.rasterizer),
    "take": (115, Check.take),
    "cpu and gpu": (35, Check.both_devices),
    "memory check": (20, Check.memory_check),
}
"""In the order of their worth: seconds, besides those that the parts before left, and what does it."""


def write(results: dict[str, Figures], options: argparse.Namespace, seconds: float) -> None:
    """The figures so far."""
    rows = asked_and_found(results)
    kept = {"asked and found": rows, "seconds": round(seconds, 1), "parts": results}
    (options.out / "gpu.json").write_text(json.dumps(kept, indent=1), encoding="utf-8")
    title = "A rehearsal: its figures mean nothing" if options.device == "cpu" else "A GPU check"
    lines = [f"# {title}", "", *table(rows), "", f"{seconds:.0f} s in all.", "", report(results)]
    (options.out / "gpu.md").write_text("\n".join(lines), encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/gpu"), help="folder for figures and log")
    parser.add_argument("--capture", type=Path, help="a capture's folder")
    parser.add_argument("--build", action="store_true", help="build the native library first")
    parser.add_argument("--only", nargs="+", choices=PARTS, metavar="PART", help="these parts, and the machine's")
    parser.add_argument("--seconds", type=float, help=f"for everything: {TOTAL_SECONDS:.0f}, and more for a rehearsal")
    parser.add_argument("--list", action="store_true", help="list the parts and their seconds")
    parser.add_argument("--device", choices=["cuda", "cpu"], default="cuda", help="cpu: a rehearsal")
    options = parser.parse_args()
    if options.list:
        print("\n".join(f"{seconds:4.0f} s  {name}" for name, (seconds, _) in PARTS.items()))
        return 0
    options.out = options.out.resolve()
    options.out.mkdir(parents=True, exist_ok=True)
    options.capture = options.capture.resolve() if options.capture else None
    if options.seconds is None:  # computers that rehearse may be slow
        options.seconds = REHEARSAL_SECONDS if options.device == "cpu" else TOTAL_SECONDS
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what was started ends too
    began, due = time.monotonic(), 0.0
    results: dict[str, Figures] = {}
    with tempfile.TemporaryDirectory(prefix="frog-gpu-", ignore_cleanup_errors=True) as work:
        check = Check(options, Path(work))
        for name, (seconds, part) in PARTS.items():
            if options.only and name not in {"machine", "native library", *options.only}:
                continue
            due += seconds
            due_now = options.seconds if check.rehearsal else min(due, options.seconds)
            check.deadline = began + due_now
            print(f"{name} ({check.left:.0f} s) ...", file=sys.stderr, flush=True)
            if check.left < LEAST_SECONDS:
                results[name] = {"left out": f"the {options.seconds:.0f} seconds were over"}
            else:
                results[name] = attempt(lambda part=part: part(check))  # type: ignore[misc]
            write(results, options, time.monotonic() - began)
            print(report({name: results[name]}), flush=True)
            if name == "machine" and "failed" in results[name]:
                break
    print("\n".join(table(asked_and_found(results))))
    failed = [name for name, result in results.items() if "failed" in result]
    print(f"Failed: {', '.join(failed)}." if failed else "Nothing failed.", f"{time.monotonic() - began:.0f} s in all.")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
