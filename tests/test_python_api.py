"""The public Python API: what its page and its notebook show works."""

import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import REPOSITORY, printed, refused, run_python, scene_file

from frog_blender import engine as frog
from frog_blender.engine.scene.scene_file import write_scene
from frog_blender.engine.training.session import events

PAGE = REPOSITORY / "docs" / "python-api.md"
NOTEBOOK = REPOSITORY / "examples" / "notebook.ipynb"


def notebook_code() -> str:
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")


def test_what_is_public_is_what_is_there() -> None:
    assert set(frog.__all__) <= set(dir(frog))
    for name in frog.__all__:
        value = getattr(frog, name)
        assert value.__doc__ and value.__name__ == name
    with pytest.raises(AttributeError, match="has no attribute 'rendr'"):
        frog.rendr  # noqa: B018


def test_the_page_names_what_is_public() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert {name for name in frog.__all__ if name not in ("Shot", "CameraMetrics")} <= set(re.findall(r"\w+", text))


def test_train_evaluate_resume(filmed: Path, tmp_path: Path, own_cache: Path) -> None:
    capture = frog.open_capture(filmed)
    events: list[object] = []
    options = {"recipe": "draft", "steps": 12, "on_event": events.append}
    stopped = frog.train(capture, tmp_path / "x.frog", cancelled=lambda: len(events) > 5, **options)
    assert not stopped.finished
    result = frog.train(filmed, tmp_path / "x.frog", resume=stopped.path is not None, overwrite=True, **options)
    assert result.finished and result.path == tmp_path / "x.frog" and result.steps == 12
    scene = frog.load_scene(tmp_path / "x.frog")
    assert scene.count == result.num_gaussians > 0
    metrics = frog.evaluate(scene, capture)
    assert metrics.split == "held-out" and result.psnr == pytest.approx(metrics.psnr, abs=0.2)
    assert set(metrics.cameras) == {camera.name for camera in capture.cameras} & set(capture.test_cameras)
    by_path = frog.evaluate(scene, filmed, split="training")
    assert by_path.split == "training" and by_path.images == len(capture.train_shots)
    refused(r"x\.frog", frog.train, capture, tmp_path / "x.frog", **options)


def test_the_papers_figures(filmed: Path, tmp_path: Path, own_cache: Path) -> None:
    result = frog.train(filmed, tmp_path / "x.frog", recipe="draft", steps=4)
    script = [sys.executable, str(REPOSITORY / "examples" / "figures.py"), str(result.path), str(filmed)]
    printed(subprocess.run([*script, str(tmp_path / "out")], capture_output=True, text=True))
    panels = {path.stem: cv2.imread(str(path)) for path in (tmp_path / "out").glob("*.png")}
    assert len(panels) == 11 and {panels.pop("figures").shape[0]} == {4 * panels["truth"].shape[0]}
    assert len({panel.shape for panel in panels.values()}) == 1
    error = np.abs(panels["truth"].astype(float) - panels["render"]).mean(2)
    heat = panels["render_difference"].astype(int).sum(2)
    assert heat[error < 1].max() < heat[error > 30].min(), "dark where the render is right, bright where it is not"
    run = subprocess.run([*script, str(tmp_path), "--camera", "nobody"], capture_output=True, text=True)
    assert run.returncode == 1 and "no image of camera nobody" in run.stderr


A_SCENE = scene_file()


@pytest.fixture
def without_decoding(monkeypatch: pytest.MonkeyPatch) -> None:
    def decode(*_: object, **__: object) -> None:
        raise AssertionError("images were decoded")

    monkeypatch.setattr(frog.FrameStore, "open", decode)


@pytest.mark.parametrize(
    ("function", "wrong", "sentence"),
    [
        ("train", {"steps": np.float64(2.5)}, "steps is 2.5, expected none, or a whole number from 1"),
        ("train", {"seed": np.int64(-1)}, "seed is -1, expected"),
        ("train", {"recipe": "drafd"}, "recipe is 'drafd', expected one of draft"),
        ("train", {"settings": {"network_rat": 1}}, "no setting 'network_rat'; the nearest is 'network_rate'"),
        ("train", {"sinks": "csv"}, "sinks is 'csv', expected a list of names"),
        ("train", {"sinks": ["none"]}, "There is no sink 'none'"),
        ("train", {"on_event": 3}, "on_event is 3, expected none, or a function"),
        ("train", {"cancelled": None}, "cancelled is None, expected a function"),
        ("train", {"masks": "off"}, "masks: found a capture that is open already, expected its folder"),
        ("train", {"layout": "moving"}, "layout: found a capture that is open already, expected its folder"),
        ("render", {"scene": "x.frog"}, "scene is 'x.frog', expected a scene that load_scene has read"),
        ("render", {"camera": "cam00"}, "camera is 'cam00', expected a Camera"),
        ("render", {"time": math.nan}, "time is nan, expected a number from 0 to 1"),
        ("render", {"time": 2}, "time is 2, expected a number from 0 to 1"),
        ("render", {"background": (1, 2)}, "background is (1, 2), expected none, or three numbers from 0 to 1"),
        ("render", {"background": (0, math.nan, 0)}, "expected none, or three numbers from 0 to 1"),
        ("evaluate", {"split": "tset"}, "found the split tset, expected one of auto, held-out"),
        ("evaluate", {"split": 3}, "split is 3, expected a word"),
        ("evaluate", {"mask": 3}, "mask is 3, expected none, or a path"),
        ("evaluate", {"mask": "none.png"}, "none.png: found no file"),
        ("evaluate", {"metrics": "psnr"}, "metrics is 'psnr', expected a list of names"),
        ("evaluate", {"metrics": ["psrn"]}, "There is no metric 'psrn'"),
        ("evaluate", {"on_progress": 3}, "on_progress is 3, expected none, or a function"),
        ("open_capture", {"path": 3}, "path is 3, expected a path"),
        ("open_capture", {"pixel_offsets": 3}, "pixel_offsets is 3, expected"),
        ("open_capture", {"layout": "x"}, "layout is 'x', expected one of auto"),
        ("load_scene", {"path": None}, "path is None, expected a path"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_every_function_refuses_in_a_sentence(
    function: str, wrong: dict[str, object], sentence: str, filmed: Path, tmp_path: Path, without_decoding: None
) -> None:
    capture = frog.open_capture(filmed)
    header = replace(A_SCENE.header, cameras=capture.cameras, frame_count=capture.frame_count)
    scene = frog.ScenePlayer(replace(A_SCENE, header=header))
    right = {
        "train": {"capture": capture, "output": tmp_path / "x.frog"},
        "render": {"scene": scene, "camera": header.cameras[0]},
        "evaluate": {"scene": scene, "capture": capture},
        "open_capture": {"path": filmed},
        "load_scene": {},
    }[function]
    refused(re.escape(sentence), getattr(frog, function), **{**right, **wrong})
    assert not list(tmp_path.iterdir())


def test_numbers_of_numpy_are_numbers(filmed: Path) -> None:
    scene = frog.ScenePlayer(A_SCENE)
    camera, half = scene.header.cameras[0], np.float32(0.5)
    plain = frog.render(scene, camera, 0.5, background=(0.5, 0.5, 0.5))
    np.testing.assert_array_equal(frog.render(scene, camera, half, background=np.full(3, half)).rgb, plain.rgb)
    offset = {"cam00": (np.int64(1), np.float32(2))}
    assert frog.open_capture(filmed, pixel_offsets=offset).cameras != frog.open_capture(filmed).cameras
    assert frog.recipe("draft", network_rate=np.float32(0.5)).network_rate == 0.5


def test_what_is_told_prints_in_a_line(filmed: Path) -> None:
    image = np.zeros((48, 64, 3), np.uint8)
    report = {"gaussians": 1, "dynamic": 1, "sh_degree": 0, "reductions": [{"what": "pruned"}] * 50}
    for value in (
        frog.Finished("x.frog", 1, 1.0, 30.0, 1, report),
        events.Preview(1, image),
        frog.Metrics(1.0, 1.0, None, 1, split="held-out", cameras={"cam00": frog.CameraMetrics(1.0, 1.0, None, 1)}),
        frog.TrainResult(Path("x.frog"), True, 1),
        frog.open_capture(filmed),
        frog.ScenePlayer(A_SCENE),
    ):
        assert "\n" not in repr(value) and len(repr(value)) < 350, repr(value)


def test_the_notebook_runs(filmed: Path, tmp_path: Path, own_cache: Path) -> None:
    """On a small capture, for a few steps."""
    code = notebook_code()
    assert "STEPS = 400" in code and "scale=0.25" in code
    code = code.replace("STEPS = 400", "STEPS = 10").replace("scale=0.25", "scale=1.0, max_gaussians=250")
    (tmp_path / "captures").mkdir()
    (tmp_path / "captures" / "room").symlink_to(filmed, target_is_directory=True)
    script = f"import os, matplotlib\nos.chdir({str(tmp_path)!r})\nmatplotlib.use('Agg')\n{code}"
    assert re.search(r"held-out: \d+\.\d\d dB", printed(run_python(script))) and (tmp_path / "room.frog").is_file()


def test_an_image_of_another_background_differs_where_nothing_covers(tmp_path: Path) -> None:
    write_scene(tmp_path / "x.frog", scene_file())
    scene = frog.load_scene(tmp_path / "x.frog")
    camera = scene.header.cameras[0]
    black, white = (frog.render(scene, camera, 0.0, background=(value,) * 3) for value in (0.0, 1.0))
    np.testing.assert_allclose(white.rgb - black.rgb, np.repeat(1 - black.alpha[..., None], 3, axis=2), atol=1e-5)
