"""The joints of a person in a standing camera's images, by the pose network whose file the user fetches once.

The file is BlazePose's, of MediaPipe, under the Apache licence. It is taken out of a wheel on PyPI, at the user's wish,
and kept in the cache; OpenCV runs it. MediaPipe's refinement by heatmaps is
repeated here (RefineLandmarksFromHeatmapCalculator): without it the cameras that follow are twice as wrong.

In a standing camera's film the person is what moves, so no detector is needed. Left for right is the network's
commonest mistake, seen from the side or from behind: both sides change their names together, and the other cameras show
which of two names is right.
"""

import hashlib
import math
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...arrays import Bools, Float64s, ImageArray
from ...errors import FrogError, brief, found_instead, in_words, reason
from ...io.atomic_files import write_atomically
from ...io.cache_folder import default_cache_folder
from ...io.pip import run_pip
from ..epipolar import sampson_distances
from ..video import load_opencv

JOINTS = (11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28, 29, 30, 31, 32)
"""The network's landmarks that are joints: shoulders, elbows, wrists, hips, knees, ankles, heels and toes, left first.
Those of the face and the hands lie too near to each other."""
_SIDE = 256  # pixels of what the network looks at
_LANDMARKS = 39
_CENTER, _REACH = 33, 34  # two landmarks that say where the person is, how large, and how it is turned
_MARGIN = 1.25  # of the person's circle
_KERNEL = 3  # cells of a heatmap either side of a landmark
_LEAST_HEAT = 0.5  # of the hottest of those cells, or the landmark stays as it was
_LEAST_PERSON = 0.5  # the network's own confidence that it sees one
_SURE = 0.03  # of the box's side: how far apart a joint may be found in the image and in its mirror image
_OUTPUTS = {"Identity": "landmarks", "Identity_1": "score", "Identity_3": "heatmaps"}
OTHER_SIDE = np.arange(len(JOINTS)) ^ 1
"""(16,) of each joint the same one on the other side."""
_CHANGES = 18  # of 255: what moves at one time
_LEAST_MOTION = 0.01  # of all that ever moves: less is noise, or a person who stands still
_AROUND = 1.25  # of what moves, the box in which the person is sought
_VISIBLE = 0.5  # a joint of a smaller visibility is a guess
_SURER = 0.8  # of the cost as it was: a change of sides must gain so much
_MOST_TOGETHER = 6  # cameras of which all combinations are tried; more are tried one by one
NAME = "pose_landmark_full.tflite"
LANDMARK_SIZES = "36 MB to download, of which 6.4 MB are kept"
LICENSE = "MediaPipe's pose landmarks, Apache-2.0"
_PIP_ARGUMENTS = (
    "--no-deps",
    "--platform=manylinux_2_28_x86_64",
    "--python-version=3.11",
    "--implementation=cp",
    "mediapipe==0.10.21",
)
# One wheel for every machine: only the file in it is used, and later versions have none.
_MEMBER = f"mediapipe/modules/pose_landmark/{NAME}"
_SHA256 = "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f"
_BYTES = 6_440_512


class Box(NamedTuple):
    """A square in an image, which may reach outside: its middle and side in pixels, its turn in radians."""

    x: float
    y: float
    side: float
    turn: float = 0.0


@dataclass(frozen=True, eq=False)
class Person:
    """One person in one image.

    Attributes:
        pixels: (16, 2) joints in the order of JOINTS, pixel centres at +0.5.
        visibility: (16,) from 0 to 1.
        box: where the person is, to look for them in the next image.
    """

    pixels: Float64s
    visibility: Float64s
    box: Box


class LandmarkNetwork:
    """The network, read once.

    Raises:
        FrogError: if the file cannot be read, is another one, or OpenCV cannot run it.
    """

    def __init__(self, path: Path) -> None:
        cv2 = load_opencv()
        content = read_landmark_file(path)
        try:
            self._network = cv2.dnn.readNetFromTFLite(np.frombuffer(content, np.uint8))
            self._names = list(_OUTPUTS)
            self._run(np.zeros((_SIDE, _SIDE, 3), np.uint8))
        except (cv2.error, AttributeError) as error:
            raise found_instead(
                path, f"a file that OpenCV cannot run ({reason(error)})", "the landmark file"
            ) from error

    def find(self, image: ImageArray, box: Box) -> Person | None:
        """The person within a box of an image (H, W, 3) or (H, W); None where the network sees none."""
        cv2 = load_opencv()
        colored = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
        to_image = _from_crop(box)
        sharp = cv2.INTER_AREA if box.side > _SIDE else cv2.INTER_LINEAR
        crop = cv2.warpAffine(colored, to_image, (_SIDE, _SIDE), flags=sharp | cv2.WARP_INVERSE_MAP)
        landmarks, score, heatmaps = self._run(crop)
        if score < _LEAST_PERSON:
            return None
        places = _refined(landmarks[:, :2] / _SIDE, heatmaps) * _SIDE
        pixels = places @ to_image[:, :2].T + to_image[:, 2] + 0.5
        visibility = 1.0 / (1.0 + np.exp(-landmarks[list(JOINTS), 3]))
        return Person(pixels[list(JOINTS)], visibility, _box_about(pixels[_CENTER], pixels[_REACH]))

    def find_surely(self, image: ImageArray, box: Box) -> Person | None:
        """The same from the image and its mirror image: their mean, and nothing where they disagree.

        Seen from behind, left and right are a guess, which the mirror image makes the other way round.
        """
        person = self.find(image, box)
        width = image.shape[1]
        mirror_box = Box(width - box.x, box.y, box.side, -box.turn)
        mirrored = self.find(np.ascontiguousarray(image[:, ::-1]), mirror_box)
        if person is None or mirrored is None:
            return None
        pixels = mirrored.pixels[OTHER_SIDE] * (-1.0, 1.0) + (width, 0.0)
        is_sure = np.linalg.norm(pixels - person.pixels, axis=1) < _SURE * box.side
        visibility = np.where(is_sure, (person.visibility + mirrored.visibility[OTHER_SIDE]) / 2, 0.0)
        return Person((person.pixels + pixels) / 2, visibility, person.box)

    def _run(self, crop: ImageArray) -> tuple[Float64s, float, Float64s]:
        """(39, 5) landmarks in pixels of the crop, the confidence, (39, 64, 64) heatmaps before the sigmoid."""
        self._network.setInput(np.ascontiguousarray(crop.transpose(2, 0, 1)[None], np.float32) / 255.0)
        landmarks, score, heatmaps = (np.asarray(output, np.float64) for output in self._network.forward(self._names))
        return landmarks.reshape(_LANDMARKS, 5), float(score.reshape(-1)[0]), heatmaps.reshape(_LANDMARKS, 64, 64)


def _from_crop(box: Box) -> Float64s:
    """(2, 3) from positions in the network's image to those in the whole one."""
    middle = (_SIDE / 2, _SIDE / 2)
    matrix: Float64s = load_opencv().getRotationMatrix2D(middle, -np.degrees(box.turn), box.side / _SIDE)
    matrix[:, 2] += (box.x - middle[0], box.y - middle[1])
    return matrix


def _box_about(center: Float64s, reach: Float64s) -> Box:
    """The square about a person, upright in it."""
    x, y = center.tolist()
    across, down = (reach - center).tolist()
    return Box(x, y, 2.0 * _MARGIN * math.hypot(across, down), math.pi / 2 + math.atan2(down, across))


def _refined(places: Float64s, heatmaps: Float64s) -> Float64s:
    """Landmarks (39, 2), as parts of the image, moved to the centre of heat of the cells about them."""
    refined = places.copy()
    height, width = heatmaps.shape[1:]
    for landmark, (x, y) in enumerate((places * (width, height)).astype(int).tolist()):
        if not (0 <= x < width and 0 <= y < height):
            continue
        rows = np.arange(max(y - _KERNEL, 0), min(y + _KERNEL + 1, height))
        columns = np.arange(max(x - _KERNEL, 0), min(x + _KERNEL + 1, width))
        heat = 1.0 / (1.0 + np.exp(-heatmaps[landmark][np.ix_(rows, columns)]))
        if heat.max() >= _LEAST_HEAT:
            weights = heat / heat.sum()
            refined[landmark] = (weights.sum(0) @ columns / width, weights.sum(1) @ rows / height)
    return refined


# --- joints of films


def find_joints(
    network: LandmarkNetwork, images: Iterable[ImageArray | None], background: ImageArray, changing: Bools
) -> Float64s:
    """(T, 16, 2) pixels of the joints of whoever moves most in a standing camera's images; NaN where none is surely
    seen.

    Args:
        network: of the landmark file.
        images: (H, W, 3) RGB or (H, W), in order of time; None where the camera has none.
        background: (h, w) brightness, of the images' shape, possibly smaller.
        changing: (h, w) where something moves at any time.
    """
    whole = _largest_box(changing, 0)
    pixels = []
    previous: Box | None = None
    for image in images:
        person = None
        if image is not None and whole is not None:
            person = _person_in(network, image, _boxes(image, background, changing, whole, previous), previous)
        previous = None if person is None else person.box
        if person is None:
            pixels.append(np.full((len(JOINTS), 2), np.nan))
        else:
            pixels.append(np.where(person.visibility[:, None] > _VISIBLE, person.pixels, np.nan))
    return np.stack(pixels)


def with_sides(pixels: Float64s, swapped: Bools) -> Float64s:
    """Joints (..., T, 16, 2) with left for right in some images (..., T)."""
    return np.where(swapped[..., None, None], pixels[..., OTHER_SIDE, :], pixels)


def agreed_sides(pixels: Float64s, matrices: Mapping[tuple[int, int], Float64s], limit: float) -> Bools:
    """(C, T) in which images left and right must change places for the cameras to agree.

    Args:
        pixels: (C, T, 16, 2) joints of all cameras at the same times; NaN where not seen.
        matrices: (3, 3) fundamental matrices of the pairs of cameras.
        limit: pixels beyond which a joint is false.
    """
    cameras, times = pixels.shape[:2]
    straight, crossed = np.zeros((cameras, cameras, times)), np.zeros((cameras, cameras, times))
    for (one, other), matrix in matrices.items():
        for costs, second in ((straight, pixels[other]), (crossed, pixels[other][:, OTHER_SIDE])):
            flat = sampson_distances(matrix, pixels[one].reshape(-1, 2), second.reshape(-1, 2))
            squared = np.minimum((flat.reshape(times, -1) / limit) ** 2, 1.0)
            costs[one, other] = costs[other, one] = np.nansum(squared, axis=1)
    best = np.zeros((cameras, times), dtype=bool)
    first = least = _cost(best, straight, crossed)
    for labels in _labels(cameras):
        for base in (np.zeros((cameras, times), dtype=bool), best):
            tried = base ^ labels[:, None]
            cost = _cost(tried, straight, crossed)
            is_better = (cost < _SURER * first) & (cost < least - 1e-9)
            best = np.where(is_better, tried, best)
            least = np.where(is_better, cost, least)
    # All cameras at once is the same as none: the fewer contradict the network, the better.
    return np.asarray(np.where(2 * best.sum(0) > cameras, ~best, best))


def _labels(cameras: int) -> list[Bools]:
    if cameras > _MOST_TOGETHER:
        return list(np.eye(cameras, dtype=bool))
    return [np.array([False, *chosen]) for chosen in product((False, True), repeat=cameras - 1)]


def _cost(swapped: Bools, straight: Float64s, crossed: Float64s) -> Float64s:
    """(T,) of all pairs of cameras."""
    return np.asarray(np.where(swapped[:, None] != swapped[None], crossed, straight).sum((0, 1)))


def _person_in(network: LandmarkNetwork, image: ImageArray, boxes: list[Box], previous: Box | None) -> Person | None:
    """The first box with a person in it, and then that person in a box that fits, as the previous image's does."""
    for box in boxes:
        person = network.find(image, box)
        if person is None:
            continue
        if box is not previous:
            person = network.find(image, person.box) or person
        return network.find_surely(image, person.box)
    return None


def _boxes(image: ImageArray, background: ImageArray, changing: Bools, whole: Box, previous: Box | None) -> list[Box]:
    """Where to look, in this order, in the image's pixels: where the person was, what moves now, what ever moves."""
    cv2 = load_opencv()
    scale = image.shape[1] / background.shape[1]
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(gray, background.shape[::-1], interpolation=cv2.INTER_AREA)
    moving = (cv2.absdiff(small, background) > _CHANGES) & changing
    now = _largest_box(moving, _LEAST_MOTION * float(changing.sum()))
    boxes = [box._replace(x=box.x * scale, y=box.y * scale, side=box.side * scale) for box in (now, whole) if box]
    if previous is None:
        return boxes
    # Unless the person has left it: what moves now must lie in it.
    is_there = now is None or math.hypot(boxes[0].x - previous.x, boxes[0].y - previous.y) < previous.side / 2
    return [previous, *boxes] if is_there else boxes


def _largest_box(moving: Bools, least: float) -> Box | None:
    """The square about the largest connected region; None where it has fewer pixels than ``least``."""
    cv2 = load_opencv()
    opened = cv2.morphologyEx(moving.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, _, regions, _ = cv2.connectedComponentsWithStats(opened)
    if count < 2:
        return None
    left, top, width, height, area = max(regions[1:].tolist(), key=lambda region: region[4])
    return Box(left + width / 2, top + height / 2, _AROUND * max(width, height)) if area >= least else None


# --- the network's file


def landmark_file() -> Path | None:
    """The file in the user's cache folder if it has been fetched; None otherwise."""
    path = _place()
    try:
        return path if path.stat().st_size == _BYTES else None
    except OSError:
        return None


def fetch_landmark_file(
    stopped: Callable[[], bool], say: Callable[[str], None] = lambda line: None, *, pip: Sequence[str] | None = None
) -> Path:
    """Downloads the wheel, and keeps its pose network. Only at the user's wish: it uses the network.

    Args:
        stopped, say, pip: see ``run_pip``.

    Returns:
        The file's path.

    Raises:
        FrogError: if no wheel came, it holds another file, or the file cannot be written.
        Stopped: if ``stopped`` said so.
    """
    if (kept := landmark_file()) is not None:
        return kept
    with tempfile.TemporaryDirectory(prefix="frog-landmarks-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        run_pip(["download", *_PIP_ARGUMENTS, "--dest", str(folder)], folder, stopped, say=say, pip=pip)
        wheels = sorted(folder.glob("mediapipe-*.whl"))
        if not wheels:
            raise FrogError("The download ended without a wheel of mediapipe, expected one with the landmark file.")
        write_atomically(_place(), _network_in(wheels[0]))
    return _place()


def read_landmark_file(path: Path) -> bytes:
    """The file's bytes. FrogError for any other file: OpenCV is given nothing that it might stumble over."""
    unreadable = in_words(f"{path}: found a file that cannot be read", ", expected the landmark file.")
    with unreadable, path.open("rb") as file:
        content = file.read(_BYTES + 1)
    return _checked(content, path, "delete it")


def _place() -> Path:
    return default_cache_folder() / "networks" / NAME


def _network_in(wheel: Path) -> bytes:
    """The network's bytes, and no others."""
    try:
        with zipfile.ZipFile(wheel) as archive, archive.open(_MEMBER) as member:
            content = member.read(_BYTES + 1)  # whatever the archive says its size is
    except (OSError, KeyError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise found_instead(wheel.name, f"no {NAME} ({brief(error)})", "the wheel of mediapipe 0.10.21") from error
    return _checked(content, wheel.name, "nothing was kept")


def _checked(content: bytes, source: Path | str, remedy: str) -> bytes:
    if hashlib.sha256(content).hexdigest() != _SHA256:
        raise found_instead(source, "another file, or a damaged one", f"{NAME} of mediapipe 0.10.21; {remedy}")
    return content
