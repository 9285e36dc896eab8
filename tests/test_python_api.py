"""The public Python API: what its page and its notebook show works."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from support.builders import REPOSITORY, run_python, scene_file

from frog_blender import engine as frog
from frog_blender.engine.scene.scene_file import write_scene

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


def test_playing_and_rendering_import_no_torch(tmp_path: Path) -> None:
    write_scene(tmp_path / "x.frog", scene_file())
    code = f"""
import sys
sys.modules["torch"] = None
from frog_blender import engine as frog
scene = frog.load_scene({str(tmp_path / "x.frog")!r})
drawing = frog.render(scene, scene.header.cameras[0], time=0.5)
print(drawing.rgb.shape, drawing.rgb.dtype, drawing.alpha.shape)
"""
    run = run_python(code)
    camera = frog.load_scene(tmp_path / "x.frog").header.cameras[0]
    size = (camera.height, camera.width)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == f"{(*size, 3)} float32 {size}"


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
    with pytest.raises(frog.FrogError, match=r"x\.frog"):
        frog.train(capture, tmp_path / "x.frog", **options)


def test_the_notebook_runs(filmed: Path, tmp_path: Path, own_cache: Path) -> None:
    """On a small capture, for a few steps."""
    code = notebook_code()
    assert "STEPS = 400" in code and "scale=0.25" in code
    code = code.replace("STEPS = 400", "STEPS = 10").replace("scale=0.25", "scale=1.0, max_gaussians=250")
    (tmp_path / "captures").mkdir()
    (tmp_path / "captures" / "room").symlink_to(filmed, target_is_directory=True)
    script = f"import os, matplotlib\nos.chdir({str(tmp_path)!r})\nmatplotlib.use('Agg')\n{code}"
    run = run_python(script)
    assert run.returncode == 0, run.stderr
    assert re.search(r"held-out: \d+\.\d\d dB", run.stdout) and (tmp_path / "room.frog").is_file()


def test_an_image_of_another_background_differs_where_nothing_covers(tmp_path: Path) -> None:
    write_scene(tmp_path / "x.frog", scene_file())
    scene = frog.load_scene(tmp_path / "x.frog")
    camera = scene.header.cameras[0]
    black, white = (frog.render(scene, camera, 0.0, background=(value,) * 3) for value in (0.0, 1.0))
    np.testing.assert_allclose(white.rgb - black.rgb, np.repeat(1 - black.alpha[..., None], 3, axis=2), atol=1e-5)
