"""``frog chart`` from its arguments to its files, on the small recorded scene."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from support import synthetic_capture as film

from frog_blender.cli.main import main
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.research import protocols
from frog_blender.research.results import read

Chart = Callable[..., tuple[int, str, str]]


@pytest.fixture
def chart(quick_seeds: None, capsys: pytest.CaptureFixture[str]) -> Chart:
    def call(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = main(["chart", *map(str, arguments)])
        return status, *capsys.readouterr()

    return call


def test_a_small_chart(chart: Chart, filmed: Path, tmp_path: Path) -> None:
    out = tmp_path / "chart"
    options = (filmed, "--out", out, "--methods", "frog,static", "--steps", 6, "--seeds", 1)
    more = (
        "--equal-time",
        "--timing",
        "--timing-steps",
        8,
        "--ablation",
        "opacity",
        "--row",
        "Wide=frog,hidden_width=32",
    )
    status, text, err = chart(*options, *more)
    assert status == 0, err
    records = read(out / "runs.jsonl")
    kinds = [(record["kind"], record["label"], record["equal_time"]) for record in records]
    assert kinds == [
        ("run", "FRoG", False),
        ("run", "3DGS (static)", False),
        ("run", "Wide", False),
        ("run", "opacity: paper", False),
        ("run", "opacity: off", False),
        ("run", "3DGS (static)", True),
        ("timing", "FRoG", False),
        ("timing", "3DGS (static)", False),
        ("timing", "Wide", False),
    ]
    assert "6 runs, 6 to do" in text and "capture, FRoG, seed 0:" in err and "dB" in err
    tables = (out / "tables.md").read_text(encoding="utf-8")
    assert "| FRoG |" in tables and "| Wide |" in tables and "As long as FRoG took" in tables
    assert {path.name for path in out.glob("*.png")} == {
        f"{kind}_capture_draft_6.png" for kind in ("speed", "training", "ablation")
    }
    assert (out / "scenes" / ".gitignore").read_text() == "*\n"
    status, text, _ = chart(*options, *more[:1])
    assert status == 0 and "3 runs, 0 to do" in text and len(read(out / "runs.jsonl")) == len(records)


def test_a_plan_runs_nothing(chart: Chart, filmed: Path, tmp_path: Path) -> None:
    status, text, _ = chart(filmed, "--out", tmp_path / "o", "--methods", "frog,ed3dgs,static", "--plan")
    assert status == 0 and not (tmp_path / "o").exists()
    assert (
        "capture: FRoG, at equal steps, 3 seeds" in text and "capture: 3DGS (static), at equal steps, 1 seed\n" in text
    )
    assert "7 runs, 7 to do" in text


def test_a_failed_run_is_reported_and_the_rest_is_drawn(chart: Chart, filmed: Path, tmp_path: Path) -> None:
    out = tmp_path / "o"
    options = ("--methods", "static", "--steps", 2, "--seeds", 1)
    status, text, err = chart(filmed, tmp_path / "gone", "--out", out, *options)
    assert status == 1 and "1 run failed" in err and "gone: there is no such folder" in err
    tables = (out / "tables.md").read_text()
    assert "gone: there is no such folder" in tables and "| 3DGS (static) |" in tables
    assert str(out / "tables.md") in text
    status, text, _ = chart(filmed, "--out", out, "--only-report")
    assert status == 0 and "to do" not in text


def test_mistakes(chart: Chart, filmed: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "o")
    for arguments, word in (
        ((filmed, *out, "--methods", "nerf"), "nerf"),
        ((filmed, *out, "--ablation", "colour"), "colour"),
        ((filmed, *out, "--set", "network_rate"), "--set network_rate"),
        ((filmed, *out, "--set", "speed=3"), "speed"),
        ((filmed, *out, "--set", "steps=abc"), "steps is 'abc', expected a whole number"),
        ((filmed, *out, "--timing-steps", 5), "--timing-steps 5"),
        ((filmed, *out, "--row", "Wide"), "--row Wide"),
        ((filmed, *out, "--row", "Wide=frog,width=3"), "width"),
        ((filmed, filmed, *out), "another capture"),
        ((filmed, *out, "--only-report"), "no finished run"),
    ):
        status, _, err = chart(*arguments)
        assert status == 1 and err.startswith("frog: ") and word in err and err.count("\n") == 1, err
    assert not (tmp_path / "o").exists()


def test_perceptual_figures_of_a_scene(
    chart: Chart, filmed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = str(tmp_path / "x.frog")
    assert main(["train", str(filmed), "--out", scene, "--recipe", "draft", "--steps", "2"]) == 0
    capsys.readouterr()
    assert main(["eval", scene, str(filmed), "--perceptual", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    for name in ("flip", "lpips"):
        assert (report[name] is None) == (name in report["missing"])
    assert main(["eval", scene, str(filmed), "--perceptual"]) == 0
    text = capsys.readouterr().out
    for name, reason in report["missing"].items():
        assert f"{name}  - ({reason})" in text
    assert main(["eval", scene, str(filmed), "--json"]) == 0
    assert "flip" not in json.loads(capsys.readouterr().out)


def test_a_protocol(chart: Chart, filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The protocol opens the captures, names them, chooses the recipe, and its published table stands beside ours."""
    asked: list[object] = []

    def captures(protocol: str, directory: Path, names: object = None) -> list[tuple[str, Capture]]:
        asked.append((protocol, directory, names))
        segment = replace(open_capture(filmed), test_cameras=frozenset({"cam02"}))
        return [("flame", segment)]

    monkeypatch.setattr(protocols, "captures", captures)
    out = tmp_path / "o"
    options = ("--protocol", "n3dv", "--out", out, "--methods", "static", "--steps", 2)
    status, _, err = chart(filmed.parent, *options)
    assert status == 0, err
    (record,) = read(out / "runs.jsonl")
    assert (record["scene"], record["protocol"], record["recipe_name"]) == ("flame", "n3dv", "paper")
    assert record["scale"] == 1.0 and record["frames"] == film.FRAMES
    assert asked[0] == ("n3dv", filmed.parent, None) and ("n3dv", filmed.parent, ["flame"]) in asked
    assert "## Published" in (out / "tables.md").read_text() and "E-D3DGS" in (out / "tables.md").read_text()
    status, _, err = chart(filmed.parent, filmed, *options)
    assert status == 1 and "found 2 folders" in err
    status, _, err = chart(filmed.parent, "--protocol", "nerf", "--out", out)
    assert status == 1 and "no protocol 'nerf'" in err
