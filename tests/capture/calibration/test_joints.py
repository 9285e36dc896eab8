"""Cameras from a person's joints, and the joints from images."""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.arrays import Float64s, ImageArray
from frog_blender.engine.capture.calibration import joint_films, landmark_file, landmarks
from frog_blender.engine.capture.calibration.calibration import CalibrationRefused
from frog_blender.engine.capture.calibration.films import View, find_films
from frog_blender.engine.capture.calibration.joints import Joints, calibrate_joints, find_joints
from frog_blender.engine.capture.calibration.landmarks import JOINTS, Box, LandmarkNetwork, Person
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.errors import FrogError

from ..conftest import write_video
from .rigs import TALL, around, facts_of, pixels_of, rig_errors, skeleton

FAR_APART = [0.0, 49.0, 174.0, 230.0]
SIDES = [1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11, 10, 13, 12, 15, 14]


def rig() -> list[Camera]:
    return around(FAR_APART, TALL, 1680.0, distance=4.0)


def joints_seen(camera: Camera, times: Float64s, noise: float, seed: int, *, swapped: float = 0.05) -> Joints:
    """What the network makes of a walk: ``noise`` pixels off, and left for right in some images."""
    rng = np.random.default_rng(seed)
    pixels = np.stack([pixels_of(camera, skeleton(time)) for time in times])
    pixels += rng.normal(0, noise, pixels.shape)
    for image in np.flatnonzero(rng.random(len(times)) < swapped):
        pixels[image] = pixels[image, SIDES]
    visibility = np.where(np.isfinite(pixels[:, :, 0]), rng.uniform(0.4, 1.0, pixels.shape[:2]), 0.0)
    return Joints(pixels, visibility)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_walk_places_cameras_that_share_no_features(seed: int) -> None:
    cameras, times = rig(), np.linspace(0, 12, 40)
    joints = [joints_seen(camera, times, 8.0, 10 * seed + i) for i, camera in enumerate(cameras)]

    found = calibrate_joints(facts_of(cameras), [0] * 4, joints)

    centers, rotation, focal, _ = rig_errors(found, cameras)
    assert centers < 1.0
    assert rotation < 1.0
    assert focal < 3.0
    assert not found.is_metric
    assert all(each.evidence.observations > 300 for each in found.cameras)


def test_a_camera_that_sees_another_person_is_refused() -> None:
    cameras, times = rig(), np.linspace(0, 12, 40)
    joints = [joints_seen(camera, times, 4.0, i) for i, camera in enumerate(cameras)]
    joints[2] = joints_seen(cameras[2], 40.0 - 2.3 * times, 4.0, 9)

    with pytest.raises(CalibrationRefused, match=r"cam02|join all cameras|two rigs"):
        calibrate_joints(facts_of(cameras), [0] * 4, joints)


def test_too_few_joints_are_refused_with_the_camera_s_name() -> None:
    cameras, times = rig(), np.linspace(0, 12, 40)
    joints = [joints_seen(camera, times, 4.0, i) for i, camera in enumerate(cameras)]
    joints[1] = Joints(joints[1].pixels, np.where(np.arange(40)[:, None] < 5, joints[1].visibility, 0.0))

    with pytest.raises(CalibrationRefused, match=r"Camera cam01 shares \d+ joints"):
        calibrate_joints(facts_of(cameras), [0] * 4, joints)


def test_a_person_who_stands_still_far_away_leaves_the_focal_length_open() -> None:
    cameras = around([0.0, 8.0, 16.0], TALL, 1680.0, distance=30.0)
    times = np.zeros(40)
    joints = [joints_seen(camera, times, 2.0, i, swapped=0.0) for i, camera in enumerate(cameras)]

    with pytest.raises(CalibrationRefused):
        calibrate_joints(facts_of(cameras), [0, 0, 0], joints)


def test_joints_between_two_images() -> None:
    times = np.array([0.0, 0.1, 0.2, 1.0])
    pixels = np.zeros((4, 16, 2))
    pixels[:, :, 0] = (100 * times)[:, None]
    visibility = np.full((4, 16), 0.9)
    visibility[1, 3] = 0.2

    found = Joints(pixels, visibility).at(times, np.array([0.05, 0.15, 0.6, 1.2, 0.2]))

    assert np.allclose(found.pixels[[0, 1, 4], 0, 0], [5.0, 15.0, 20.0])
    assert np.isnan(found.pixels[[2, 3]]).all()  # too long a gap, and after the end
    assert (found.visibility[[2, 3]] == 0).all()
    assert found.visibility[0, 3] == 0.2
    assert found.visibility[0, 4] == 0.9


# --- joints in images


@dataclass
class Watcher:
    """Stands for the network: it sees a person wherever a box covers the bright figure, and remembers the boxes."""

    boxes: list[Box] = field(default_factory=list)

    def find(self, image: ImageArray, box: Box) -> Person | None:
        self.boxes.append(box)
        rows, columns = np.nonzero(image[..., 0] > 200)
        if not len(rows):
            return None
        middle = np.array([columns.mean(), rows.mean()])
        if max(abs(middle[0] - box.x), abs(middle[1] - box.y)) > box.side / 2:
            return None
        return Person(np.tile(middle, (16, 1)), np.ones(16), Box(float(middle[0]), float(middle[1]), 60.0))

    find_surely = find


def film(places: list[tuple[int, int] | None]) -> list[ImageArray]:
    """A bright figure of 20 x 40 pixels before a dark wall, its upper left corner at each place."""
    images = []
    for place in places:
        image = np.full((240, 320, 3), 40, np.uint8)
        if place is not None:
            image[place[1] : place[1] + 40, place[0] : place[0] + 20] = 255
        images.append(image)
    return images


def test_the_person_is_sought_where_something_moves_and_followed() -> None:
    places: list[tuple[int, int] | None] = [(40, 60), (60, 60), (80, 70), None, (250, 150), (252, 150)]
    images = film(places)
    plate = np.full((120, 160), 40, np.uint8)  # half as large as the images
    changing = np.zeros((120, 160), bool)
    changing[25:100, 15:140] = True
    watcher = Watcher()

    found = find_joints(watcher, images, plate, changing)  # type: ignore[arg-type]

    middles = [(x + 9.5, y + 19.5) if place else (np.nan, np.nan) for place in places for x, y in [place or (0, 0)]]
    assert np.allclose(found.pixels[:, 0], middles, equal_nan=True)
    assert found.visibility[:, 0].tolist() == [1, 1, 1, 0, 1, 1]
    first = watcher.boxes[0]
    assert abs(first.x - 50) < 4  # what moves now, in the image's pixels
    assert abs(first.y - 80) < 4
    assert 40 < first.side < 80


def test_nothing_moves_and_nobody_is_found() -> None:
    images = [*film([None, None])]

    found = find_joints(Watcher(), images, np.full((240, 320), 40, np.uint8), np.zeros((240, 320), bool))  # type: ignore[arg-type]

    assert np.isnan(found.pixels).all()
    assert (found.visibility == 0).all()


def test_films_are_read_at_the_times_that_are_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images = film([(20 + 40 * number, 60) for number in range(6)])
    write_video(tmp_path / "one.avi", 6, 320, 240, lambda number: images[number])
    films = find_films(tmp_path)
    view = View("one", films[0].size, np.full((240, 320), 40, np.uint8), np.ones((240, 320), bool))
    monkeypatch.setattr(joint_films, "LandmarkNetwork", lambda path: Watcher())
    asked: list[bool] = []

    rate = films[0].facts.frames_per_second
    wanted = [1 / rate, 4 / rate, 9 / rate]
    (found,) = joint_films.joints_of_films(
        films, [view], [wanted], tmp_path, lambda *_: None, lambda: asked.append(True)
    )

    assert np.allclose(found.pixels[:, 0, 0], [69.5, 189.5, np.nan], atol=1.5, equal_nan=True)
    assert found.visibility[:, 0].tolist() == [1, 1, 0]
    assert len(asked) == 3


class Fixed(LandmarkNetwork):
    """The network with its answer given: landmarks in pixels of the crop."""

    def __init__(self, places: Float64s, *, score: float = 0.9, mirrors: bool = True) -> None:
        self.places, self.score, self.mirrors, self.calls = places, score, mirrors, 0

    def _run(self, crop: ImageArray) -> tuple[Float64s, float, Float64s]:
        landmarks_ = np.zeros((39, 5))
        landmarks_[:, :2] = self.places
        landmarks_[:, 3] = 3.0
        if self.calls % 2 and self.mirrors:
            landmarks_[:, 0] = 256 - 1 - landmarks_[:, 0]
            landmarks_[list(JOINTS)] = landmarks_[list(JOINTS)][SIDES]
        self.calls += 1
        return landmarks_, self.score, np.full((39, 64, 64), -20.0)


def places_in_crop() -> Float64s:
    places = np.random.default_rng(0).uniform(60, 200, (39, 2))
    places[33], places[34] = (128, 150), (128, 50)  # upright, and a hundred pixels tall
    return places


def test_places_in_the_crop_become_the_image_s_pixels() -> None:
    places = places_in_crop()
    box = Box(300.0, 200.0, 512.0)

    person = Fixed(places).find(np.zeros((400, 600, 3), np.uint8), box)

    assert person is not None
    assert np.allclose(person.pixels, places[list(JOINTS)] * 2 + (300 - 256, 200 - 256) + 0.5)
    assert np.allclose(person.visibility, 1 / (1 + np.exp(-3.0)))
    assert person.box.turn == pytest.approx(0.0)
    assert person.box.side == pytest.approx(2 * 1.25 * 200)


def test_a_turned_box_turns_the_places() -> None:
    places = places_in_crop()

    person = Fixed(places).find(np.zeros((400, 600), np.uint8), Box(300.0, 200.0, 256.0, np.pi / 2))

    assert person is not None
    across = places[list(JOINTS)] - 128
    assert np.allclose(person.pixels, np.column_stack([-across[:, 1] + 300, across[:, 0] + 200]) + 0.5)
    assert person.box.turn == pytest.approx(np.pi / 2)


def test_nobody_is_nobody() -> None:
    assert Fixed(places_in_crop(), score=0.2).find(np.zeros((40, 60, 3), np.uint8), Box(30, 20, 40)) is None


def test_joints_that_the_mirror_image_contradicts_are_not_seen() -> None:
    image, box = np.zeros((400, 600, 3), np.uint8), Box(300.0, 200.0, 256.0)

    agreed = Fixed(places_in_crop()).find_surely(image, box)
    contradicted = Fixed(places_in_crop(), mirrors=False).find_surely(image, box)

    assert agreed is not None
    assert (agreed.visibility > 0.9).all()
    assert contradicted is not None
    assert (contradicted.visibility == 0).sum() > 10


def test_a_landmark_moves_to_the_middle_of_its_heat() -> None:
    heat = np.full((39, 64, 64), -20.0)
    heat[5, 20:23, 30:33] = 4.0  # nine hot cells about (31, 21)
    places = np.full((39, 2), 0.5)
    places[5] = (30.2 / 64, 21.9 / 64)

    refined = landmarks._refined(places, heat)

    assert np.allclose(refined[5], (31 / 64, 21 / 64), atol=1e-6)
    assert np.array_equal(np.delete(refined, 5, 0), np.delete(places, 5, 0))  # cold: they stay
    outside = places.copy()
    outside[7] = (-0.3, 1.4)
    assert np.array_equal(landmarks._refined(outside, heat)[7], outside[7])


# --- the file


def wheel_with(content: bytes, folder: Path, member: str = landmark_file._MEMBER) -> None:
    with zipfile.ZipFile(folder / "mediapipe-0.10.21-cp311-cp311-any.whl", "w") as archive:
        archive.writestr(member, content)


def test_the_file_is_taken_out_of_the_wheel_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = b"network" * 100
    monkeypatch.setattr(landmark_file, "_SHA256", hashlib.sha256(content).hexdigest())
    monkeypatch.setattr(landmark_file, "_BYTES", len(content))
    assert landmark_file.landmark_file(tmp_path) is None
    downloads: list[Path] = []

    def download(folder: Path) -> None:
        downloads.append(folder)
        wheel_with(content, folder)

    path = landmark_file.fetch_landmark_file(download, tmp_path)
    again = landmark_file.fetch_landmark_file(download, tmp_path)

    assert path == again == landmark_file.landmark_file(tmp_path)
    assert landmark_file.read_landmark_file(path) == content
    assert len(downloads) == 1
    assert not downloads[0].exists()


@pytest.mark.parametrize("case", ["another file", "a bomb", "no such member", "no zip", "nothing"])
def test_any_other_file_is_refused_and_nothing_kept(tmp_path: Path, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landmark_file, "_BYTES", 1000)

    def download(folder: Path) -> None:
        if case == "another file":
            wheel_with(b"x" * 1000, folder)
        elif case == "a bomb":
            wheel_with(b"\0" * 10_000_000, folder)
        elif case == "no such member":
            wheel_with(b"x", folder, "mediapipe/readme")
        elif case == "no zip":
            (folder / "mediapipe-0.10.21.whl").write_bytes(b"no zip")

    with pytest.raises(FrogError, match="mediapipe"):
        landmark_file.fetch_landmark_file(download, tmp_path)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_damaged_file_does_not_reach_opencv(tmp_path: Path) -> None:
    path = tmp_path / landmark_file.NAME
    path.write_bytes(b"\x1c\0\0\0TFL3" + b"\xff" * 500)

    with pytest.raises(FrogError, match="damaged"):
        LandmarkNetwork(path)
    with pytest.raises(FrogError, match="cannot be read"):
        LandmarkNetwork(tmp_path / "missing")
