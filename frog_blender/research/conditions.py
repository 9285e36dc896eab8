"""Corrupted captures: the conditions under which methods fail, each a function of a clean capture.

Corruptions of images are ``Alteration``: deterministic, so that the same image always gets the same corruption.
Held-out images stay as they are unless the whole scene changes.
"""

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .. import engine as frog

BASES = {
    "clean": "any capture of several static cameras",
    "long": "a video of at least 300 frames (examples/make_long.py)",
    "dim": "a dark scene with hard moving shadows (examples/make_dim.py)",
    "appearing": "a scene with something that appears (examples/make_fast.py)",
    "still": "a scene in which nothing moves (examples/make_still.py)",
}
"""The captures that conditions are made from."""
CLEAN = "clean"
_NUM_FRAMES = 30


class _Corruption(frog.Alteration):
    """The random numbers that all corruptions of images share."""

    def _random(self, camera: str, frame: int = -1) -> np.random.Generator:
        """Random numbers of one camera, or of one of its images."""
        return np.random.default_rng([zlib.crc32(repr(self).encode()), zlib.crc32(camera.encode()), frame + 1])


@dataclass(frozen=True)
class Exposure(_Corruption):
    """Each camera has its own constant exposure, with a standard deviation of ``stops``."""

    stops: float

    def apply(self, image: frog.ImageArray, camera: str, frame: int) -> frog.ImageArray:
        return _brightened(image, 2 ** self._random(camera).normal(0, self.stops))


@dataclass(frozen=True)
class Light(_Corruption):
    """``gain`` times the light, in the held-out images as well."""

    gain: float
    tests_too = True

    def apply(self, image: frog.ImageArray, camera: str, frame: int) -> frog.ImageArray:
        return _brightened(image, self.gain)


@dataclass(frozen=True)
class Noise(_Corruption):
    """Gaussian noise in every pixel and channel, with a standard deviation of ``deviation`` of 255."""

    deviation: float

    def apply(self, image: frog.ImageArray, camera: str, frame: int) -> frog.ImageArray:
        noise = self._random(camera, frame).normal(0, self.deviation, image.shape)
        return (image + noise).round().clip(0, 255).astype(np.uint8)


@dataclass(frozen=True)
class Compression(_Corruption):
    """JPEG of this ``quality`` (1 to 100), chroma at half the resolution."""

    quality: int

    def apply(self, image: frog.ImageArray, camera: str, frame: int) -> frog.ImageArray:
        cv2 = frog.load_opencv()
        _, data = cv2.imencode(".jpg", image[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, self.quality])
        decoded: frog.ImageArray = cv2.imdecode(data, cv2.IMREAD_COLOR)
        return np.ascontiguousarray(decoded[:, :, ::-1])


@dataclass(frozen=True)
class Occlusion(_Corruption):
    """A grey figure, half an image high, walks past each camera at its own time in ``frames``, in ``share`` of them."""

    share: float
    frames: int = _NUM_FRAMES

    def apply(self, image: frog.ImageArray, camera: str, frame: int) -> frog.ImageArray:
        random = self._random(camera)
        begin, grey = random.random() * self.frames, random.integers(40, 120)
        passed = ((frame - begin) % self.frames) / (self.share * self.frames)
        if passed >= 1:
            return image
        height, width = image.shape[:2]
        center = (round(passed * width), round(0.6 * height))
        size = (round(0.11 * height), round(0.27 * height))
        return np.asarray(frog.load_opencv().ellipse(image.copy(), center, size, 0, 0, 360, (int(grey),) * 3, -1))


def _brightened(image: frog.ImageArray, gain: float) -> frog.ImageArray:
    """An sRGB image (H, W, 3) with ``gain`` times the light, clipped as its camera would."""
    table: frog.ImageArray = (255 * brightened_values(np.arange(256) / 255, gain)).round().astype(np.uint8)
    return table[image]


def brightened_values(values: frog.Floats, gain: float) -> frog.Floats:
    """sRGB values in [0, 1], of any shape, with ``gain`` times the light, clipped to [0, 1]."""
    return frog.linear_to_srgb((frog.srgb_to_linear(values) * gain).clip(0, 1))


def fewer_views(capture: frog.Capture, count: int) -> frog.Capture:
    """The ``count`` training cameras that are farthest apart, starting from the most central one.

    Raises:
        FrogError: if the capture has fewer.
    """
    training = [camera for camera in capture.cameras if camera.name not in capture.test_cameras]
    if len(training) < count:
        raise frog.FrogError(f"{capture.path}: {count} views are asked for, found {len(training)} to train on.")
    centers = np.array([camera.center for camera in training])
    chosen = [int(np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmin())]
    while len(chosen) < count:
        distances = np.linalg.norm(centers[:, None] - centers[chosen], axis=2).min(axis=1)
        chosen.append(int(distances.argmax()))
    kept = {training[index].name for index in chosen}
    return capture.without_cameras([camera.name for camera in training if camera.name not in kept])


def wrong_poses(capture: frog.Capture, degrees: float) -> frog.Capture:
    """Training cameras with noise in their poses.

    Args:
        degrees: standard deviation of the rotation about each axis. That of the translation along each axis is the
            same angle times the rig's radius.
    """
    random = np.random.default_rng(7)
    centers = np.array([camera.center for camera in capture.cameras])
    size = float(np.median(np.linalg.norm(centers - centers.mean(axis=0), axis=1)))
    angle = np.radians(degrees)

    def moved(camera: frog.Camera) -> frog.Camera:
        turn, step = random.normal(0, angle, 3), random.normal(0, angle * size, 3)
        return camera if camera.name in capture.test_cameras else camera.moved(turn, step)

    return capture.with_cameras(moved(camera) for camera in capture.cameras)


def wrong_clocks(capture: frog.Capture, most: int) -> frog.Capture:
    """Each training camera is out of sync by up to ``most`` frames; frames that its video lacks have no image."""
    random = np.random.default_rng(11)
    late = {
        index: 0 if camera.name in capture.test_cameras else int(random.integers(-most, most + 1))
        for index, camera in enumerate(capture.cameras)
    }
    recorded = {(shot.camera, shot.frame): shot for shot in capture.shots}

    def shown(shot: frog.Shot) -> frog.Shot | None:
        source = recorded.get((shot.camera, shot.frame + late[shot.camera]))
        return source and replace(shot, path=source.path, index=source.index, offset=source.offset)

    shots = tuple(late_shot for shot in capture.shots if (late_shot := shown(shot)) is not None)
    return replace(capture, shots=shots)


def faster(capture: frog.Capture, pace: int, count: int = _NUM_FRAMES) -> frog.Capture:
    """Every ``pace``-th frame of the capture, ``count`` in all: motion that is ``pace`` times as fast."""
    recorded = capture.segment(0, pace * count)
    kept = (shot for shot in recorded.shots if shot.frame % pace == 0)
    shots = tuple(replace(shot, frame=shot.frame // pace, offset=shot.offset / pace) for shot in kept)
    frames = frozenset(frame // pace for frame in recorded.test_frames if frame % pace == 0)
    return replace(recorded, shots=shots, frame_count=count, test_frames=frames)


@dataclass(frozen=True)
class Condition:
    """A capture, and what is wrong with it.

    Attributes:
        name: unique, such as ``"views 3"``; conditions of a first word differ in severity.
        base: one of ``BASES``.
        change: makes the capture from its base.
        settings: of the recipe, for conditions that concern the training instead of the capture.
        light: of the whole scene, relative to the base. PSNR rises as images darken, so both images are brightened
            by its inverse before they are compared.
        against: the name of the condition that this one is compared with; "" for none.
    """

    name: str
    base: str = CLEAN
    change: Callable[[frog.Capture], frog.Capture] = lambda capture: capture
    settings: Mapping[str, Any] = field(default_factory=dict)
    light: float = 1.0
    against: str = CLEAN

    def opened(self, folder: Path) -> frog.Capture:
        """The capture in ``folder`` under this condition."""
        return self.change(frog.open_capture(folder))


def _altered(alteration: frog.Alteration, capture: frog.Capture) -> frog.Capture:
    return replace(capture, alteration=alteration)


_LIVELY = partial(Condition, base="long", against="speed 1x")

CONDITIONS = {
    condition.name: condition
    for condition in (
        Condition(CLEAN, against=""),
        *(Condition(f"points {share:.0%}", settings={"seed_share": share}) for share in (0.1, 0.01, 0.0)),
        *(Condition(f"views {count}", change=partial(fewer_views, count=count)) for count in (6, 3)),
        *(Condition(f"poses {angle:g} deg", change=partial(wrong_poses, degrees=angle)) for angle in (0.1, 0.4)),
        *(Condition(f"clocks {most}", change=partial(wrong_clocks, most=most)) for most in (1, 2)),
        *(Condition(f"exposure {stops:g}", change=partial(_altered, Exposure(stops))) for stops in (0.1, 0.3)),
        *(Condition(f"noise {level}", change=partial(_altered, Noise(level))) for level in (5, 15)),
        *(Condition(f"jpeg {quality}", change=partial(_altered, Compression(quality))) for quality in (50, 15)),
        *(Condition(f"occluded {share:.0%}", change=partial(_altered, Occlusion(share))) for share in (0.1, 0.3)),
        Condition("speed 1x", "long", partial(faster, pace=1), against=""),
        *(_LIVELY(f"speed {pace}x", change=partial(faster, pace=pace)) for pace in (2, 4)),
        *(
            _LIVELY(f"moments {count}", change=partial(frog.Capture.segment, first=0, count=count))
            for count in (120, 300)
        ),
        Condition("light 1", "dim", partial(_altered, Light(1.0)), against=""),
        *(
            Condition(f"light {gain:g}", "dim", partial(_altered, Light(gain)), light=gain, against="light 1")
            for gain in (0.25, 0.0625)
        ),
        Condition("appearing", "appearing", against=""),
        Condition("nothing moves", "still", against=""),
    )
}
"""In the order of the tables; within a first word by severity."""
