"""Times the rasterizer: forward, backward and peak memory, for every backend, scene, thread count and instruction set.

    python benchmarks/rasterizer.py [--scene FILE.npz] [--backend cpu] [--threads N] [--isa NAME] [--json] [--out DIR]

Without arguments everything is measured that this machine can run: the generated scenes (``raster_scenes.py``), all
backends, all instruction sets, one thread and all cores (the sweep and the tiny scene: all cores only).
With ``--scene`` the rest defaults to one run: the CPU, all cores, the widest instruction set; "all" asks for more.
Seconds are medians of at least five runs after one that is not counted; the machine should be quiet.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import peak
import raster_report
import raster_scenes
from raster_run import BACKENDS

from frog_blender.engine.errors import FrogError, found_instead

INSTRUCTION_SETS = ("avx512", "avx2", "baseline")
WORKER = Path(__file__).with_name("raster_run.py")
ASK_INSTRUCTION_SET = "from frog_blender.engine.native import binding; print(binding.instruction_set())"


def start(arguments: list[str], isa: str | None = None) -> str:
    """The last line that another interpreter prints; FrogError with the last line of its errors when it fails."""
    environment = os.environ | ({"FROG_INSTRUCTION_SET": isa} if isa else {})
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        said = done.stderr.strip().splitlines()
        raise FrogError(said[-1] if said else f"the measuring process ended with status {done.returncode}.")
    return done.stdout.strip().splitlines()[-1]


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@functools.cache
def instruction_sets() -> list[str]:
    """Those this processor has, the widest first."""
    return [isa for isa in INSTRUCTION_SETS if start(["-c", ASK_INSTRUCTION_SET], isa) == isa]


def expanded_scenes(wanted: list[str] | None) -> list[str]:
    """Names of generated scenes and paths, groups resolved."""
    names = wanted or ["tiny", "standard", "sweep"]
    return [name for group in names for name in raster_scenes.GROUPS.get(group, (group,))]


@contextmanager
def as_file(name: str) -> Iterator[tuple[Path, int]]:
    """The scene as an .npz that a measuring process can open, and its number of Gaussians."""
    path = Path(name)
    if name in raster_scenes.RECIPES:
        scene = raster_scenes.generate(raster_scenes.RECIPES[name])
    elif path.suffix == ".npz":
        yield path, len(raster_scenes.load(path).gaussians)
        return
    else:
        expected = f"an .npz file or one of {', '.join([*raster_scenes.GROUPS, *raster_scenes.RECIPES])}"
        raise found_instead(name, "no scene of this name", expected)
    count = len(scene.gaussians)
    with tempfile.TemporaryDirectory(prefix="frog-benchmark-") as folder:
        path = Path(folder) / "scene.npz"
        raster_scenes.save(path, scene)
        del scene
        yield path, count


def plan(options: argparse.Namespace, scene: str) -> list[tuple[str, int, str | None]]:
    """(backend, threads, instruction set) of every run of a scene; the set is None off the CPU, or for the widest."""
    everything = options.scene is None
    threads = options.threads or (sorted({1, cores()}) if everything else [cores()])
    isas: list[Any] = options.isa or (["all"] if everything else [None])
    if "all" in isas:
        isas = instruction_sets() if "cpu" in options.backend else []
    if everything and scene not in raster_scenes.STANDARD:
        threads = [max(threads)]
    runs: list[tuple[str, int, str | None]] = []
    for backend in options.backend:
        if backend == "cpu":
            runs += [(backend, count, isa) for isa, count in product(isas, threads)]
        else:
            runs.append((backend, max(threads), None))
    return runs


def measure(path: Path, backend: str, threads: int, isa: str | None) -> dict[str, Any]:
    """The record of one run, without its scene's name."""
    result = json.loads(start([str(WORKER), str(path), backend, str(threads)], isa))
    if isa and result["isa"] != isa:
        raise FrogError(f"found the instruction set {result['isa']}, expected {isa}: this processor does not have it.")
    on_gpu = backend in ("cuda", "gsplat")
    return {"backend": backend, "threads": None if on_gpu else threads, **result}


def benchmark(options: argparse.Namespace) -> int:
    """Runs the plan and prints; 1 when a run failed, else 0 (the reference may decline what it was not asked for)."""
    if options.out and find_spec("matplotlib") is None:
        raise FrogError("the chart of --out needs matplotlib, which is not installed.")
    wanted = options.backend or (["all"] if options.scene is None else ["cpu"])
    named = [backend for backend in wanted if backend != "all"]
    absent = json.loads(start([str(WORKER), "--probe", *(BACKENDS if "all" in wanted else named)]))
    for backend in named:
        if absent[backend]:
            raise FrogError(f"the backend {backend} cannot run here: {absent[backend]}")
    options.backend = [backend for backend, why in absent.items() if why is None]
    skipped = {f"{backend}: {why}": ["every scene"] for backend, why in absent.items() if why}
    core = peak.measure()
    records: list[dict[str, Any]] = []
    failed = False
    for name in expanded_scenes(options.scene):
        with as_file(name) as (path, count):
            for backend, threads, isa in plan(options, name):
                try:
                    result = measure(path, backend, threads, isa)
                except FrogError as error:
                    skipped.setdefault(f"{backend}: {error}", []).append(name)
                    failed |= backend != "reference" or backend in named
                    continue
                scene = name if name in raster_scenes.RECIPES else Path(name).stem
                record = {"scene": scene, "gaussians_in_scene": count, **result}
                raster_report.add_rates(record, core.gflops if core else None)
                records.append(record)
                show_run(record, options.json)
    for reason, scenes in skipped.items():
        print(f"Left out: {', '.join(dict.fromkeys(scenes))}; {reason}", file=sys.stderr)
    if not options.json and records:
        print(raster_report.table(records))
        print("", *raster_report.remarks(records), machine(core), sep="\n")
    if options.out and records:
        write(records, core, options.out)
    return 1 if failed else 0


def show_run(record: dict[str, Any], as_json: bool) -> None:
    """One JSON object on the standard output, or a line of progress on the other."""
    if as_json:
        print(json.dumps(record), flush=True)
        return
    seconds = f"forward {record['forward_s']:.4f} s, backward {record['backward_s']:.4f} s"
    print(f"{record['scene']}, {raster_report.kernels(record)}, {record['threads']}: {seconds}", file=sys.stderr)


def machine(core: peak.Peak | None) -> str:
    """One sentence on what the shares are shares of."""
    if core is None:
        return "The peak of a core is unknown: no GCC or Clang here."
    return f"One core's peak: {core.gflops:.0f} GFLOP/s single precision (measured), at about {core.clock_ghz:.1f} GHz."


def write(records: list[dict[str, Any]], core: peak.Peak | None, folder: Path) -> None:
    """results.jsonl, table.md and chart.png."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "results.jsonl").write_text("".join(f"{json.dumps(record)}\n" for record in records))
        notes = [f"* {line}\n" for line in (*raster_report.remarks(records), machine(core))]
        (folder / "table.md").write_text(f"{raster_report.table(records)}\n\n{''.join(notes)}")
        raster_report.chart(records, folder / "chart.png")
    except OSError as error:
        raise FrogError(f"{folder}: the results could not be written ({error}).") from error


def positive(text: str) -> int:
    """A whole number above 0, for the parser."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"found {text!r}, expected a whole number above 0")
    return int(text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", nargs="+", metavar="NAME", help=".npz files, standard, sweep, 10k_s ...")
    parser.add_argument("--backend", nargs="+", choices=(*BACKENDS, "all"))
    parser.add_argument("--threads", nargs="+", type=positive)
    parser.add_argument("--isa", nargs="+", choices=(*INSTRUCTION_SETS, "all"))
    parser.add_argument("--json", action="store_true", help="print one JSON object a run and nothing else")
    parser.add_argument("--out", type=Path, help="folder for results.jsonl, table.md and chart.png")
    options = parser.parse_args()
    try:
        return benchmark(options)
    except FrogError as error:
        print(error, file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
