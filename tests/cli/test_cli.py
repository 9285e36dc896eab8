"""``frog`` from its arguments to its exit status: what it writes, what it prints, and one sentence for each mistake."""

import io
import json
import re
import shutil
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from datetime import date
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import Run
from support.json_schema import check

from frog_blender.cli import FAILED, REFUSED, WRONG_USE, info_command
from frog_blender.cli.arguments import frames_of
from frog_blender.cli.main import main
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.scene.scene_file import read_scene, write_scene


@pytest.fixture(scope="module")
def trained(filmed: Path, cache_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Trained by the command itself, from seeds that it found, with few Gaussians."""
    path = tmp_path_factory.mktemp("trained") / "x.frog"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FROG_CACHE", str(cache_folder))
        options = ["--out", str(path), "--recipe", "draft", "--steps", "20", "--seed", "1", "--max-gaussians", "250"]
        assert main(["train", str(filmed), *options]) == 0
    return path


def test_a_fixed_capacity_keeps_everything(run: Run, filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    options = ("--recipe", "draft", "--steps", "6")
    for name, more in (("auto", ()), ("exact", ("--lossless",)), ("fixed", ("--capacity", "fixed"))):
        assert run("train", filmed, "--out", tmp_path / f"{name}.frog", *options, *more)[0] == 0
    auto, exact, fixed = (
        json.loads(run("info", tmp_path / f"{n}.frog", "--json")[1]) for n in ("auto", "exact", "fixed")
    )
    assert fixed["dynamic_gaussians"] == fixed["gaussians"] and fixed["reductions"] == []
    assert auto["gaussians"] == exact["gaussians"] and 2 * auto["bytes"] < exact["bytes"] <= fixed["bytes"]


def test_budgets(run: Run, filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    options = ("train", filmed, "--out", tmp_path / "x.frog", "--recipe", "draft", "--steps", "6")
    assert run(*options, "--max-gaussians", "310")[0] == 0
    assert json.loads(run("info", tmp_path / "x.frog", "--json")[1])["gaussians"] <= 310
    options = (*options, "--overwrite")
    assert run(*options, "--max-bytes", "60000")[0] == 0
    assert (tmp_path / "x.frog").stat().st_size <= 60_000
    refused(run(*options, "--max-bytes", "1000"), "1000 bytes", "too small")
    for more in (("--capacity", "fixed"), ("--lossless",), ("--method", "static")):
        refused(run(*options, "--max-bytes", "60000", *more), "budget of bytes", "automatic capacity")


def test_a_scene_is_replaced_only_when_that_is_asked_for(
    run: Run, filmed: Path, tmp_path: Path, quick_seeds: None
) -> None:
    scene, checkpoint = tmp_path / "x.frog", tmp_path / "x.frog.checkpoint"
    options = ("train", filmed, "--out", scene, "--recipe", "draft", "--method", "static")
    assert run(*options, "--steps", "4")[0] == 0
    before = scene.read_bytes()
    refused(run(*options, "--steps", "5"), str(scene), "--overwrite", "--resume")
    refused(run("train", filmed / "cam00.mp4", "--out", scene), "--overwrite")
    scene.unlink()
    refused(run(*options, "--steps", "5"), str(checkpoint), "the checkpoint of a training", "--overwrite", "--resume")
    scene.write_bytes(before)
    checkpoint.unlink()
    refused(run("train", "nowhere", "--out", scene, "--overwrite"), "nowhere")
    assert scene.read_bytes() == before, "a training that does not begin replaces nothing"
    assert run(*options, "--steps", "5", "--overwrite")[0] == 0
    assert read_scene(scene).header.steps == 5
    assert run(*options, "--steps", "6", "--resume")[0] == 0
    assert read_scene(scene).header.steps == 6


def refused(result: tuple[int, str, str], *words: str) -> None:
    status, out, err = result
    assert status in (FAILED, WRONG_USE, REFUSED) and out == ""
    *bars, told = re.split(r"[\r\n]+", err.strip())  # where work had begun, bars stand before
    assert told.startswith("frog: ") and told.endswith(".") and err.endswith(".\n")
    assert all(re.search(r": \d+ %", bar) for bar in bars), "nothing but one sentence and the progress"
    assert "Traceback" not in err
    for word in words:
        assert word in err


def test_a_resume_says_which_options_it_leaves_aside(run: Run, filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    options = ("train", filmed, "--out", tmp_path / "y.frog")
    began = ("--recipe", "draft", "--seed", "5", "--max-gaussians", "310", "--pixel-offset", "cam01=1,0")
    status, out, _ = run(*options, *began, "--steps", "4")
    assert status == 0 and f"{tmp_path / 'y.frog'}: 4 steps" in out and "PSNR" in out
    status, _, err = run(*options, *began, "--steps", "5", "--resume", "--device", "cpu", "--save-every", "9")
    assert status == 0 and "ignored" not in err and "original settings" not in err
    other = {
        "--seed": ["0"],  # which it would be by itself
        "--scale": ["0.5"],
        "--holdout-frames": ["3"],
        "--max-gaussians": ["200"],
        "--capacity": ["fixed"],
        "--lossless": [],
        "--pixel-offset": ["cam01=2,0"],
    }
    asked = [word for option, values in other.items() for word in (option, *values)]
    status, _, err = run(*options, "--recipe", "draft", *asked, "--steps", "6", "--resume")
    (said,) = [line for line in err.splitlines() if "ignored" in line]
    assert status == 0 and "Resuming with the original settings: method frog, recipe draft, capacity auto; ign" in said
    assert set(said.split("ignored: ")[1].rstrip(".").split(", ")) == set(other)
    header = read_scene(tmp_path / "y.frog").header
    assert (header.scale, header.test_frames, header.steps) == (1.0, (), 6)


def test_the_cache_is_shown_limited_and_cleared(
    run: Run, filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))  # others use the usual one
    monkeypatch.delenv("FROG_CACHE_LIMIT", raising=False)
    capture = open_capture(filmed)
    store = FrameStore.open(capture)
    FrameStore.open(capture.scaled(0.5))
    status, out, _ = run("cache")
    assert status == 0 and out.count(str(filmed)) == out.count(f"{date.today()} ") == 2
    assert "(25% of the disk)" in out
    described = check(run("cache", "--json")[1], "cache")
    assert described["bytes"] == sum(entry["bytes"] for entry in described["frames"]) > 0
    status, out, _ = run("cache", "--limit", "1 KB")  # what is open stays
    assert status == 0 and out.count(str(filmed)) == 1 and "(1KB by frog cache --limit)" in out
    status, out, _ = run("cache", "--clear", "--limit", "default")
    assert status == 0 and "freed; 1 in use stay" in out
    assert store.give_up() > 0
    assert check(run("cache", "--clear", "--json")[1], "cache")["freed_bytes"] == 0
    status, out, error = run("cache", "--limit", "much")
    assert status == 1 and not out and "found 'MUCH'" not in error and "a size such as 40GB" in error


def test_eval_prints_every_figure(run: Run, trained: Path, filmed: Path) -> None:
    status, out, _ = run("eval", trained, filmed, "--json")
    report = check(out, "eval")
    assert status == 0
    for key in ("psnr", "psnr_moving", "ssim", "gaussians", "bytes", "steps", "cameras"):
        assert report[key] is not None, key
    assert 8 < report["psnr"] < 60 and 0 < report["ssim"] < 1 and report["steps"] == 20
    assert report["bytes"] == trained.stat().st_size
    assert report["cameras"].keys() == {"cam00"} and report["cameras"]["cam00"]["frames"] == film.FRAMES
    assert report["psnr"] == pytest.approx(read_scene(trained).header.metrics["psnr"], abs=0.05)
    status, out, _ = run("eval", trained, filmed, "--split", "training")
    assert status == 0 and "psnr_moving" in out and "18" in out


def test_eval_refuses_another_capture(run: Run, trained: Path, filmed: Path, tmp_path: Path) -> None:
    scene = read_scene(trained)
    first, *others = scene.header.cameras
    small, renamed = first.resized(first.width // 2, first.height // 2), replace(first, name="door")
    for header, words in (
        (replace(scene.header, frame_count=5), f"4 cameras and {film.FRAMES} frames, expected 4 cameras and 5 frames"),
        (replace(scene.header, cameras=(small, *others)), f"expected camera cam00 of {small.width} x {small.height}"),
        (replace(scene.header, cameras=(renamed, *others)), "found camera cam00"),
    ):
        write_scene(tmp_path / "x.frog", replace(scene, header=header))
        refused(run("eval", tmp_path / "x.frog", filmed), words)


def test_frames() -> None:
    assert frames_of(None, 10) == range(10)
    assert frames_of("2:5", 10) == range(2, 5)
    assert frames_of(":3", 10) == range(3) and frames_of("7:", 10) == range(7, 10)
    assert frames_of(":", 4) == range(4)
    for text in ("5", "a:b", "3:3", "5:2", "0:11", "-1:4", "1:2:3"):
        with pytest.raises(FrogError, match="--frames"):
            frames_of(text, 10)


def test_what_the_system_refuses(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refused(run("info", tmp_path / ("x" * 300)), "could not be read", "too long")
    refused(run("info", tmp_path / ("x" * 300 + ".frog")), "too long")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", "secret")

    monkeypatch.setattr(info_command, "open_capture", refuse)
    refused(run("info", tmp_path), "secret: the file or folder could not be used (Permission denied)")


def test_a_console_that_lacks_a_character_shows_its_number(filmed: Path, tmp_path: Path) -> None:
    stdout, stderr = (io.TextIOWrapper(io.BytesIO(), encoding="cp1252") for _ in range(2))
    (tmp_path / "日本").mkdir()
    shutil.copytree(filmed, tmp_path / "日")
    for video in sorted((tmp_path / "日").glob("*.mp4")):
        video.rename(video.with_stem(f"{video.stem}日"))
    with redirect_stdout(stdout), redirect_stderr(stderr):
        assert main(["info", str(tmp_path / "日本")]) == REFUSED
        assert main(["info", str(tmp_path / "日")]) == 0
    for stream, said in ((stdout, r"cam00\u65e5"), (stderr, r"\u65e5\u672c: found an empty folder")):
        stream.flush()
        assert said in stream.buffer.getvalue().decode("cp1252")  # type: ignore[attr-defined]


def test_mistaken_options(run: Run, trained: Path, filmed: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "o")
    refused(run("render", trained, "--camera", "cam77", *out), "cam77", "cam00, cam01")
    refused(run("render", trained, "--camera", "moving", *out), "moving")
    for offset in ("cam01", "cam01=3", "cam01=a,b", "cam01=1,2,3"):
        refused(run("info", filmed, "--pixel-offset", offset), f"--pixel-offset {offset}")
    refused(run("info", filmed, "--pixel-offset", "cam01=nan,2"), "cam01")
    refused(run("train", filmed, "--out", tmp_path), "found a folder")
    for name in ("x", "x.ply"):
        refused(run("train", filmed, "--out", tmp_path / name), name, "expected a file that ends in .frog")
    (tmp_path / "file").write_text("")
    refused(run("render", trained, "--camera", "cam01", "--out", tmp_path / "file"), "file")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_an_offset_reaches_the_cameras_and_a_bar_names_each_kind_of_work(
    run: Run, filmed: Path, tmp_path: Path, quick_seeds: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    scene = tmp_path / "x.frog"
    options = ("--recipe", "draft", "--steps", "2", "--pixel-offset", "cam01=2,-1.5")
    status, _, err = run("train", filmed, "--out", scene, *options)
    assert status == 0
    named = list(dict.fromkeys(re.findall(r"^(\w[\w ]*): +\d+ %", err, re.MULTILINE)))
    assert named[:2] == ["Decoding frames", "Finding seed points"]
    assert set(named[2:4]) == {"Training", "Compressing"}  # which begins before the last of two steps
    assert named[4:] == ["Measuring the quality", "Saving"]
    header = read_scene(scene).header
    assert header.pixel_offsets == {"cam01": (2.0, -1.5)}
    np.testing.assert_allclose(header.cameras[1].intrinsics[:2, 2], [film.WIDTH / 2 - 2, film.HEIGHT / 2 + 1.5])
    assert run("eval", scene, filmed, "--json")[0] == 0
