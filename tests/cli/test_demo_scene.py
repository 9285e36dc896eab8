"""Full trainings of the bundled capture: slow, and what the project promises of it."""

from pathlib import Path

import pytest

from frog_blender.engine.evaluation.evaluate import evaluate_file
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

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
