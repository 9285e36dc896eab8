"""Invented results, as ``frog chart`` would have written them."""

from typing import Any

from frog_blender.engine.registry import METHODS
from frog_blender.research.grid import Run
from frog_blender.research.results import Record
from frog_blender.research.runs import identity

_MADE_ON = {
    "machine": {"cpu": "Abacus", "cores": 2, "instruction_set": "avx2", "gpu": None},
    "versions": {"project": "0.1.0", "python": "3.11.0", "torch": "2.7.0", "numpy": "2.0.0"},
    "code": {"version": "0.1.0", "commit": "0123456789" * 4 + "+", "hash": "abcdef0123456789"},
    "finished_at": "2026-01-01T00:00:00Z",
}


def run_record(method: str = "frog", seed: int = 0, scene: str = "room", **changes: Any) -> Record:
    """A finished run of 30 dB."""
    label, group = changes.get("label", METHODS[method].title), changes.get("group", "methods")
    run = Run(scene, method=method, label=label, seed=seed, group=group, equal_time=group == "time")
    psnr = changes.get("psnr", 30.0)
    quality = {"psnr": psnr, "psnr_moving": psnr - 6, "ssim": 0.9, "flip": 0.1, "lpips": None}
    costs = {"steps": 4000, "train_seconds": 70.0, "gaussians": 25000, "bytes": 5_500_000, "packed_bytes": 900_000}
    made = {"missing": {"lpips": "not installed"}, "threads": 0, "dedicated": True, "device": "cpu", **_MADE_ON}
    key = f"{scene}-{label}-{group}-{seed}"
    recipe = {"moment_seeds": method == "frog", "size_limit": 0.2}
    return {"kind": "run", **identity(run), "recipe": recipe, "key": key, **quality, **costs, **made, **changes}


def timing_record(method: str = "frog", fps: float = 50.0, scene: str = "room", **changes: Any) -> Record:
    """A line of the dedicated pass."""
    record = {
        **run_record(method, scene=scene),
        "kind": "timing",
        "training": {"steps": 300, "step_ms": 17.0, "seconds": 68.3},
        "playback": {
            "gaussians": 25000,
            "deformation_ms": 2.0,
            "rasterization_ms": 1e3 / fps - 2.0,
            "frame_ms": 1e3 / fps,
            "fps": fps,
        },
        "scene_played": "finished",
    }
    return {**record, **changes}


def whole_chart() -> list[Record]:
    """Six methods on two scenes, three seeds of the main two, ablations, runs at equal time, timings."""
    psnrs = {"frog": 30.1, "ed3dgs": 30.15, "static": 22.0, "d3dgs": 29.0, "hexplane": 28.9, "curves": 29.1}
    speeds = {"frog": 52.0, "ed3dgs": 40.0, "static": 80.0, "d3dgs": 9.0, "hexplane": 30.0, "curves": 70.0}
    records = []
    for shift, scene in enumerate(("room", "dim")):
        for method, psnr in psnrs.items():
            for seed in range(3 if method in ("frog", "ed3dgs") else 1):
                value = psnr - 2 * shift + 0.05 * seed
                records.append(run_record(method, seed, scene, psnr=value, bytes=5_000_000 + 300_000 * len(method)))
                if method != "frog":
                    records.append(run_record(method, seed, scene, group="time", psnr=value - 0.2))
            records.append(timing_record(method, speeds[method], scene))
        for label, group, gain in (
            ("fusion: add", "fusion", -0.3),
            ("modulation: off", "modulation", -0.6),
            ("fusion: dual", "fusion", 0.02),
            ("sampling: off", "sampling", -0.1),
            ("opacity: paper", "opacity", 0.15),
            ("k = 5", "k", 0.0),
        ):
            for seed in range(3):
                psnr = psnrs["frog"] - 2 * shift + 0.05 * seed + gain * (1 + 0.2 * seed)
                records.append(run_record("frog", seed, scene, label=label, group=group, psnr=psnr))
        sweep = {"3,125 Gaussians": (-2.0, 150_000), "12,500 Gaussians": (-0.4, 500_000)}
        sweep |= {"5% move": (-0.9, 520_000), "20% move": (-0.02, 560_000)}
        for label, (gain, size) in sweep.items():
            psnr = psnrs["frog"] - 2 * shift + gain
            changed = {"label": label, "group": "capacity", "psnr": psnr, "packed_bytes": size}
            records.append(run_record("frog", 0, scene, **changed))
        for seed in range(3):
            changed = {"label": "FRoG auto", "psnr": psnrs["frog"] - 2 * shift - 0.05, "packed_bytes": 570_000}
            records.append(run_record("frog", seed, scene, bytes=570_000, **changed))
    return records
