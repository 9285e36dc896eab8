"""The file of edits: what is written is read, and what is damaged is said in a sentence."""

import json

import numpy as np
import pytest
from support.builders import scene_file
from support.solids import CORNERS, FACES

from frog_blender.engine.editing.closed_mesh import ClosedMesh
from frog_blender.engine.editing.crops import Crop
from frog_blender.engine.editing.edits import Edits, Timing
from frog_blender.engine.editing.edits_file import load_edits, save_edits
from frog_blender.engine.editing.grades import Grade
from frog_blender.engine.editing.marks import Marks
from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.player import ScenePlayer

NO_MESH = {"vertices": [0] * 12, "triangles": [0, 1, 9] * 4}
PLACE = tuple(np.diag([0.8, 0.9, 1.1, 1.0]).ravel().tolist())


@pytest.fixture
def scene():
    return ScenePlayer(scene_file(100))


@pytest.fixture
def edits(scene):
    some = np.arange(100) % 4 == 0
    return Edits(
        Marks.of(scene, some),
        (
            Crop("box", PLACE, feather=0.25),
            Crop("sphere", PLACE, False, time=0.5),
            Crop("mesh", PLACE, mesh=ClosedMesh.of(CORNERS * 3, FACES)),
        ),
        (Grade(exposure=0.7, offsets=(0.1, 0.0, -0.1)), Grade(saturation=0.1, only=Marks.of(scene, ~some))),
        Timing((None, 0.0, 0.5, 1.25, 6.0, 3.0, None), 24.0, 10),
    )


def test_what_is_written_is_read(tmp_path, edits):
    save_edits(tmp_path / "e.json", edits)
    assert load_edits(tmp_path / "e.json") == edits
    assert Edits(timing=edits.timing).are_none, "a retiming changes no frame by itself"
    save_edits(tmp_path / "none.json", Edits(grades=(Grade(),) * 101))  # which change nothing
    assert load_edits(tmp_path / "none.json") == Edits()


@pytest.mark.parametrize(
    ("edits", "said"),
    [
        (Edits(crops=(Crop("box", PLACE),) * 101), "crops"),
        (Edits(grades=(Grade(exposure=1),) * 101), "grades"),
        (Edits(crops=(Crop("box", PLACE, feather=1e10),)), "feather"),
        (Edits(Marks(8, "x" * 65, bytes(1))), "scene"),
    ],
)
def test_what_could_not_be_read_is_not_written(tmp_path, edits, said):
    with pytest.raises(FrogError, match=f"could not be read again: .*{said}"):
        save_edits(tmp_path / "e.json", edits)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        ("frog_edits", 2, "frog_edits"),
        ("surprise", 1, "surprise"),
        ("crops", [{"shape": "box"}], "matrix"),
        ("crops", [{"shape": "cone", "matrix": list(PLACE)}], "shape"),
        ("crops", [{"shape": "box", "matrix": list(PLACE), "feather": -1}], "feather"),
        ("crops", [{"shape": "box", "matrix": [0] * 16}], "flattened"),
        ("crops", [{"shape": "mesh", "matrix": list(PLACE), **NO_MESH}], "not there"),
        ("crops", {}, "crops"),
        ("grades", [{"exposure": "bright"}], "exposure"),
        ("grades", [{"gains": [1, 2]}], "gains"),
        ("time", {"rate": 24, "frames": []}, "a timing of 0 frames"),
        ("time", {"rate": 24, "frames": [0, None, 1]}, "shows nothing between"),
        ("time", {"rate": 0, "frames": [0]}, "at 0 frames a second"),
        ("time", {"rate": 24, "frames": ["a"]}, "frame = a"),
        ("time", {"rate": 24, "frames": {}}, "frames"),
        ("time", {"rate": 24, "frames": [0], "start": 0.5}, "start"),
        ("time", [], "a timing"),
        ("hidden", {"count": 10, "scene": "x", "bits": "!"}, "damaged"),
        ("hidden", {"count": 2**60, "scene": "x", "bits": ""}, "count"),
    ],
)
def test_what_cannot_be_is_said(tmp_path, where, value, said):
    path = tmp_path / "e.json"
    path.write_text(json.dumps({"frog_edits": 1, where: value}))
    with pytest.raises(FrogError, match=said) as error:
        load_edits(path)
    assert str(path) in str(error.value)


def test_packed_marks_take_no_more_memory_than_they_say(scene):
    bomb = Marks(8 * 10**7, "x", bytes(10**7)).to_text()
    with pytest.raises(ValueError, match="from other than"):
        Marks.from_text(64, "x", bomb)
