"""Exit statuses of every command, what --quiet and --log make of output, and lines where there is no terminal."""

import re
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.builders import scene_file

from frog_blender.cli import CANCELLED, FAILED, REFUSED, WRONG_USE, progress
from frog_blender.cli.main import main
from frog_blender.engine.scene.scene_file import write_scene

REQUESTS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
CAMERA = scene_file().header.cameras[0].name
armed: list[tuple[str, int]] = []


def _audited(event: str, arguments: Any) -> None:
    """Sends a signal when a file of an armed name is opened first."""
    if armed and event == "open" and armed[0][0] in str(arguments[0]):
        signal.raise_signal(armed.pop()[1])


sys.addaudithook(_audited)


@pytest.fixture
def when_opened() -> Iterator[Callable[[str, int], None]]:
    yield lambda name, request: armed.append((name, request))
    armed.clear()


@pytest.fixture
def folder(tmp_path: Path, filmed: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With a capture "rig", a scene "x.frog" and an "x.ply"."""
    shutil.copytree(filmed, tmp_path / "rig")
    write_scene(tmp_path / "x.frog", scene_file())
    (tmp_path / "x.ply").write_text("ply")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    return tmp_path


COMMANDS = {
    "info": ("info x.frog", "x.frog"),
    "info of a capture": ("info rig", "rig"),
    "eval": ("eval x.frog rig", "x.frog"),
    "render": ("render x.frog --camera cam00 --out out", "x.frog"),
    "export": ("export x.frog --out out", "x.frog"),
    "import": ("import x.ply", "x.ply"),
    "calibrate": ("calibrate rig", "cam00.mp4"),
    "train": ("train rig --out y.frog", "rig"),
    "takes": ("train . --takes --out scenes", "rig"),
    "chart": ("chart rig --out out", "rig"),
    "stability": ("stability rig --out out", "rig"),
}


@pytest.mark.parametrize("request_to_end", REQUESTS, ids=str)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_request_to_end_is_status_3(
    command: str,
    request_to_end: int,
    folder: Path,
    when_opened: Callable[[str, int], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments, name = COMMANDS[command]
    when_opened(name, request_to_end)
    assert main(arguments.split()) == CANCELLED
    assert not armed and "frog: " in capsys.readouterr().err
    assert not (folder / "y.frog").exists()


@pytest.mark.parametrize(
    ("status", "arguments"),
    [
        (FAILED, "import x.ply"),
        (FAILED, "import x[.frog]"),
        (FAILED, "chart rig --out out --only-report"),
        (FAILED, "calibrate rig --board x.ply"),
        (WRONG_USE, "train rig --out y.frog --resume"),
        (WRONG_USE, "info [none.frog]"),
        (WRONG_USE, "eval [none.frog] rig"),
        (WRONG_USE, "eval x.frog [none]"),
        (WRONG_USE, "eval x.frog rig --mask [none.png]"),
        (WRONG_USE, "eval x.frog rig --cameras [none.json]"),
        (WRONG_USE, "render [none.frog] --camera cam00 --out out"),
        (WRONG_USE, "render x.frog --cameras [none.json] --out out"),
        (WRONG_USE, "export x.frog --edits [none.json] --out out"),
        (WRONG_USE, "import [none.ply]"),
        (WRONG_USE, "calibrate [none]"),
        (WRONG_USE, "calibrate rig --board [none.toml]"),
        (WRONG_USE, "train [none] --out y.frog"),
        (WRONG_USE, "train [none] --takes --out scenes"),
        (WRONG_USE, "train rig --out y.frog --config [none.toml]"),
        (WRONG_USE, "chart [none] --out out"),
        (WRONG_USE, "chart [none] --protocol n3dv --out out"),
        (WRONG_USE, "stability [none] --out out"),
        (WRONG_USE, "stability rig --long [none] --out out"),
        (WRONG_USE, "info x.frog [--check]"),
        (WRONG_USE, "eval x.frog rig --metric [none]"),
        (WRONG_USE, "render x.frog --camera [none] --out out"),
        (WRONG_USE, "render x.frog --camera odd --frames [9:2] --out out"),
        (WRONG_USE, "export x.frog [--silent] --out out"),
        (WRONG_USE, "export x.frog [--float] --out out"),
        (WRONG_USE, "export x.frog --frames [5:9] --out out"),
        (WRONG_USE, "import x.ply [--fps] 24"),
        (WRONG_USE, "calibrate rig [--clock] cam00"),
        (WRONG_USE, "calibrate rig --clock cam00=[soon]"),
        (WRONG_USE, "train rig --out x.frog"),
        (WRONG_USE, "train rig --out y.frog --set [stesp]=3"),
        (WRONG_USE, "train rig --out y.frog --sink [none]"),
        (WRONG_USE, "train rig --out y.frog --scheduler local"),
        (WRONG_USE, "train . --takes --out scenes [--events]"),
        (WRONG_USE, "train rig --out y.frog --max-bytes 9 --lossless"),
        (WRONG_USE, "info rig --pixel-offset [none]=1,2"),
        (WRONG_USE, "calibrate rig --clock [none]=1"),
        (WRONG_USE, "calibrate rig --use-found"),
        (WRONG_USE, "render x.frog --camera odd --out out.mp4"),
        (WRONG_USE, "render x.frog --camera odd --out out --scheduler [none]"),
        (WRONG_USE, "export x.frog --usd --out y.[obj]"),
        (WRONG_USE, "export x.frog --html --out y"),
        (WRONG_USE, "export x.frog --out frames.ply"),
        (WRONG_USE, "import x.ply --out y.ply"),
        (WRONG_USE, "import x.ply --out x.frog"),
        (WRONG_USE, "chart rig --out out --scenes a"),
        (WRONG_USE, "chart rig --out out --protocol n3dv --scenes a"),
        (WRONG_USE, "chart rig --out out --methods [none]"),
        (WRONG_USE, "chart rig --out out --set [stesp]=3"),
        (WRONG_USE, "chart rig --out out --set [sh_degree]=9"),
        (WRONG_USE, "chart rig --out out --row Wide=frog,[stesp]=3"),
        (WRONG_USE, "chart rig --out out --set [network_rate]"),
        (WRONG_USE, "chart rig --out out --set [steps]=abc"),
        (WRONG_USE, "chart rig --out out --row [Wide]"),
        (WRONG_USE, "chart rig --out out --ablation [colour]"),
        (WRONG_USE, "chart rig --out out --protocol [none]"),
        (WRONG_USE, "chart rig rig --out out --protocol n3dv"),
        (WRONG_USE, "chart rig rig --out out"),
        (WRONG_USE, "stability rig --out out --conditions [fog]"),
        (WRONG_USE, "stability rig --out out --methods [none]"),
        (WRONG_USE, "stability rig --out out --set [sh_degree]=9"),
        (REFUSED, "chart rig --out out --protocol n3dv"),
        (REFUSED, "chart rig [empty] --out out"),
        (REFUSED, "train [empty] --takes --out scenes"),
        (REFUSED, "stability [empty] --out out"),
        (REFUSED, "info [empty]"),
        (REFUSED, "eval x.frog [empty]"),
        (REFUSED, "calibrate [empty]"),
        (REFUSED, "train [empty] --out y.frog"),
        (REFUSED, "info [damaged]"),
        (REFUSED, "train [damaged/cam01.mp4] --out y.frog"),
        (FAILED, "render [damaged/cam01.mp4] --camera cam00 --out out"),
    ],
)
def test_what_was_wrong_is_the_status(
    status: int, arguments: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a sentence, which names what stands in brackets here."""
    (folder / "empty").mkdir()
    shutil.copytree(folder / "rig", folder / "damaged")
    (folder / "damaged" / "cam01.mp4").write_bytes(b"no film")
    before = sorted(folder.rglob("*"))
    assert main(re.sub(r"[\[\]]", "", arguments).split()) == status
    said = capsys.readouterr().err.splitlines()[-1]
    assert re.fullmatch(r"frog: \S.*[^.]\.", said)
    assert all(name in said for name in re.findall(r"\[(.*?)\]", arguments)), said
    assert sorted(path for path in folder.rglob("*") if path.is_file() or path in before) == before


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("", "required"),
        ("info", "required"),
        ("train x", "required"),
        ("render x --out y", "required"),
        ("nonsense", "invalid choice"),
        ("train x --out y --recipe fast", "fast"),
        ("info x --log none/at/all", "cannot be written"),
        *((f"train x --out y.frog --steps {steps}", "a whole number from 1") for steps in ("0", "2.5")),
        *((f"train x --out y.frog --seed {seed}", "a whole number from 0") for seed in ("-1", "9" * 19)),
        ("train x --out y.frog --seconds nan", "a number"),
        ("train x --out y.frog --scale -1", "a number from 0.0001 to 16"),
        ("train x --out y.frog --holdout-frames 1", "0 or a whole number from 2"),
        ("render x --camera c --out o --step 1e-9", "a positive number of at least 0.001"),
        ("render x --camera c --out o --size 64", "neither WIDTHxHEIGHT nor"),
        ("render x --camera c --out o --size 64xa", "a is not a positive whole number"),
        ("render x --camera c --out o --background red 0 0", "red is not between 0 and 1"),
        ("chart x --out o --holdout-frames -5", "0 or a whole number from 2"),
        ("chart x --out o --scale 99", "a number from 0.0001 to 16"),
        ("stability x --out o --steps nan", "a whole number from 1"),
        ("chart x --out o --plan --only-report", "not allowed with"),
    ],
)
def test_wrong_options_are_status_2(arguments: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments.split())
    error = capsys.readouterr().err
    assert ended.value.code == WRONG_USE and said in error and "usage: frog" in error


def test_quiet_and_a_log(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_LINE_EVERY", 0.0)
    render = ["render", "x.frog", "--camera", CAMERA, "--out", "out"]
    assert main(render) == 0
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert lines and all(re.fullmatch(r"Rendering: \d+ %", line) for line in lines) and "\r" not in err
    assert main([*render, "--quiet"]) == 0
    assert capsys.readouterr() == (out, "")
    assert main([*render, "--quiet", "--log", "log"]) == 0
    assert capsys.readouterr() == (out, "")
    assert main(["info", "none", "--log", "log"]) == WRONG_USE
    told = [line.partition(" ") for line in (folder / "log").read_text().splitlines()]
    assert all(re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", time) for time, _, _ in told)
    said = [text for _, _, text in told]
    assert said[0] == "Rendering: 0 %" and out.strip() in said and said[-1].startswith("frog: none: there is no such")


def test_a_terminal_has_bars_and_the_log_lines(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert main(["render", "x.frog", "--camera", CAMERA, "--out", "out", "--log", "log"]) == 0
    assert "%|" in capsys.readouterr().err
    assert "Rendering: 0 %" in (folder / "log").read_text()
