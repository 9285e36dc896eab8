"""The stability suite: its grid, its summary, its report, and the command on the small recorded scene."""

import shutil
from pathlib import Path
from typing import Any

import pytest
from support import synthetic_capture as film
from support.builders import Run, refused

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.evaluation.fly import evaluate_fly
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.research import stability
from frog_blender.research.conditions import CONDITIONS
from frog_blender.research.grid import AUTO_LABEL
from frog_blender.research.results import Record, append, read
from frog_blender.research.runs import _off_rig

FROG, STATIC = "FRoG", "3DGS (static)"


def record(condition: str, label: str, seed: int, psnr: float | None, **changes: Any) -> Record:
    key = f"{condition} {label} {seed}"
    return {"kind": "run", "key": key, "condition": condition, "label": label, "seed": seed, "psnr": psnr, **changes}


def some() -> list[Record]:
    return [
        *(record("clean", FROG, seed, psnr) for seed, psnr in enumerate((30.0, 30.2, 30.4))),
        record("clean", STATIC, 0, 25.0),
        record("views 3", FROG, 0, 27.0),
        record("views 3", FROG, 1, 24.0),
        record("views 3", STATIC, 0, 25.5),
        record("light 0.25", FROG, 0, 45.0, psnr_bright=33.0),
        {**record("noise 15", FROG, 0, None), "kind": "failed", "error": "out of memory"},
        record("jpeg 15", FROG, 0, None),
    ]


def test_the_grid_begins_with_a_first_seed_of_everything(filmed: Path) -> None:
    runs = stability.stability_grid({"clean": filmed}, rows=["frog", "frog-auto", "static"], seeds=(3, 2), side=24)
    assert {run.condition for run in runs} == {name for name, item in CONDITIONS.items() if item.base == "clean"}
    seeds = [run.seed for run in runs]
    assert seeds == sorted(seeds)
    count = len({run.condition for run in runs})
    assert [sum(seed == k for seed in seeds) for k in range(3)] == [3 * count, 3 * count, count]
    assert {run.scale for run in runs} == {24 / film.WIDTH}
    assert len({run.key for run in runs}) == len(runs)
    assert dict(next(run for run in runs if run.condition == "points 1%").overrides)["seed_share"] == 0.01
    assert {run.label for run in runs} == {FROG, AUTO_LABEL, STATIC}


def test_captures_that_are_missing_are_named(filmed: Path) -> None:
    sentences = stability.without_captures(
        {"clean": filmed, "long": filmed, "dim": filmed, "appearing": filmed}, list(CONDITIONS)
    )
    assert sentences == [
        "Left out without --still (a scene in which nothing moves (examples/make_still.py)): nothing moves."
    ]


def test_losses_are_against_the_same_methods_clean_case() -> None:
    results = stability.outcome(some())
    assert results.labels == [FROG, STATIC]
    assert results.loss(CONDITIONS["views 3"], FROG) == pytest.approx(25.5 - 30.2)
    assert results.loss(CONDITIONS["views 3"], STATIC) == pytest.approx(0.5)
    assert results.loss(CONDITIONS["clean"], FROG) is None
    assert results.cell("clean", FROG).deviation("psnr") == pytest.approx(0.2)
    assert results.cell("light 0.25", FROG).median("psnr") == 33.0, "as bright as the others"


def test_failures_are_said(tmp_path: Path) -> None:
    results = stability.outcome(some())
    assert results.cell("views 3", FROG).failures == ["seed 1: 1.5 dB worse than a static scene"]
    assert results.cell("noise 15", FROG).failures == ["seed 0: out of memory"]
    assert results.cell("jpeg 15", FROG).failures == ["seed 0: its images are not finite"]
    text = stability.stability_table(results)
    assert "- views 3, FRoG, seed 1: 1.5 dB worse than a static scene" in text
    assert "| views 3 | 25.50 ± 2.12 (2) | 25.50 (1) | - | +1.50 |" in text
    words = [text.get_text() for text in stability.heat_map(results).axes[0].texts]
    assert "-4.70 ±2.12 !1" in words
    assert "33.00 dB" in words
    again = [*some(), record("noise 15", FROG, 0, 29.0)]
    assert not stability.outcome(again).cell("noise 15", FROG).failures, "it was done again"
    refused("no finished run", stability.write_stability, tmp_path)


def test_a_small_suite(run: Run, quick_seeds: None, filmed: Path, tmp_path: Path) -> None:
    taken = Path(shutil.copytree(filmed, tmp_path / "taken"))
    cameras = film.write_fly(taken / "fly", 2, ("near2", "near3", "zoom", "above"))
    options = ("stability", taken, "--dim", taken, "--out", tmp_path, "--steps", 4, "--seeds", 1, "--frog-seeds", 1)
    chosen = ("--methods", "frog,static", "--conditions", "clean,points 10%,light 0.25")
    status, text, err = run(*options, *chosen)
    assert status == 0, err
    assert "points 10%: FRoG, at equal steps, 1 seed" in text
    records = {(r["condition"], r["label"], r["seed"]): r for r in read(tmp_path / "runs.jsonl")}
    assert len(records) == 6
    assert records["points 10%", "FRoG", 0]["recipe"]["seed_share"] == 0.1
    dim = records["light 0.25", "FRoG", 0]
    assert dim["psnr_bright"] < dim["psnr"] - 3
    assert records["clean", "FRoG", 0]["psnr_bright"] is None
    clean = records["clean", "FRoG", 0]
    figures = evaluate_fly(tmp_path / "scenes" / f"{clean['key']}.frog", taken, cameras)
    values = [figures["groups"][name]["psnr"] for name in ("near2", "near3", "zoom", "above")]
    assert clean["fly"] == pytest.approx(sum(values) / 4) and clean["zoom"] == pytest.approx(values[2])
    assert clean["near"] == pytest.approx(sum(values[:2]) / 2) and "beside" not in clean and "fly" not in dim
    played = ScenePlayer.load(tmp_path / "scenes" / f"{clean['key']}.frog")
    others = open_capture(taken).segment(0, 3), open_capture(taken)  # a condition's frames may be others
    assert [bool(_off_rig(TrainingJob(taken, tmp_path / "x.frog"), each, played)) for each in others] == [False, True]
    page = (tmp_path / "stability.md").read_text(encoding="utf-8")
    assert "| points 10% |" in page
    assert f"| clean, FRoG | {clean['fly']:.2f} | {clean['near']:.2f} | {clean['zoom']:.2f} | - |" in page
    assert (tmp_path / "stability.svg").stat().st_size > 10_000
    append(tmp_path / "runs.jsonl", {"kind": "other"})
    status, text, err = run(*options, *chosen)
    assert (status, "6 runs, 0 to do" in text) == (0, True), "nothing is done twice"
