"""What ``quality_check`` looks at, and what of it: features, brightness where they lie, blur, the next frame."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from ..arrays import Float32s, Float64s, ImageArray
from .camera import Camera
from .capture import Capture
from .decoding import decode_shots
from .seeding.matching import root_sift
from .seeding.views import neighbours, scene_depth, spread
from .video import load_opencv

_LONGEST_SIDE = 1280  # pixels: smaller errors than one of these do no harm
_FEATURES = 2000  # an image
_FRAMES = 3  # of standing cameras
_FIRST_FRAMES = 240  # among which they are chosen: videos are decoded up to the last
_MOST_PAIRS = 32
_REFERENCES = 12  # of a moving camera
_TAPS = 9  # of the blur that tells how blurred an image is
Pair = tuple[int, int]
"""Two shots that see the same things, at the same frame where cameras stand."""


@dataclass(frozen=True, eq=False)
class Sample:
    """What is kept of an image.

    Attributes:
        camera: at the size of the image.
        scale: pixels of the capture's image for one of this one.
        gray: (H, W) uint8.
        following: (H, W) uint8 of the next frame; None where there is none.
        positions: (N, 2) of features, pixel centres at +0.5.
        descriptors: (N, 128), of length 1.
        colors: (N, 3) mean around the features, 0 to 255.
        blur: see ``_blur_of``.
    """

    camera: Camera
    scale: float
    gray: ImageArray
    following: ImageArray | None
    positions: Float64s
    descriptors: Float32s
    colors: Float64s
    blur: float


def choose_pairs(capture: Capture) -> list[Pair]:
    """Pairs of shots of neighbouring cameras, at some frames; of a moving camera pairs of near frames."""
    if not capture.shots:
        return []
    depth, pairs = scene_depth(capture.cameras), list[Pair]()
    if capture.has_moving_cameras:
        shots = range(len(capture.shots))
        for shot in spread(shots, _REFERENCES):
            near = neighbours(capture, shot, shots, depth, 1, best_angle=4.0)
            pairs += [(min(shot, other), max(shot, other)) for other in near]
        return list(dict.fromkeys(pairs))
    for frame in _frames(capture):
        at_frame = [index for index, shot in enumerate(capture.shots) if shot.frame == frame]
        for shot in at_frame:
            others = neighbours(capture, shot, at_frame, depth, 2, best_angle=8.0) or _nearest(capture, shot, at_frame)
            pairs += [(min(shot, other), max(shot, other)) for other in others]
    pairs = list(dict.fromkeys(pairs))
    cameras = [tuple(capture.shots[shot].camera for shot in pair) for pair in pairs]
    kept = spread(list(dict.fromkeys(cameras)), _MOST_PAIRS)
    return [pair for pair, of in zip(pairs, cameras, strict=True) if of in kept]


def take_samples(capture: Capture, pairs: Sequence[Pair], progress: Callable[[int, int], None]) -> dict[int, Sample]:
    """The samples of all shots in the pairs, by shot.

    Raises:
        FrogError: if a file cannot be decoded.
    """
    factor = min(1.0, _LONGEST_SIDE / max(max(camera.width, camera.height) for camera in capture.cameras))
    small = capture.scaled(factor)
    following: dict[int, int | None] = {}
    for shot in sorted({shot for pair in pairs for shot in pair}):
        entry = capture.shots[shot]
        following[shot] = None if capture.has_moving_cameras else capture.shot_index(entry.camera, entry.frame + 1)
    needed = {*following, *following.values()}
    order = [index for index in small.decoding_order if index in needed]
    samples: dict[int, Sample] = {}
    done = 0
    for camera, group in groupby(order, key=lambda index: capture.shots[index].camera):  # of one at a time
        shots, images = list(group), dict[int | None, ImageArray]()
        for shot, image in zip(shots, decode_shots(small, shots), strict=True):
            images[shot] = image
            done += 1
            progress(done, len(order))
        scale = capture.cameras[camera].width / small.cameras[camera].width
        for shot in following.keys() & images.keys():
            samples[shot] = _sample(small.cameras[camera], scale, images[shot], images.get(following[shot]))
    return samples


def _frames(capture: Capture) -> list[int]:
    """Frames early on of which most cameras have an image."""
    frames = [shot.frame for shot in capture.shots]
    counts = Counter(frame for frame in frames if frame < _FIRST_FRAMES) or Counter(frames)
    most = max(counts.values())
    full = sorted(frame for frame, count in counts.items() if count == most)
    inner = full[len(full) // 8 : max(len(full) // 8 + 1, len(full) - len(full) // 8 - 1)]
    return spread(inner, _FRAMES)


def _nearest(capture: Capture, shot: int, candidates: Sequence[int]) -> list[int]:
    """The shot of the nearest other camera."""
    center = capture.cameras[capture.shots[shot].camera].center
    others = [index for index in candidates if capture.shots[index].camera != capture.shots[shot].camera]
    distances = [np.linalg.norm(capture.cameras[capture.shots[index].camera].center - center) for index in others]
    return [others[int(np.argmin(distances))]] if others else []


def _sample(camera: Camera, scale: float, image: ImageArray, following: ImageArray | None) -> Sample:
    cv2 = load_opencv()
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    after = None if following is None else cv2.cvtColor(following, cv2.COLOR_RGB2GRAY)
    positions, descriptors = root_sift(gray, _FEATURES, 0.01)
    columns, lines = np.clip(positions.astype(int), 0, [camera.width - 1, camera.height - 1]).T
    colors = cv2.blur(image, (7, 7))[lines, columns].astype(np.float64)
    return Sample(camera, scale, gray, after, positions, descriptors, colors, _blur_of(gray))


def _blur_of(gray: ImageArray) -> float:
    """0 (sharp) to 1 (nothing but blur) of brightness (H, W) uint8: of the worse of the two directions.

    It is what blurring once more takes from the edges (Crete, Dolmiere, Ladret, Nicolas 2007): a sharp image loses most
    of the differences between neighbouring pixels, a blurred one hardly any. NaN for an image without edges.
    """
    cv2 = load_opencv()
    values = gray.astype(np.float32)
    shares = []
    for axis, kernel in ((0, (1, _TAPS)), (1, (_TAPS, 1))):
        before = np.abs(np.diff(values, axis=axis))
        after = np.abs(np.diff(cv2.blur(values, kernel), axis=axis))
        total = float(before.sum())
        if total < 0.5 * before.size**0.5:
            return float("nan")
        shares.append((total - float(np.maximum(before - after, 0).sum())) / total)
    return max(shares)
