"""What programs read: every output is as docs/json-schema.json says, and equal trainings make equal files."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest
from support import synthetic_capture as film
from support.builders import Run, scene_file
from support.json_schema import check

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.recipes import recipe
from frog_blender.engine.scene.scene_file import read_scene, write_scene
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training


def test_the_schema_refuses_what_does_not_fit() -> None:
    good = {"event": "saved", "path": "x.frog"}
    check(json.dumps(good), "event")
    for bad in ({**good, "path": 3}, {"event": "saved"}, {**good, "more": 1}, {**good, "event": "none"}, [good], True):
        with pytest.raises(jsonschema.ValidationError):
            check(json.dumps(bad), "event")


def test_info_of_a_capture(run: Run, filmed: Path) -> None:
    told = check(run("info", filmed, "--json")[1], "info_capture")
    assert told["cameras"][1] == {"name": "cam01", "width_pixels": 48, "height_pixels": 36}
    assert (told["held_out_cameras"], told["held_out_frames"], told["frames"]) == (["cam00"], [], 6)
    assert (told["format"], len(told["cameras"]), told["warnings"]) == ("n3dv", 4, [])
    told = check(run("info", filmed, "--check", "--json")[1], "info_capture")
    assert told["found"] and sum("matches" in line for line in told["check"]) >= 2
    assert any(line.startswith("cam01: blur") for line in told["check"])
    assert "48 x 36" in run("info", filmed)[1]


def test_render_export_and_import(run: Run, tmp_path: Path) -> None:
    scene = scene_file()
    write_scene(tmp_path / "x.frog", scene)
    options = ("--camera", scene.header.cameras[0].name, "--frames", "1:3", "--step", "0.5", "--json")
    status, out, err = run("render", tmp_path / "x.frog", *options, "--out", tmp_path / "images")
    told = check(out, "render")
    assert status == 0 and "3 images in" in err
    assert [Path(each["path"]) for each in told["frames"]] == sorted((tmp_path / "images").iterdir())
    rate = scene.header.frames_per_second
    assert [(each["frame"], each["seconds"]) for each in told["frames"]] == [(f, f / rate) for f in (1, 1.5, 2)]
    told = check(run("export", tmp_path / "x.frog", "--frames", "1:3", "--out", tmp_path / "o", "--json")[1], "render")
    files = [tmp_path / "o" / "x_0001.ply", tmp_path / "o" / "x_0002.ply"]
    assert [(Path(each["path"]), each["frame"]) for each in told["frames"]] == list(zip(files, (1, 2), strict=True))
    assert told["bytes"] == sum(file.stat().st_size for file in files)
    page = tmp_path / "x.html"
    told = check(run("export", tmp_path / "x.frog", "--html", "--out", page, "--json")[1], "render")
    assert told["bytes"] == page.stat().st_size and len(told["frames"]) == scene.header.frame_count
    site = tmp_path / "site"
    told = check(run("export", tmp_path / "x.frog", "--html", "--folder", "--out", site, "--json")[1], "render")
    assert told["bytes"] == sum(file.stat().st_size for file in site.iterdir())
    told = check(run("import", files[0], "--packed", "--json")[1], "import")
    header = read_scene(Path(told["scene"])).header
    assert (header.method, header.frame_count, header.cameras) == ("static", told["frames"], ()) and told["frames"] == 1
    assert Path(told["scene"]).stat().st_size < 0.7 * files[0].stat().st_size, "packed"


def test_train(run: Run, filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    scene = tmp_path / "y.frog"
    options = ("--recipe", "draft", "--method", "static", "--steps", "4", "--json")
    status, out, err = run("train", filmed, "--out", scene, *options)
    told = check(out, "train")
    assert (status, told["scene"], told["is_finished"], told["steps"]) == (0, str(scene), True, 4) and "4 steps" in err
    assert (told["split"], told["bytes"]) == ("held-out", scene.stat().st_size) and told["psnr_db"] > 0
    status, out, _ = run("train", filmed, "--out", scene, *options)
    assert (status, out) == (2, ""), "what failed prints nothing"


def test_events_and_equal_files(run: Run, filmed: Path, tmp_path: Path) -> None:
    small = recipe("draft", capacity="auto", max_gaussians=300)
    options = {"recipe": small, "steps": 24, "seeds": film.seeds(), "device": "cpu"}
    job = TrainingJob(filmed, tmp_path / "x.frog", **options)
    stream = list(run_training(job))
    lines = [events.line_of(event) for event in stream]
    told = [check(line, "event") for line in lines if line is not None]
    assert told[-1]["event"] == "finished"
    assert {reduction["what"] for reduction in told[-1]["capacity"]["reductions"]} <= {"pruned", "frozen", "packed"}
    other = replace(job, output=tmp_path / "again.frog")
    list(run_training(other))
    assert other.output.read_bytes() == job.output.read_bytes(), "no wall time is in a scene"
    assert read_scene(job.output).header.steps == 24
    scene = check(run("info", job.output, "--json")[1], "info_scene")
    assert scene["training_seconds"] == pytest.approx(stream[-1].seconds)
    played = ScenePlayer.load(job.output)
    assert (scene["gaussians"], scene["dynamic_gaussians"]) == (played.count, played.num_dynamic)
    assert (scene["method"], scene["frames"], scene["bytes"]) == ("frog", 6, job.output.stat().st_size)
    assert scene["steps"] == 24 and scene["cameras"][3]["name"] == "cam03" and scene["sh_degree"] in (0, 1)
    assert (
        "packed" in {reduction["what"] for reduction in scene["reductions"]} and "costs" in run("info", job.output)[1]
    )
    job.output.with_name(f"{job.output.name}.checkpoint").unlink()
    assert check(run("info", job.output, "--json")[1], "info_scene")["training_seconds"] is None
