"""Opening, playing, drawing and evaluating a finished scene where importing torch fails, by commands and in Python."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import printed, run_python, scene_file
from support.synthetic_capture import FRAMES, rig

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw, to_uint8
from frog_blender.engine.scene.scene_file import SceneFile, write_scene

NO_TORCH = "import sys; sys.modules['torch'] = None; sys.modules['bpy'] = None\n"
COMMANDS = """
import json
from frog_blender.cli.main import main
for arguments in json.loads(sys.argv[1]):
    assert main(arguments) == 0
    print("END")
from frog_blender import engine as frog
scene = frog.load_scene(sys.argv[2])
print(frog.render(scene, scene.header.cameras[2], time=0.4).rgb.sum())
"""
COMMAND = "from frog_blender.cli.main import main; sys.exit(main(sys.argv[1:]))"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Fits the filmed capture's cameras and frames."""
    content = scene_file(60, opacity_reduction="paper")
    filmed = {"cameras": tuple(rig()), "camera_shots": (tuple(range(FRAMES)),) * 4, "frame_count": FRAMES}
    header = replace(content.header, test_cameras=("cam00",), **filmed)
    write_scene(tmp_path / "x.frog", SceneFile(header, content.arrays))
    return tmp_path / "x.frog"


def test_torch_really_is_missing_there() -> None:
    assert "halted" in run_python(NO_TORCH + "import torch").stderr


def test_render_eval_and_info(scene: Path, filmed: Path, own_cache: Path, tmp_path: Path) -> None:
    commands = [
        ["render", str(scene), "--camera", "cam02", "--frames", "1:3", "--out", str(tmp_path / "o")],
        ["eval", str(scene), str(filmed), "--json"],
        ["info", str(scene), "--json"],
    ]
    said = printed(run_python(NO_TORCH + COMMANDS, json.dumps(commands), scene))
    images = sorted((tmp_path / "o").iterdir())
    assert [path.name for path in images] == ["cam02_0001.png", "cam02_0002.png"]
    played = ScenePlayer.load(scene)
    expected = to_uint8(draw(played.at_frame(2), rig()[2], played.header.background).rgb)
    np.testing.assert_array_equal(cv2.imread(str(images[1]))[:, :, ::-1], expected)
    report, about, in_python = said.split("END\n")[1:]
    assert float(in_python) == pytest.approx(draw(played.at(0.4), rig()[2], played.header.background).rgb.sum())
    report = json.loads(report)
    assert (report["gaussians"], report["frames"], report["split"]) == (60, FRAMES, "held-out")
    assert json.loads(about)["gaussians"] == 60


def test_frog_train_says_what_is_missing(filmed: Path, tmp_path: Path) -> None:
    run = run_python(NO_TORCH + COMMAND, "train", filmed, "--out", tmp_path / "y.frog")
    assert run.returncode != 0
    assert "torch" in run.stderr and "Traceback" not in run.stderr
