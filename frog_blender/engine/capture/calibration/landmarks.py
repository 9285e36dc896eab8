"""A person's joints in images, by the pose network whose file the user fetches once.

The file is BlazePose's, of MediaPipe, under the Apache licence; OpenCV runs it. MediaPipe's refinement by heatmaps is
repeated here (RefineLandmarksFromHeatmapCalculator): without it the cameras that follow are twice as wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...arrays import Float64s, ImageArray
from ...errors import found_instead, reason
from ..video import load_opencv
from .landmark_file import read_landmark_file

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
_MIRRORED = [JOINTS.index(joint + 1 if joint % 2 else joint - 1) for joint in JOINTS]  # left for right
_SURE = 0.03  # of the box's side: how far apart a joint may be found in the image and in its mirror image
_OUTPUTS = {"Identity": "landmarks", "Identity_1": "score", "Identity_3": "heatmaps"}


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
        crop = cv2.warpAffine(colored, to_image[:2], (_SIDE, _SIDE), flags=sharp | cv2.WARP_INVERSE_MAP)
        landmarks, score, heatmaps = self._run(crop)
        if score < _LEAST_PERSON:
            return None
        places = _refined(landmarks[:, :2] / _SIDE, heatmaps) * _SIDE
        pixels = places @ to_image[:2, :2].T + to_image[:2, 2] + 0.5
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
        pixels = mirrored.pixels[_MIRRORED] * (-1.0, 1.0) + (width, 0.0)
        is_sure = np.linalg.norm(pixels - person.pixels, axis=1) < _SURE * box.side
        visibility = np.where(is_sure, (person.visibility + mirrored.visibility[_MIRRORED]) / 2, 0.0)
        return Person((person.pixels + pixels) / 2, visibility, person.box)

    def _run(self, crop: ImageArray) -> tuple[Float64s, float, Float64s]:
        """(39, 5) landmarks in pixels of the crop, the confidence, (39, 64, 64) heatmaps before the sigmoid."""
        self._network.setInput(np.ascontiguousarray(crop.transpose(2, 0, 1)[None], np.float32) / 255.0)
        landmarks, score, heatmaps = (np.asarray(output, np.float64) for output in self._network.forward(self._names))
        return landmarks.reshape(_LANDMARKS, 5), float(score.reshape(-1)[0]), heatmaps.reshape(_LANDMARKS, 64, 64)


def _from_crop(box: Box) -> Float64s:
    """(3, 3) from positions in the network's image to those in the whole one."""
    scale = box.side / _SIDE
    cosine, sine = np.cos(box.turn) * scale, np.sin(box.turn) * scale
    turned = np.array([[cosine, -sine], [sine, cosine]])
    matrix = np.eye(3)
    matrix[:2, :2] = turned
    matrix[:2, 2] = np.array([box.x, box.y]) - turned @ np.full(2, _SIDE / 2)
    return matrix


def _box_about(center: Float64s, reach: Float64s) -> Box:
    """The square about a person, upright in it."""
    along = reach - center
    return Box(
        float(center[0]),
        float(center[1]),
        float(2.0 * _MARGIN * np.hypot(*along)),
        float(np.pi / 2 + np.arctan2(along[1], along[0])),
    )


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
