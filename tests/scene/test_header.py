"""A scene's header: every value that nobody could play, draw or import is refused, and the sentence names it."""

import copy
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import refused, scene_file

from frog_blender.engine.capture.camera import MAX_PIXELS, Camera
from frog_blender.engine.capture.masking import MaskSettings
from frog_blender.engine.field.names import CANONICAL
from frog_blender.engine.io import plain_values
from frog_blender.engine.playback.player import ScenePlayer, select_gaussians
from frog_blender.engine.scene import scene_file as scene_files
from frog_blender.engine.scene.header import MAX_FRAMES, MOST_STANDING, SceneHeader
from frog_blender.engine.scene.scene_file import SceneFile, read_scene

Data = dict[str, Any]
PLAIN: Data = json.loads(replace(scene_file().header, low_pass=0.3).to_json())
REPORT = {"gaussians": 5, "dynamic": 2, "sh_degree": 1, "reductions": []}


def written(path: Path, data: Data) -> Path:
    """A file whose header says that."""
    path.write_bytes(scene_files.serialize(scene_file().arrays, metadata={"frog": json.dumps(data)}))
    return path


def top(**values: Any) -> Callable[[Data], None]:
    return lambda data: data.update(values)


def camera(**values: Any) -> Callable[[Data], None]:
    return lambda data: data["cameras"][1].update(values)


def lens(row: int, column: int, value: float) -> Callable[[Data], None]:
    return lambda data: data["cameras"][1]["intrinsics"][row].__setitem__(column, value)


def pose(row: int, column: int, value: float) -> Callable[[Data], None]:
    return lambda data: data["cameras"][1]["world_to_camera"][row].__setitem__(column, value)


def without(name: str) -> Callable[[Data], None]:
    return lambda data: data.pop(name)


NOT_NUMBERS = [None, "7", [], True, math.nan, math.inf, 10**400, -1, 1e308]
REFUSED: list[tuple[str, Callable[[Data], Any]]] = [
    *[("frame_count", top(frame_count=value)) for value in (*NOT_NUMBERS, 0, 7.0, MAX_FRAMES + 1, 10**18)],
    *[("frames_per_second", top(frames_per_second=value)) for value in (*NOT_NUMBERS, 0)],
    *[("scale", top(scale=value)) for value in (*NOT_NUMBERS, 0)],
    *[("steps", top(steps=value)) for value in (*NOT_NUMBERS, 1.5)],
    *[(name, top(**{name: value})) for name in ("low_pass",) for value in NOT_NUMBERS],
    *[("background", top(background=value)) for value in (None, [0.1, 0.2], [0, 0, math.nan], [0, 0, 1e9], "abc", 3)],
    *[("version", top(format_version=value)) for value in (None, 0, 2, -1, "1", 1.0, True)],
    *[("method", top(method=value)) for value in (None, "nerf", 5, ["frog"])],
    *[("cameras", top(cameras=value)) for value in (None, {}, "abc")],
    *[("camera", top(cameras=[value] * 3)) for value in (None, {}, [], {"name": "a"})],
    *[("camera_shots", top(camera_shots=value)) for value in (None, [], [[0]] * 2, [[0], [1], 2], [[0], [1], [True]])],
    *[("test_frames", top(test_frames=value)) for value in (None, [None], [-1], [2**40], "12")],
    *[("test_cameras", top(test_cameras=value)) for value in (None, [None], "odd", [["odd"]], ["x" * 5000])],
    *[("pixel", top(pixel_offsets=value)) for value in (None, [], {"a": [1]}, {"a": [1, math.nan]}, {"a": "12"})],
    *[("capture_path", top(capture_path=value)) for value in (None, 5, ["a"], "x" * 40_000)],
    *[(name, top(**{name: value})) for name in ("recipe", "metrics", "made_of") for value in (None, [], 5, "a")],
    *[(name, top(**{name: {"a": {"b": 10**400}}})) for name in ("recipe", "metrics", "model")],
    *[("capacity", top(capacity=REPORT | {"reductions": value})) for value in (5, [5], [{"what": "x"}])],
    *[("capacity", top(capacity=value)) for value in (5, [1], {"gaussians": "many"}, REPORT | {"sh_degree": []})],
    *[("world", top(world=value)) for value in (None, [], {"origin": [0, 0, 0]}, {"origin": "abc", "unit": 1})],
    *[("unit", top(world={"origin": [0, 0, 0], "unit": value})) for value in (*NOT_NUMBERS, 0, -1)],
    *[("width", camera(width=value)) for value in (*NOT_NUMBERS, 0, 65_537, 2**31, 2**31 + 16, 32.0)],
    *[("height", camera(height=value)) for value in (*NOT_NUMBERS, 0, 600_000)],
    ("pixels", camera(width=65_536, height=MAX_PIXELS // 65_536 + 1)),
    *[("name", camera(name=value)) for value in (None, 5, ["a"], "x" * 5000)],
    *[("exposure", camera(exposure=value)) for value in (None, [1, 1], [1, 1, 0], [1, -1, 1], [1, 1, math.nan])],
    *[("intrinsics", camera(intrinsics=value)) for value in (None, [[1]], "abc", np.eye(4).tolist(), [1.0] * 9)],
    *[("intrinsics", lens(*value)) for value in ((0, 0, 0), (1, 1, -5), (0, 2, math.nan), (2, 0, 16), (2, 2, 0))],
    *[("pose", pose(*value)) for value in ((0, 0, -1), (0, 0, 2), (0, 3, math.inf), (3, 3, 0), (1, 0, 0.5))],
    *[(name, without(name)) for name in PLAIN],
]


@pytest.mark.parametrize("named", dict.fromkeys(named for named, _ in REFUSED))
def test_what_cannot_be_is_refused_by_its_name(tmp_path: Path, named: str) -> None:
    for lie in (lie for name, lie in REFUSED if name == named):
        data = copy.deepcopy(PLAIN)
        lie(data)
        path = written(tmp_path / "x.frog", data)
        sentence = refused(".", read_scene, path)
        assert sentence.startswith(f"{path}: found ") and ", expected " in sentence
        assert named in sentence and sentence.isprintable() and len(sentence) < 1000


ODD: list[Callable[[Data], Any]] = [
    camera(width=65_536, height=1),
    camera(name="Küche 厨房 👩‍💻 ‌نیم"),
    camera(exposure=[0.5, 1, 2]),
    top(frames_per_second=30),
    top(frames_per_second=1 / 3600),
    top(frame_count=MAX_FRAMES),
    top(test_frames=[0, 6]),
    top(metrics={"psnr": None, "split": "training", "cameras": {"odd": [1, 2.5]}}),
    top(background=[1, 1, 1]),
    top(world={"origin": [448263.0, 5411933.0, 312.0], "unit": 0.001}),
    lens(0, 1, 0.3),
    pose(0, 3, -5e6),
]


@pytest.mark.parametrize("change", ODD)
def test_what_is_merely_odd_is_read(tmp_path: Path, change: Callable[[Data], Any]) -> None:
    data = copy.deepcopy(PLAIN)
    change(data)
    header = read_scene(written(tmp_path / "x.frog", data)).header
    again = json.loads(header.to_json())
    assert again == data


def test_names_lose_their_control_characters_and_stay_names(tmp_path: Path) -> None:
    data = copy.deepcopy(PLAIN)
    data["cameras"][0]["name"] = "cam\x1b[2J\n\ud800"
    data |= {"test_cameras": ["cam\x1b[2J\n\ud800"], "capture_path": "/a\0b/\x07", "capture_format": "n3\rdv"}
    data["pixel_offsets"] = {"cam\x1b[2J\n\ud800": [1, 2]}
    header = read_scene(written(tmp_path / "x.frog", data)).header
    assert header.cameras[0].name == "cam\\x1b[2J\\n\\ud800" and header.is_test(header.cameras[0].name, 0)
    assert header.pixel_offsets == {header.cameras[0].name: (1.0, 2.0)}
    assert (header.capture_path, header.capture_format) == ("/a\\x00b/\\x07", "n3\\rdv")
    own = Camera("cam\x1b[2J\n\ud800", 8, 8, np.eye(3), np.eye(4))
    assert own.name == header.cameras[0].name, "a capture's reader and a scene's say the same name"


def test_many_cameras_have_to_be_a_moving_one(tmp_path: Path) -> None:
    data, one = copy.deepcopy(PLAIN), PLAIN["cameras"][1]
    data |= {"cameras": [one | {"name": f"image {k}"} for k in range(MOST_STANDING + 1)], "test_cameras": []}
    data["camera_shots"] = [[k] for k in range(MOST_STANDING + 1)]
    assert read_scene(written(tmp_path / "x.frog", data)).header.is_moving
    data["camera_shots"][0] = [0, 1]
    refused(f"{MOST_STANDING + 1} cameras that do not move", read_scene, written(tmp_path / "x.frog", data))


def test_a_header_of_too_many_lists_is_not_even_parsed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plain_values, "_MOST_LISTS", 1000)
    path = written(tmp_path / "x.frog", PLAIN | {"recipe": [[] for _ in range(1000)]})
    refused("lists, expected fewer", read_scene, path)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "5", '"frog"', "[" * 100_000, "\ud800"])
def test_a_header_that_is_no_object(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match="header"):
        SceneHeader.from_json(text)


def test_arrays_that_no_scene_of_its_method_has_are_passed_over(tmp_path: Path) -> None:
    """They are not there for those who pick some of the Gaussians either."""
    foreign = {"lifetimes": np.zeros((3, 5), np.uint8), "surprise": np.ones(7, np.float32)}
    scene = scene_file()
    still = {name: array for name, array in scene.arrays.items() if name in CANONICAL}
    header = replace(scene.header, method="static", model={})
    scene_files.write_scene(
        tmp_path / "x.frog", SceneFile(header, still | foreign | {"embeddings": np.ones(3, np.float32)})
    )
    actual = read_scene(tmp_path / "x.frog")
    assert actual.arrays.keys() == CANONICAL
    assert len(select_gaussians(actual, np.arange(5)).arrays["means"]) == 5
    assert ScenePlayer(actual).subset(np.arange(5)).at(0.5).means.shape == (5, 3)


@pytest.mark.parametrize(("name", "kind"), [("means", np.float64), ("sh", np.float16), ("embeddings", np.int32)])
def test_arrays_of_another_type_are_refused(tmp_path: Path, name: str, kind: type) -> None:
    scene = scene_file()
    scene.arrays[name] = scene.arrays[name].astype(kind)
    scene_files.write_scene(tmp_path / "x.frog", scene)
    refused(f"{name} of type {np.dtype(kind)}, expected float32", read_scene, tmp_path / "x.frog")


@pytest.mark.parametrize("name", ["recipe", "model", "pixel_offsets", "metrics", "capacity"])
def test_a_header_changes_with_nothing(name: str) -> None:
    """Neither through its own mappings nor through those that it was made of."""
    given: dict[str, Any] = {"a": 1}
    header = replace(scene_file().header, **{name: given})
    given["b"] = 2
    assert getattr(header, name) == {"a": 1}
    with pytest.raises(TypeError):
        getattr(header, name)["c"] = 3


def test_what_was_made_of_masks_is_kept_and_checked() -> None:
    header = replace(scene_file().header, masks=MaskSettings(use=False, key="#00b140,0.4"))
    assert SceneHeader.from_json(header.to_json()).masks == header.masks
    assert "masks" not in PLAIN and SceneHeader.from_json(json.dumps(PLAIN)).masks == MaskSettings()
    for masks, said in (({"use": 3}, "use of masks = 3"), ({"key": 5}, "key of masks"), ([], "masks")):
        with pytest.raises(ValueError, match=said):
            SceneHeader.from_json(json.dumps({**PLAIN, "masks": masks}))
