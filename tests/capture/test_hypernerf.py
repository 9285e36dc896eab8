"""HyperNeRF and Nerfies folders: their lenses, splits, times, points, and what makes no sense."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.filmed_scene import HEIGHT, WIDTH, image
from support.layouts import moving_rigs

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.seeds import SeedSettings, find_seeds
from frog_blender.engine.frames.store import FrameStore

from .readers.reading import assert_same_cameras, assert_same_images, opened, refuses

NO_LENS: dict[str, Any] = {"radial_distortion": [0.0] * 3, "tangential_distortion": [0.0] * 2}


def put(folder: Path, name: str, data: Any) -> None:
    (folder / name).write_text(json.dumps(data))


def change(folder: Path, name: str, **changes: Any) -> None:
    """Keys of a JSON file set anew, or dropped for None."""
    data = {**json.loads((folder / name).read_text()), **changes}
    put(folder, name, {key: value for key, value in data.items() if value is not None})


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A "vrig" folder."""
    moving_rigs.hypernerf(tmp_path / "vrig-chicken")
    return tmp_path / "vrig-chicken"


def test_of_a_rig_one_camera_trains_and_the_other_judges_by_turns(rig: Path) -> None:
    capture = open_capture(rig)
    assert capture.frame_count == 6 and len(capture.shots) == len(capture.cameras) == 12
    train = {(capture.cameras[shot.camera].name, shot.frame) for shot in capture.train_shots}
    assert train == {(f"{f + 1:06d}_{'left' if f % 2 == 0 else 'right'}", f) for f in range(6)}
    assert sum(map(capture.is_test, capture.shots)) == 6
    assert capture.is_moving  # no two training images share a frame
    assert capture.near_far == (0.8, 16.0)  # scene.json's, in world units
    assert not capture.warnings


@pytest.mark.parametrize("lens", [{}, {"skew": 8.0, **NO_LENS}, {"skew": 0.0, **NO_LENS}], ids=["all", "skew", "none"])
def test_cameras_are_those_of_the_straight_images(tmp_path: Path, lens: dict[str, Any]) -> None:
    cameras = moving_rigs.hypernerf(tmp_path / "c", frames=2, **lens)
    capture = opened(tmp_path / "c", "hypernerf")
    assert_same_cameras(capture, cameras)
    is_straight = lens.get("skew") == 0
    assert (capture.distortions[0] is None) == is_straight
    assert_same_images(capture, tmp_path / "cache", image, off=0.0 if is_straight else 5.0)


def test_the_first_nerfies_captures_have_another_key(rig: Path) -> None:
    (before,) = {lens.coefficients.tobytes() for lens in open_capture(rig).distortions if lens}
    for file in (rig / "camera").iterdir():
        change(rig, f"camera/{file.name}", tangential_distortion=None, tangential=[0.01, -0.02])
    assert {lens.coefficients.tobytes() for lens in open_capture(rig).distortions if lens} == {before}


def test_without_2x_the_largest_images_that_fit_are_taken(tmp_path: Path) -> None:
    moving_rigs.hypernerf(tmp_path / "c", frames=2)
    shutil.copytree(tmp_path / "c" / "rgb" / "2x", tmp_path / "c" / "rgb" / "8x")
    (tmp_path / "c" / "rgb" / "2x").rename(tmp_path / "c" / "rgb" / "4x")
    capture = open_capture(tmp_path / "c")
    assert (capture.cameras[0].width, capture.cameras[0].height) == (WIDTH, HEIGHT)
    assert any("rgb/2x, those of rgb/4x" in warning for warning in capture.warnings)


def test_a_single_camera_without_a_split_is_split_as_the_papers_do(rig: Path) -> None:
    ids = [f"{frame + 1:06d}_{side}" for side in ("left", "right") for frame in range(6)]
    put(rig, "dataset.json", {"ids": ids, "train_ids": ids, "val_ids": []})
    capture = open_capture(rig)
    assert [capture.cameras[s.camera].name for s in capture.train_shots] == [ids[0], ids[8], ids[4]]  # by frame
    assert capture.test_cameras == {ids[2], ids[6], ids[10]}
    assert "of every four images" in capture.warnings[0]


def test_an_image_in_both_lists_is_never_trained_on(rig: Path) -> None:
    data = json.loads((rig / "dataset.json").read_text())
    change(rig, "dataset.json", train_ids=[*data["train_ids"], data["val_ids"][0]])
    capture = open_capture(rig)
    assert data["val_ids"][0] in capture.test_cameras
    assert len(capture.train_shots) == sum(map(capture.is_test, capture.shots)) == 6
    assert "1 of the train_ids are also in val_ids" in capture.warnings[0]


def test_time_id_comes_before_warp_id_and_even_steps_are_frames(rig: Path) -> None:
    data = json.loads((rig / "metadata.json").read_text())
    put(rig, "metadata.json", {name: {**entry, "time_id": 10 + 4 * entry["warp_id"]} for name, entry in data.items()})
    assert [shot.frame for shot in open_capture(rig).shots] == [f for f in range(6) for _ in range(2)]
    some = {name: {**entry, "time_id": 0} if entry["warp_id"] else entry for name, entry in data.items()}
    put(rig, "metadata.json", some)  # not all have one: warp_id it is
    assert open_capture(rig).frame_count == 6


def test_a_gap_in_time_stays_a_gap(rig: Path) -> None:
    for side in ("left", "right"):
        (rig / f"rgb/2x/000003_{side}.png").unlink()
    capture = open_capture(rig)
    assert capture.frame_count == 6
    assert {shot.frame for shot in capture.shots} == {0, 1, 3, 4, 5}
    assert "2 of 12 listed images (the first is 000003_left)" in capture.warnings[0]


def test_points_become_seeds(rig: Path, tmp_path: Path) -> None:
    spot, random = np.array([0.35, -0.2, 4.5]), np.random.default_rng(0)
    cloud = random.uniform([-1.0, -0.7, 3.0], [1.5, 0.7, 6.0], (400, 3))
    np.save(rig / "points.npy", np.concatenate([spot[None], cloud]).astype(np.float32))
    capture = open_capture(rig)
    assert capture.near_far is not None and 1.5 < capture.near_far[0] < 4.0 < 6.0 < capture.near_far[1] < 12.0
    seeds = find_seeds(capture, FrameStore.open(capture, cache_folder=tmp_path / "cache"), SeedSettings(2000))
    assert "given" in seeds.origin
    assert np.linalg.norm(seeds.points - spot, axis=1).min() < 1e-3


@pytest.mark.parametrize(
    ("name", "changes", "sentence"),
    [
        ("camera/000001_left.json", {"focal_length": None}, r"000001_left\.json: found nothing as focal_length"),
        ("camera/000001_left.json", {"image_size": [96, 128]}, "64 x 48 pixels .* of the calibration, 96 x 128"),
        ("dataset.json", {"train_ids": ["../a"]}, "image name '../a' in train_ids"),
        ("dataset.json", {"val_ids": "all"}, "val_ids that is not a list"),
        ("dataset.json", {"train_ids": []}, "no image to train on"),
        ("dataset.json", {"train_ids": ["x"], "val_ids": ["y"]}, "none of the listed images, expected them in rgb/2x"),
        ("metadata.json", {"000002_right": None}, "nothing about the image 000002_right"),
        ("metadata.json", {"000002_right": {"warp_id": 0.5}}, "warp_id with a fraction"),
        ("metadata.json", {"000002_right": {"appearance_id": 1}}, "nothing as warp_id of 000002_right"),
        ("scene.json", {"near": 9.0}, "near = 9 and far = 8"),
        ("metadata.json", {"000002_right": {"warp_id": 10**12}}, r"warp_ids, .* to 1000000000000, expected at most"),
        ("camera/000001_left.json", {"focal_length": 1e9, "pixel_aspect_ratio": 1e9}, "a focal length of"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(
    rig: Path, name: str, changes: dict[str, Any], sentence: str
) -> None:
    change(rig, name, **changes)
    refuses(rig, sentence)


@pytest.mark.parametrize("missing", ["metadata.json", "rgb"])
def test_a_missing_part_is_named(rig: Path, missing: str) -> None:
    (rig / missing).rename(rig / "elsewhere")
    refuses(rig, missing)


def test_points_of_another_shape_and_pickles_are_refused(rig: Path) -> None:
    np.save(rig / "points.npy", np.zeros((4, 2)))
    refuses(rig, r"points\.npy: found float64 of shape \(4, 2\)")
    np.save(rig / "points.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    refuses(rig, "not a NumPy array")


def test_points_from_nowhere_are_left_out(rig: Path) -> None:
    np.save(rig / "points.npy", np.array([[0, 0, 4], [np.nan, 0, 0], [0, np.inf, 0], [0, 0, -1e300]]))
    np.testing.assert_array_equal(open_capture(rig).points, [[0, 0, 4]])
