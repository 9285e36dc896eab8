"""What images of a scene show: which frame, as which camera sees it. Cameras of files."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..capture.camera import Camera
from ..capture.natural_order import natural
from ..capture.readers.checks import number
from ..capture.readers.colmap_model import has_model, read_model
from ..capture.readers.transforms_json import posed_cameras
from ..errors import UsageError, found_instead
from ..notices import say
from ..scene.header import SceneHeader


@dataclass(frozen=True, eq=False)
class View:
    """One image of a scene.

    Attributes:
        number: of the image, which stands in the name of its file.
        frame: the capture's that it shows, counted from 0; fractions are legal. None where the scene is not there.
        camera: in the scene's coordinates.
    """

    number: int
    frame: float | None
    camera: Camera


def read_cameras(path: Path, header: SceneHeader) -> list[View] | list[Camera]:
    """The cameras in a file, in a scene's coordinates: views, where it says which frames they show.

    Args:
        path: a ``transforms.json``, whose images need not be there; each may have the "frame" that it shows and a
            "number". Or the folder of a COLMAP model, in the order of its images' names. Either has the coordinates of
            the capture's files.
        header: of the scene.

    Raises:
        FrogError: for another file, or a value that cannot be used.
    """
    if path.is_dir():
        folder = next((tried for tried in (path, path / "sparse" / "0") if has_model(tried)), None)
        if folder is None:
            raise found_instead(path, "a folder without a COLMAP model", "one, or the path of a transforms.json")
        model = read_model(folder)
        images = sorted(model.images, key=lambda image: natural(image.name))
        posed = [(model.camera(image, image.name), dict[str, object]()) for image in images]
    else:
        posed = [(calibrated, own) for calibrated, _, own in posed_cameras(path)]
    if any(lens is not None for (_, lens), _ in posed):
        say(f"{path}: images are drawn without the distortion of its lenses.")
    cameras = [header.world.local_camera(camera) for (camera, _), _ in posed]
    frames = [number(own["frame"], path, "frame") for _, own in posed if "frame" in own]
    if frames and (len(frames) < len(posed) or min(frames) < 0 or max(frames) > header.frame_count - 1):
        found = f"{len(frames)} of {len(posed)} images with frames from {min(frames):g} to {max(frames):g}"
        raise found_instead(path, found, f"all of them or none, from 0 to {header.frame_count - 1}")
    numbers = [round(number(own.get("number", index), path, "number")) for index, (_, own) in enumerate(posed)]
    return list(map(View, numbers, frames, cameras)) if frames else cameras


def views_at(cameras: Sequence[Camera], frames: Sequence[tuple[int, float | None]]) -> list[View]:
    """One camera at all frames, all cameras at one frame, or as many of both, in order.

    Args:
        frames: the number of an image, and the capture's frame that it shows; of a single frame, the images are
            numbered from 0.

    Raises:
        FrogError: for numbers of both that do not fit.
    """
    if len(frames) == 1 < len(cameras):
        frames = [(index, frames[0][1]) for index in range(len(cameras))]
    if len(cameras) not in (1, len(frames)):
        expected = "as many of both, one camera, or one frame"
        raise UsageError(f"Found {len(cameras)} cameras and {len(frames)} frames, expected {expected}.")
    return [View(*frame, cameras[index % len(cameras)]) for index, frame in enumerate(frames)]


def sized(camera: Camera, width: int, height: int) -> Camera:
    """A camera with other pixels, as Blender renders an imported one at that size: it sees as much from left to right,
    and what proportions leave from top to bottom."""
    scale = width / camera.width
    larger = replace(camera, intrinsics=np.diag([scale, scale, 1.0]) @ camera.intrinsics)
    return larger.cropped(0, (camera.height * scale - height) / 2, width, height)
