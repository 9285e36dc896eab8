"""HyperNeRF and Nerfies folders, true to format and tiny, written here."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from frog_blender.engine.capture.decoding import decode_shots
from frog_blender.engine.capture.readers import detect, open_capture
from frog_blender.engine.capture.seeds import find_seeds
from frog_blender.engine.errors import FrogError
from frog_blender.engine.frames.store import FrameStore

WIDTH, HEIGHT = 192, 128  # of the 1x images
SPOT = np.array([0.35, -0.2, 4.0])  # a bright spot in the world


def rotation(angle: float) -> list[list[float]]:
    """A world-to-camera rotation about y: rows are the camera's axes."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return [[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]


def camera_json(**changes: Any) -> dict[str, Any]:
    """A camera file with nothing in the middle, nothing square and nothing straight."""
    plain = {
        "orientation": rotation(0.1),
        "position": [0.5, 0.1, -1.0],
        "focal_length": 230.0,
        "principal_point": [101.0, 59.0],
        "skew": 6.0,
        "pixel_aspect_ratio": 1.1,
        "radial_distortion": [-0.2, 0.08, 0.01],
        "tangential_distortion": [0.01, -0.02],
        "image_size": [WIDTH, HEIGHT],
    }
    return {**plain, **changes}


def stored_pixel(camera: dict[str, Any], point: np.ndarray) -> np.ndarray:
    """Where a Nerfies camera puts a world point in its 1x image, by the formulas of its format."""
    local = np.array(camera["orientation"]) @ (point - np.array(camera["position"]))
    x, y = local[:2] / local[2]
    k1, k2, k3 = camera["radial_distortion"]
    p1, p2 = camera.get("tangential_distortion", camera.get("tangential", [0.0, 0.0]))
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    x, y = (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y),
    )
    focal, (center_x, center_y) = camera["focal_length"], camera["principal_point"]
    column = focal * x + camera.get("skew", 0.0) * y + center_x
    return np.array([column, focal * camera.get("pixel_aspect_ratio", 1.0) * y + center_y])


def spot_image(pixel: np.ndarray, width: int, height: int) -> np.ndarray:
    """Black with a soft white spot at a pixel position (centres at +0.5)."""
    columns, lines = np.arange(width) + 0.5, np.arange(height)[:, None] + 0.5
    value = np.exp(-((columns - pixel[0]) ** 2 + (lines - pixel[1]) ** 2) / (2 * 2.0**2))
    return np.repeat((255 * value).round().astype(np.uint8)[..., None], 3, axis=2)


def centroid(image: np.ndarray) -> np.ndarray:
    weight = image[..., 0].astype(np.float64)
    columns, lines = np.arange(weight.shape[1]) + 0.5, np.arange(weight.shape[0]) + 0.5
    return np.array([weight.sum(0) @ columns, weight.sum(1) @ lines]) / weight.sum()


@dataclass
class Rig:
    """A "vrig" folder: two cameras, of which left and right train by turns."""

    path: Path
    frames: int = 6
    camera: dict[str, Any] = field(default_factory=camera_json)
    scales: tuple[int, ...] = (2,)

    def write(self, **dataset: Any) -> Path:
        ids, metadata = [], {}
        train, held_out = [], []
        (self.path / "camera").mkdir(parents=True, exist_ok=True)
        for frame in range(self.frames):
            for side in ("left", "right"):
                name = f"{frame + 1:06d}_{side}"
                ids.append(name)
                (train if (side == "left") == (frame % 2 == 0) else held_out).append(name)
                metadata[name] = {"warp_id": frame, "appearance_id": frame, "camera_id": int(side == "right")}
                position = [0.3 * frame + 0.1 * (side == "right"), 0.1, -1.0]
                camera = {**self.camera, "position": position}
                self.put(f"camera/{name}.json", camera)
                for scale in self.scales:
                    size = (WIDTH // scale, HEIGHT // scale)
                    folder = self.path / "rgb" / f"{scale}x"
                    folder.mkdir(parents=True, exist_ok=True)
                    cv2.imwrite(str(folder / f"{name}.png"), spot_image(stored_pixel(camera, SPOT) / scale, *size))
        lists = {"count": len(ids), "num_exemplars": len(train), "ids": ids, "train_ids": train, "val_ids": held_out}
        self.put("dataset.json", {**lists, **dataset})
        self.put("metadata.json", metadata)
        self.put("scene.json", {"scale": 0.5, "center": [1.0, 2.0, 3.0], "near": 0.4, "far": 8.0})
        return self.path

    def put(self, name: str, data: Any) -> None:
        (self.path / name).write_text(json.dumps(data))

    def change(self, name: str, **changes: Any) -> None:
        """Keys of a JSON file set anew, or dropped for None."""
        data = {**json.loads((self.path / name).read_text()), **changes}
        self.put(name, {key: value for key, value in data.items() if value is not None})


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    rig = Rig(tmp_path / "vrig-chicken")
    rig.write()
    return rig


def test_of_a_rig_one_camera_trains_and_the_other_judges_by_turns(rig: Rig) -> None:
    assert detect(rig.path) == "hypernerf"
    capture = open_capture(rig.path)
    assert capture.frame_count == 6
    assert len(capture.shots) == len(capture.cameras) == 12
    sides = {"left": [], "right": []}  # type: ignore[var-annotated]
    for shot in capture.train_shots:
        sides[capture.cameras[shot.camera].name.split("_")[1]].append(shot.frame)
    assert sides == {"left": [0, 2, 4], "right": [1, 3, 5]}
    test = {(capture.cameras[shot.camera].name, shot.frame) for shot in capture.test_shots}
    assert test == {(f"{f + 1:06d}_{'right' if f % 2 == 0 else 'left'}", f) for f in range(6)}
    assert capture.is_moving  # no two training images share a frame
    assert capture.near_far == (0.8, 16.0)  # scene.json's, in world units
    assert not capture.warnings


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"tangential_distortion": None, "tangential": [0.01, -0.02]},
        {"radial_distortion": [0.0] * 3, "tangential_distortion": [0.0] * 2},
        {"skew": 0.0, "radial_distortion": [0.0] * 3, "tangential_distortion": [0.0] * 2, "pixel_aspect_ratio": 1.0},
    ],
    ids=["all", "old key", "skew alone", "pinhole"],
)
def test_a_world_point_lies_where_its_camera_says_once_the_lens_is_removed(
    tmp_path: Path, changes: dict[str, Any]
) -> None:
    camera = {key: value for key, value in camera_json(**changes).items() if value is not None}
    capture = open_capture(Rig(tmp_path, frames=2, camera=camera).write())
    images = list(decode_shots(capture, range(len(capture.shots))))
    for shot, image in zip(capture.shots, images, strict=True):
        assert image.shape == (HEIGHT // 2, WIDTH // 2, 3)
        pixel, depth = capture.cameras[shot.camera].project(SPOT[None])
        assert depth[0] > 0
        np.testing.assert_allclose(centroid(image), pixel[0], atol=0.1)
        name = capture.cameras[shot.camera].name
        stored = stored_pixel(json.loads((tmp_path / f"camera/{name}.json").read_text()), SPOT) / 2
        is_pinhole = changes.get("pixel_aspect_ratio") == 1.0
        assert (np.linalg.norm(stored - pixel[0]) < 1e-9) == is_pinhole  # else there was something to remove
    assert (capture.distortions[0] is None) == is_pinhole


def test_without_2x_the_largest_images_that_fit_are_taken(tmp_path: Path) -> None:
    capture = open_capture(Rig(tmp_path, frames=2, scales=(1, 4, 8)).write())
    assert (capture.cameras[0].width, capture.cameras[0].height) == (192, 128)
    assert any("rgb/2x, those of rgb/1x" in warning for warning in capture.warnings)


def test_a_single_camera_without_a_split_is_split_as_the_papers_do(rig: Rig) -> None:
    ids = [f"{frame + 1:06d}_{side}" for side in ("left", "right") for frame in range(6)]
    rig.put("dataset.json", {"ids": ids, "train_ids": ids, "val_ids": []})
    capture = open_capture(rig.path)
    assert [capture.cameras[s.camera].name for s in capture.train_shots] == [ids[0], ids[8], ids[4]]  # by frame
    assert capture.test_cameras == {ids[2], ids[6], ids[10]}
    assert "of every four images" in capture.warnings[0]


def test_an_image_in_both_lists_is_never_trained_on(rig: Rig) -> None:
    data = json.loads((rig.path / "dataset.json").read_text())
    rig.change("dataset.json", train_ids=[*data["train_ids"], data["val_ids"][0]])
    capture = open_capture(rig.path)
    assert data["val_ids"][0] in capture.test_cameras
    assert len(capture.train_shots) == len(capture.test_shots) == 6
    assert "1 of the train_ids are also in val_ids" in capture.warnings[0]


def test_time_id_comes_before_warp_id_and_even_steps_are_frames(rig: Rig) -> None:
    data = json.loads((rig.path / "metadata.json").read_text())
    rig.put("metadata.json", {name: {**entry, "time_id": 10 + 4 * entry["warp_id"]} for name, entry in data.items()})
    assert [shot.frame for shot in open_capture(rig.path).shots] == [f for f in range(6) for _ in range(2)]
    some = {name: {**entry, "time_id": 0} if entry["warp_id"] else entry for name, entry in data.items()}
    rig.put("metadata.json", some)  # not all have one: warp_id it is
    assert open_capture(rig.path).frame_count == 6


def test_a_gap_in_time_stays_a_gap(rig: Rig) -> None:
    for side in ("left", "right"):
        (rig.path / f"rgb/2x/000003_{side}.png").unlink()
    capture = open_capture(rig.path)
    assert capture.frame_count == 6
    assert {shot.frame for shot in capture.shots} == {0, 1, 3, 4, 5}
    assert "2 of 12 listed images (the first is 000003_left)" in capture.warnings[0]


def test_points_become_seeds_with_the_images_colours(rig: Rig, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    cloud = random.uniform([-1.0, -0.7, 3.0], [1.5, 0.7, 5.0], (400, 3))
    np.save(rig.path / "points.npy", np.concatenate([SPOT[None], cloud]).astype(np.float32))
    capture = open_capture(rig.path)
    assert capture.near_far is not None
    assert 2.0 < capture.near_far[0] < 4.0 < 6.0 < capture.near_far[1] < 10.0
    seeds = find_seeds(capture, FrameStore.open(capture, cache_folder=tmp_path / "cache"), count_limit=2000)
    assert "given" in seeds.origin
    nearest = np.linalg.norm(seeds.points - SPOT, axis=1).argmin()
    np.testing.assert_allclose(seeds.points[nearest], SPOT, atol=1e-3)
    assert seeds.colors[nearest].min() > 0.8  # the spot is white, all else black
    inside = np.linalg.norm(seeds.points - cloud[:1], axis=1).min()
    assert inside < 0.2  # merged with its neighbours at most


@pytest.mark.parametrize(
    ("name", "changes", "sentence"),
    [
        ("camera/000001_left.json", {"focal_length": None}, r"000001_left\.json: found nothing as focal_length"),
        (
            "camera/000001_left.json",
            {"image_size": [HEIGHT, WIDTH]},
            "images of 96 x 64 pixels .*, expected the proportions of the calibration, 128 x 192",
        ),
        ("dataset.json", {"train_ids": ["../a"]}, "image name '../a' in train_ids"),
        ("dataset.json", {"val_ids": "all"}, "val_ids that is not a list"),
        ("dataset.json", {"train_ids": []}, "no image to train on"),
        (
            "dataset.json",
            {"train_ids": ["x"], "val_ids": ["y"]},
            "none of the listed images, expected them in rgb/2x",
        ),
        ("metadata.json", {"000002_right": None}, "nothing about the image 000002_right"),
        ("metadata.json", {"000002_right": {"warp_id": 0.5}}, "warp_id with a fraction"),
        ("metadata.json", {"000002_right": {"appearance_id": 1}}, "nothing as warp_id of 000002_right"),
        ("scene.json", {"near": 9.0}, "near = 9 and far = 8"),
        ("metadata.json", {"000002_right": {"warp_id": 10**12}}, r"warp_ids, .* to 1000000000000, expected at most"),
        ("metadata.json", {"000002_right": {"warp_id": 1e300}}, "warp_id of 000002_right with the number"),
        ("camera/000001_left.json", {"focal_length": 1e9, "pixel_aspect_ratio": 1e9}, "a focal length of"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(
    rig: Rig, name: str, changes: dict[str, Any], sentence: str
) -> None:
    rig.change(name, **changes)
    with pytest.raises(FrogError, match=sentence):
        open_capture(rig.path)


@pytest.mark.parametrize("missing", ["metadata.json", "rgb"])
def test_a_missing_part_is_named(rig: Rig, missing: str) -> None:
    (rig.path / missing).rename(rig.path / "elsewhere")
    with pytest.raises(FrogError, match=missing):
        open_capture(rig.path)


def test_points_of_another_shape_and_pickles_are_refused(rig: Rig) -> None:
    np.save(rig.path / "points.npy", np.zeros((4, 2)))
    with pytest.raises(FrogError, match=r"points\.npy: found float64 of shape \(4, 2\)"):
        open_capture(rig.path)
    np.save(rig.path / "points.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(FrogError, match="not a NumPy array"):
        open_capture(rig.path)


def test_points_from_nowhere_are_left_out(rig: Rig) -> None:
    np.save(rig.path / "points.npy", np.array([[0, 0, 4], [np.nan, 0, 0], [0, np.inf, 0], [0, 0, -1e300]]))
    points = open_capture(rig.path).points
    assert points is not None
    np.testing.assert_array_equal(points, [[0, 0, 4]])
