"""``frog chart`` from its arguments to its files, on the small recorded scene."""

from dataclasses import replace
from pathlib import Path

import pytest
from support import synthetic_capture as film
from support.builders import Run

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.research import protocols, timing
from frog_blender.research.results import read

pytestmark = pytest.mark.usefixtures("quick_seeds")


def test_a_small_chart(run: Run, filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Later one of its captures is not there: the others are drawn nevertheless."""
    monkeypatch.setattr(timing, "STEPS", 8)
    out = tmp_path / "chart"
    options = ("--out", out, "--methods", "static,frog", "--steps", 4, "--seeds", 1)
    more = ("--equal-time", "--row", "Narrow=static,sh_degree=0", "--timing")
    status, text, err = run("chart", filmed, *options, *more)
    assert status == 0, err
    records = read(out / "runs.jsonl")
    assert [(record["kind"], record["label"], record["equal_time"]) for record in records] == [
        ("run", "3DGS (static)", False),
        ("run", "FRoG", False),
        ("run", "Narrow", False),
        ("run", "3DGS (static)", True),
        ("timing", "3DGS (static)", False),
        ("timing", "FRoG", False),
        ("timing", "Narrow", False),
    ]
    assert "4 runs, 4 to do" in text and "capture, FRoG, seed 0:" in err and "dB" in err
    tables = (out / "tables.md").read_text(encoding="utf-8")
    assert "| FRoG |" in tables and "| Narrow |" in tables and "As long as FRoG took" in tables
    assert [path.name for path in out.glob("*.svg")] == ["speed_capture_draft_4.svg"]
    assert (out / "scenes" / ".gitignore").read_text() == "*\n" and not list(out.rglob("*.checkpoint"))

    status, text, err = run("chart", filmed, tmp_path / "gone", *options)
    assert status == 1 and "4 runs, 2 to do" in text and len(read(out / "runs.jsonl")) == len(records) + 2
    assert "2 runs failed" in err and "gone: there is no such folder" in err and str(out / "tables.md") in text
    assert "gone: there is no such folder" in (out / "tables.md").read_text()
    status, text, _ = run("chart", filmed, "--out", out, "--only-report")
    assert status == 0 and "to do" not in text


def test_a_plan_runs_nothing(run: Run, filmed: Path, tmp_path: Path) -> None:
    status, text, _ = run("chart", filmed, "--out", tmp_path / "o", "--methods", "frog,ed3dgs,static", "--plan")
    assert status == 0 and not (tmp_path / "o").exists()
    assert (
        "capture: FRoG, at equal steps, 3 seeds" in text and "capture: 3DGS (static), at equal steps, 1 seed\n" in text
    )
    assert "7 runs, 7 to do" in text


def test_mistakes(run: Run, filmed: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "o")
    for arguments, word in (
        ((filmed, *out, "--methods", "nerf"), "nerf"),
        ((filmed, *out, "--ablation", "colour"), "colour"),
        ((filmed, *out, "--set", "network_rate"), "--set network_rate"),
        ((filmed, *out, "--set", "speed=3"), "speed"),
        ((filmed, *out, "--set", "steps=abc"), "steps is 'abc', expected a whole number"),
        ((filmed, *out, "--row", "Wide"), "--row Wide"),
        ((filmed, *out, "--row", "Wide=frog,width=3"), "width"),
        ((filmed, filmed, *out), "another capture"),
        ((filmed, *out, "--only-report"), "no finished run"),
        ((filmed, filmed, *out, "--protocol", "n3dv"), "found 2 folders"),
        ((filmed, *out, "--protocol", "nerf"), "no protocol 'nerf'"),
        ((filmed, *out, "--scenes", "flame_steak"), "--scenes: found no --protocol"),
    ):
        status, _, err = run("chart", *arguments)
        assert status == 1 and err.startswith("frog: ") and word in err and err.count("\n") == 1, err
    assert not (tmp_path / "o").exists()


def test_a_protocol(run: Run, filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The protocol opens the captures, names them, chooses the recipe, and its published table stands beside ours."""
    asked: list[object] = []

    def captures(protocol: str, directory: Path, names: object = None) -> list[tuple[str, Capture]]:
        asked.append((protocol, directory, names))
        return [("flame", replace(open_capture(filmed), test_cameras=frozenset({"cam02"})))]

    monkeypatch.setattr(protocols, "captures", captures)
    out = tmp_path / "o"
    status, said, err = run(
        "chart",
        filmed.parent,
        "--protocol",
        "n3dv",
        "--scenes",
        "flame",
        "--out",
        out,
        "--methods",
        "static",
        "--steps",
        2,
        "--seeds",
        1,
    )
    assert status == 0, err
    (record,) = read(out / "runs.jsonl")
    assert (record["scene"], record["protocol"], record["recipe_name"]) == ("flame", "n3dv", "paper")
    assert record["scale"] == 1.0 and record["frames"] == film.FRAMES
    assert "0 of the 9 captures of n3dv, without coffee_martini, " in said
    assert asked[0] == ("n3dv", filmed.parent, ["flame"]) and ("n3dv", filmed.parent, ["flame"]) in asked
    assert "## Published" in (out / "tables.md").read_text() and "E-D3DGS" in (out / "tables.md").read_text()
