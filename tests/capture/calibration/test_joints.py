"""A person's joints in images, the network that finds them, and cameras from them."""

import hashlib
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from support.films import encode
from support.small_captures import write_video

from frog_blender.engine.arrays import Float64s, ImageArray
from frog_blender.engine.capture.calibration import joint_rig, joints
from frog_blender.engine.capture.calibration.joint_rig import calibrate_joints
from frog_blender.engine.capture.calibration.joints import (
    JOINTS,
    OTHER_SIDE,
    Box,
    LandmarkNetwork,
    Person,
    agreed_sides,
    find_joints,
)
from frog_blender.engine.capture.calibration.model import Calibration
from frog_blender.engine.capture.calibration.pipeline import Options, Source, calibrate_by
from frog_blender.engine.capture.calibration.views import CameraFacts
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.epipolar import fundamental
from frog_blender.engine.capture.synchronization.films import CalibrationRefused, Run, find_films
from frog_blender.engine.errors import FrogError
from frog_blender.engine.io.work_folder import WorkFolder

from ..synchronization.moving_scene import MovingScene, ring
from ..synchronization.test_starts import RATE, speech
from .rigs import TALL, around, facts_of, pixels_of, rig_errors, skeleton
from .walls import at_rest, run_in

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

    middles = np.add([place or (np.nan, np.nan) for place in places], (9.5, 19.5))
    assert np.allclose(found[:, 0], middles, equal_nan=True)
    first = watcher.boxes[0]  # what moves now, in the image's pixels
    assert abs(first.x - 50) < 4 and abs(first.y - 80) < 4 and 40 < first.side < 80
    assert np.isnan(find_joints(watcher, images, plate, np.zeros_like(changing))).all()  # type: ignore[arg-type]


def test_films_are_read_at_the_times_that_are_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images = film([(20 + 40 * index, 60) for index in range(6)])
    write_video(tmp_path / "one.avi", 6, 320, 240, lambda index: images[index])
    films = find_films(tmp_path)
    rate = films[0].facts.frames_per_second
    monkeypatch.setattr(joint_rig, "LandmarkNetwork", lambda path: Watcher())
    monkeypatch.setattr(joint_rig, "views_of", lambda *_, **__: [CameraFacts("one", *films[0].size, key="0")])
    monkeypatch.setattr(joint_rig, "common_times", lambda *_: [1 / rate, 4 / rate, 9 / rate])
    monkeypatch.setattr(Run, "in_child", lambda _run, _function, _views, pixels: pixels)
    asked: list[bool] = []
    run = Run(WorkFolder(tmp_path / "work"), lambda *_: None, lambda: bool(asked.append(True)))
    run.work.keep("view", "0", vars(at_rest(np.full((240, 320), 40, np.uint8), changing=1)))

    (found,) = joint_rig.calibrate_joint_films(run, tmp_path, films)

    assert np.allclose(found[:, 0, 0], [69.5, 189.5, np.nan], atol=1.5, equal_nan=True)
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
            landmarks_[list(JOINTS)] = landmarks_[list(JOINTS)][OTHER_SIDE]
        self.calls += 1
        return landmarks_, self.score, np.full((39, 64, 64), -20.0)


def places_in_crop() -> Float64s:
    places = np.random.default_rng(0).uniform(60, 200, (39, 2))
    places[33], places[34] = (128, 150), (128, 50)  # upright, and a hundred pixels tall
    return places


def test_places_in_a_turned_crop_become_the_image_s_pixels() -> None:
    places, image = places_in_crop(), np.zeros((400, 600, 3), np.uint8)
    across = 2 * (places[list(JOINTS)] - 128)
    for turn, moved in ((0.0, across), (np.pi / 2, np.column_stack([-across[:, 1], across[:, 0]]))):
        person = Fixed(places).find(image, Box(300.0, 200.0, 512.0, turn))
        assert np.allclose(person.pixels, moved + (300, 200) + 0.5)
        assert np.allclose(person.visibility, 1 / (1 + np.exp(-3.0)))
        assert person.box.turn == pytest.approx(turn) and person.box.side == pytest.approx(2 * 1.25 * 200)
    assert Fixed(places, score=0.2).find(image, Box(300.0, 200.0, 512.0)) is None


def test_joints_that_the_mirror_image_contradicts_are_not_seen() -> None:
    image, box = np.zeros((400, 600, 3), np.uint8), Box(300.0, 200.0, 256.0)

    agreed = Fixed(places_in_crop()).find_surely(image, box)
    contradicted = Fixed(places_in_crop(), mirrors=False).find_surely(image, box)

    assert agreed is not None and (agreed.visibility > 0.9).all()
    assert contradicted is not None and (contradicted.visibility == 0).sum() > 10


def test_a_landmark_moves_to_the_middle_of_its_heat() -> None:
    heat = np.full((39, 64, 64), -20.0)
    heat[5, 20:23, 30:33] = 4.0  # nine hot cells about (31, 21)
    places = np.full((39, 2), 0.5)
    places[5], places[7] = (30.2 / 64, 21.9 / 64), (-0.3, 1.4)  # the latter lies outside

    refined = joints._refined(places, heat)

    assert np.allclose(refined[5], (31 / 64, 21 / 64), atol=1e-6)
    assert np.array_equal(np.delete(refined, 5, 0), np.delete(places, 5, 0))  # cold: they stay


# --- the file


def wheel_with(content: bytes, folder: Path, member: str = joints._MEMBER) -> None:
    with zipfile.ZipFile(folder / "mediapipe-0.10.21-cp311-cp311-any.whl", "w") as archive:
        archive.writestr(member, content)


def test_the_file_is_taken_out_of_the_wheel_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path))
    content = b"network" * 100
    monkeypatch.setattr(joints, "_SHA256", hashlib.sha256(content).hexdigest())
    monkeypatch.setattr(joints, "_BYTES", len(content))
    assert joints.landmark_file() is None
    downloads: list[Path] = []

    def download(_arguments: object, folder: Path, *_: object, **__: object) -> None:
        downloads.append(folder)
        wheel_with(content, folder)

    monkeypatch.setattr(joints, "run_pip", download)
    path, again = (joints.fetch_landmark_file(lambda: False) for _ in range(2))

    assert path == again == joints.landmark_file()
    assert joints.read_landmark_file(path) == content
    assert len(downloads) == 1 and not downloads[0].exists()


def test_any_other_file_is_refused_and_nothing_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path))
    monkeypatch.setattr(joints, "_BYTES", 1000)
    downloads: list[Callable[[Path], object]] = [
        lambda folder: wheel_with(b"\0" * 10_000_000, folder),  # more than the file has, of another content
        lambda folder: wheel_with(b"x", folder, "mediapipe/readme"),
        lambda folder: (folder / "mediapipe-0.10.21.whl").write_bytes(b"no zip"),
        lambda folder: None,
    ]
    monkeypatch.setattr(joints, "run_pip", lambda _arguments, folder, *_, **__: downloads.pop()(folder))
    while downloads:
        with pytest.raises(FrogError, match="mediapipe"):
            joints.fetch_landmark_file(lambda: False)
        assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    (tmp_path / "damaged.tflite").write_bytes(b"\x1c\0\0\0TFL3" + b"\xff" * 500)
    for name, why in {"damaged.tflite": "damaged", "missing": "cannot be read"}.items():
        with pytest.raises(FrogError, match=why):  # it does not reach OpenCV
            LandmarkNetwork(tmp_path / name)


SPREAD = [0.0, 49.0, 174.0, 230.0]


def filmed(camera: Camera, times: Float64s, seed: int, *, noise: float = 5.0, pace: float = 1.0) -> Float64s:
    """(T, 16, 2) what the network makes of a walk: joints are ``noise`` pixels off, one in twenty is anywhere."""
    rng = np.random.default_rng(seed)
    pixels = np.stack([pixels_of(camera, skeleton(3.0 + pace * time)) for time in times])
    pixels += rng.normal(0, noise, pixels.shape)
    wild = rng.random(pixels.shape[:2]) < 0.05
    pixels[wild] += rng.normal(0, 150.0, (int(wild.sum()), 2))
    pixels[rng.random(pixels.shape[:2]) < 0.1] = np.nan
    return pixels


def spread(count: int) -> list[Camera]:
    """So many cameras far apart about a room."""
    return around(SPREAD[:count], TALL, 1680.0, distance=4.0)


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return run_in(tmp_path / "work")


# --- known clocks


def walks(cameras: Sequence[Camera], **options: float) -> Float64s:
    times = np.linspace(0, 12, 40)
    return np.stack([filmed(camera, times, seed, **options) for seed, camera in enumerate(cameras)])


def test_a_walk_places_cameras_that_share_no_features(run: Run) -> None:
    """In the child, which a fault of its libraries may end."""
    cameras = spread(4)
    pixels = walks(cameras, noise=8.0)
    pixels[1, 10:18] = pixels[1, 10:18][:, OTHER_SIDE]

    found = run.in_child(calibrate_joints, facts_of(cameras), pixels)

    centers, rotation, focal, _ = rig_errors(found, cameras)
    assert centers < 1.0 and rotation < 1.0 and focal < 3.0
    assert not found.is_metric


def test_what_joints_leave_open_is_refused() -> None:
    cameras = spread(4)
    pixels = walks(cameras)
    another = pixels.copy()
    another[2] = filmed(cameras[2], np.linspace(37, 49, 40), 9, pace=-2.3)
    with pytest.raises(CalibrationRefused, match=r"cam02|join all cameras|two rigs"):
        calibrate_joints(facts_of(cameras), another)
    few = pixels.copy()
    few[1, 5:] = np.nan
    with pytest.raises(CalibrationRefused, match=r"Camera cam01 shares \d+ joints"):
        calibrate_joints(facts_of(cameras), few)


# --- clocks


def test_sound_alone_times_films_of_a_person(tmp_path: Path, run: Run) -> None:
    # What moves says that the second film began 0.15 s later; what is heard, that it began 0.45 s later.
    scene, sound, times = MovingScene(), speech(4), np.arange(40) / 20
    (tmp_path / "mute").mkdir()
    for (name, camera), moved, heard in zip(ring(2).items(), (0.0, 0.15), (0.0, 0.45), strict=True):
        samples = (32_767 * sound[round(heard * RATE) : round((heard + 2) * RATE), None]).astype(np.int16)
        images = [scene.image(camera, moved + time) for time in times]
        encode(tmp_path / f"{name}.mp4", images, rate=20, sound=samples, sound_rate=RATE)
        encode(tmp_path / "mute" / f"{name}.mp4", images, rate=20)
    person = Source("a person's joints", lambda films, count: Calibration(()), needs_sound=True)

    _, films, clocks = calibrate_by(person, find_films(tmp_path), Options(), run)

    assert clocks.by_sound and films[1].offset - films[0].offset == pytest.approx(0.45, abs=0.02)
    with pytest.raises(CalibrationRefused, match=r"sound does not tell when each began: .*--in-step.*--clock.* clap"):
        calibrate_by(person, find_films(tmp_path / "mute"), Options(), run)


# --- left for right


@pytest.mark.parametrize("count", [3, 8])
def test_cameras_agree_who_has_left_for_right(count: int) -> None:
    cameras = around(np.linspace(0, 300, count).tolist(), TALL, 1680.0, distance=4.0)
    pixels = np.stack([filmed(camera, np.arange(20) / 30, i, noise=3.0) for i, camera in enumerate(cameras)])
    pixels[1, 4:15] = pixels[1, 4:15][:, OTHER_SIDE]
    matrices = {(i, j): fundamental(cameras[i], cameras[j]) for i in range(count) for j in range(i + 1, count)}

    swapped = agreed_sides(pixels, matrices, 30.0)

    assert swapped.shape == (count, 20)
    assert swapped[1, 4:15].mean() > 0.9
    assert swapped[1, :4].sum() + swapped[1, 15:].sum() == 0
    assert np.delete(swapped, 1, 0).sum() <= 1
