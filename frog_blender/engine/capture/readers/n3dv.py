"""N3DV (Neural 3D Video): ``camNN.mp4`` and ``poses_bounds.npy`` in LLFF's convention.

A row of ``poses_bounds.npy`` is a 3 x 5 matrix [R | t | (H, W, f)], camera-to-world, followed by near and far.
The columns of R are LLFF's axes (down, right, backwards). Rows belong to the videos sorted by name; the numbers in
the names may have gaps. The principal point is the image's centre; the first camera is the test view.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError, found_instead
from ...io.numpy_files import read_npy
from ..camera import Camera
from ..capture import Capture, Shot
from ..image_size import image_size
from ..video import find_images, find_videos, read_facts
from .checks import numbers, rotation
from .geometry import intrinsics, is_transposed, pose
from .pairing import pair_videos

_POSES = "poses_bounds.npy"
_MAX_CAMERAS = 10_000


def matches(path: Path) -> bool:
    """True if the folder holds ``poses_bounds.npy``."""
    return (path / _POSES).is_file()


def read(path: Path) -> Capture:
    """Open an N3DV folder; a folder ``images`` stands in for videos of a single frame.

    Raises:
        FrogError: if videos and rows do not fit, or a value cannot be used.
    """
    rows = _read_rows(path / _POSES)
    videos = [video for video in find_videos(path) if video.stem.lower().startswith("cam")] or find_videos(path)
    folder = path / "images"
    images = find_images(folder) if not videos and folder.is_dir() else []
    if not videos and not images:
        raise found_instead(path, f"{len(rows)} poses and no video", f"{len(rows)} videos cam00.mp4, cam01.mp4, ...")
    sources = videos or images
    if len(rows) != len(sources):
        raise FrogError(
            f"{path / _POSES}: found {len(rows)} rows for {len(sources)} videos ({sources[0].name} to "
            f"{sources[-1].name}), expected one row for each video."
        )
    warnings: list[str] = []
    if videos:
        facts = [read_facts(video) for video in videos]
        sizes = [(fact.width, fact.height) for fact in facts]
        paired = pair_videos(path, videos, facts)
        frame_count, rate, shots = paired.frame_count, paired.frames_per_second, paired.shots
        warnings += paired.warnings
    else:
        sizes = [image_size(image) for image in images]
        frame_count, rate = 1, 30.0
        shots = tuple(Shot(index, 0, image, 0) for index, image in enumerate(images))
    cameras = [_camera(row, source, size) for row, source, size in zip(rows, sources, sizes, strict=True)]
    for camera, row in zip(cameras, rows, strict=True):
        stored_height, stored_width = row[4], row[9]
        if is_transposed((camera.width, camera.height), (stored_width, stored_height)):
            found = (
                f"{stored_width:g} x {stored_height:g} for images of {camera.width} x {camera.height} of {camera.name}"
            )
            raise found_instead(path / _POSES, found, "the same way up: they are turned by 90 degrees")
        if abs(camera.width / camera.height - stored_width / stored_height) > 0.01 * stored_width / stored_height:
            warnings.append(
                f"{path}: the images of {camera.name} are {camera.width} x {camera.height}, "
                f"{_POSES} says {stored_width:g} x {stored_height:g}: their proportions differ."
            )
    near_far = (float(rows[:, 15].min()), float(rows[:, 16].max()))
    return Capture(
        path=path,
        format="n3dv",
        cameras=tuple(cameras),
        distortions=(None,) * len(cameras),
        shots=shots,
        frame_count=frame_count,
        frames_per_second=rate,
        # With one camera nothing would be left to train on.
        test_cameras=frozenset({cameras[0].name}) if len(cameras) > 1 else frozenset(),
        near_far=near_far if 0 < near_far[0] < near_far[1] else None,
        warnings=tuple(warnings),
    )


def _read_rows(path: Path) -> Float64s:
    """(N, 17) float64 rows of ``poses_bounds.npy``, checked."""
    stored = read_npy(path, "numbers of shape (cameras, 17)", 17 * _MAX_CAMERAS)
    if stored.ndim != 2 or stored.shape[1] != 17:
        raise found_instead(path, f"{stored.dtype} of shape {stored.shape}", "numbers of shape (cameras, 17)")
    rows = np.array([numbers(row, (17,), path, f"row {index}") for index, row in enumerate(stored)]).reshape(-1, 17)
    bad = np.flatnonzero((rows[:, [4, 9, 14]] <= 0).any(axis=1))
    if bad.size:
        raise found_instead(
            path, f"a height, width or focal length of zero or less in row {bad[0]}", "positive numbers"
        )
    return rows


def _camera(row: Float64s, source: Path, size: tuple[int, int]) -> Camera:
    """The OpenCV camera of one row, at the size of its decoded frames."""
    matrix = row[:15].reshape(3, 5)
    down, right, backwards = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    camera_to_world = rotation(np.stack([right, down, -backwards], axis=1), source, "a pose in poses_bounds.npy")
    (stored_height, stored_width, focal), (width, height) = matrix[:, 4], size
    focal_x, focal_y = focal * width / stored_width, focal * height / stored_height
    lens = intrinsics(focal_x, focal_y, width / 2, height / 2)
    return Camera(source.stem, width, height, lens, pose(camera_to_world.T, matrix[:, 3]))
