"""The quality of a scene seen from cameras off the rig, by images of their own. No torch."""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array, Float64s
from ..capture.camera import Camera
from ..capture.capture import Capture
from ..capture.readers.checks import path_inside, read_json
from ..capture.readers.transforms_json import posed_images
from ..capture.video import load_opencv, read_image, read_mask
from ..capture.world import World
from ..errors import brief, found_instead
from ..frames.store import FrameStore
from ..io.numpy_files import read_npy
from ..notices import say
from ..playback.player import ScenePlayer
from ..playback.render import draw
from .evaluate import Figures, as_trained, open_as_read, training_of
from .masks import Mask
from .metrics import Image, psnr_of


@dataclass(frozen=True, eq=False)
class FlyImage:
    """One image from off the rig.

    Attributes:
        camera: in the coordinates of the capture's files, named after the image.
        path: the image.
        group: what kind of place it was taken from.
        frame: the capture's, from 0.
        mask_path: an image that is black where pixels do not count; None where all do.
        depth_path: an ``.npy`` of the planar depth (H, W) of what it shows; None where that is not known.
        source_path: an image of the number, from 1, in ``training_cameras`` of one that shows the same, 0 for none.
    """

    camera: Camera
    path: Path
    group: str
    frame: int
    mask_path: Path | None
    depth_path: Path | None
    source_path: Path | None

    def mask(self) -> Mask:
        """(H, W) the pixels that count."""
        shape = self.camera.height, self.camera.width
        return np.ones(shape, bool) if self.mask_path is None else self._fitting(self.mask_path, read_mask) > 127

    def sources(self) -> tuple[Float64s, Array] | None:
        """(H, W, 3) what each pixel shows, in the coordinates of the capture's files, and (H, W) the number of a
        training camera that shows it; None where the list does not say."""
        if self.depth_path is None or self.source_path is None:
            return None
        camera = self.camera
        depths = self._fitting(self.depth_path, lambda path: read_npy(path, "depths", camera.width * camera.height))
        x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        pixels = np.stack([x.ravel(), y.ravel()], axis=1)
        along = camera.ray_directions(pixels) @ camera.forward
        points = camera.unproject(pixels, depths.ravel() / along).reshape(*depths.shape, 3)
        return points, self._fitting(self.source_path, read_mask)

    def _fitting(self, path: Path, read: Callable[[Path], Array]) -> Array:
        array, shape = read(path), (self.camera.height, self.camera.width)
        if array.shape != shape:
            raise found_instead(path, f"an array of {array.shape}", f"{shape} as {self.path.name}")
        return array


def read_fly(file: Path, frame_count: int) -> tuple[list[FlyImage], list[str]]:
    """The images of a ``transforms.json``, and the names of its ``training_cameras``.

    Each image needs a ``frame``. ``group`` is its own name where it is not given; ``mask_path``, ``depth_file_path``
    and ``source_path`` may lack (see ``FlyImage``).

    Raises:
        FrogError: for a value that cannot be used, or an image that is not there.
    """
    images = []
    for camera, path, own in posed_images(file):
        frame = own.get("frame")
        if type(frame) is not int or not 0 <= frame < frame_count:
            expected = f"the capture's frame that it shows, from 0 to {frame_count - 1}"
            raise found_instead(file, f'{brief(frame)} as "frame" of {path.name}', expected)
        keys = ("mask_path", "depth_file_path", "source_path")
        others = [path_inside(file.parent, own[key], file, key) if key in own else None for key in keys]
        images.append(FlyImage(camera, path, str(own.get("group", camera.name)), frame, *others))
    names = read_json(file).get("training_cameras", [])
    return images, list(map(str, names)) if isinstance(names, list) else []


OneImage = Callable[[FlyImage, Image, Mask], float | None]
"""The PSNR in dB of another prediction of an image, by its colours (H, W, 3) and the pixels that count."""


def fly_figures(
    scene: ScenePlayer,
    world: World,
    images: Sequence[FlyImage],
    *,
    one_image: OneImage = lambda image, truth, mask: None,
    progress: Callable[[int, int], None] | None = None,
) -> Figures:
    """PSNR (dB) of a scene in images from off the rig, at their own size, over the pixels that count.

    "groups" has for each group the means over its images: "psnr", and "one_image", that of the colours which a training
    image, magnified, has for the same surfaces (None where the list does not say which). "fly" and "one_image" are
    their means over the groups.

    Args:
        world: of the scene's coordinates.
        images: see ``read_fly``.
        one_image: what gives "one_image".
    """
    ratios: defaultdict[str, list[dict[str, float | None]]] = defaultdict(list)
    for done, image in enumerate(images, 1):
        truth, mask = read_image(image.path).astype(np.float32) / 255, image.mask()
        drawing = draw(scene.at_frame(image.frame), world.local_camera(image.camera), scene.header.background)
        say(drawing.notice)
        own = _psnr(drawing.rgb.clip(0, 1), truth, mask)
        ratios[image.group].append({"psnr": own, "one_image": one_image(image, truth, mask)})
        if progress:
            progress(done, len(images))
    groups: dict[str, dict[str, Any]] = {
        group: {**{name: _mean(ratio[name] for ratio in of_images) for name in of_images[0]}, "frames": len(of_images)}
        for group, of_images in ratios.items()
    }
    fly, other = (_mean(group[name] for group in groups.values()) for name in ("psnr", "one_image"))
    return {"fly": fly, "one_image": other, "frames": len(images), "groups": groups}


def evaluate_fly(
    scene_path: Path, capture_path: Path, cameras: Path, *, progress: Callable[[int, int], None] | None = None
) -> Figures:
    """What ``fly_figures`` says of a scene file, and what it is.

    Args:
        cameras: see ``read_fly``.

    Raises:
        FrogError: if a file cannot be read or does not fit, or the capture is another one than that of the training.
    """
    scene = ScenePlayer.load(scene_path)
    capture = open_as_read(scene.header, capture_path)
    as_trained(scene.header, capture)
    images, names = read_fly(cameras, scene.header.frame_count)
    one_image = _looked_up(capture, names, cameras)
    return {
        **fly_figures(scene, capture.world, images, one_image=one_image, progress=progress),
        **training_of(scene),
        "bytes": scene_path.stat().st_size,
    }


def _looked_up(capture: Capture, names: list[str], file: Path) -> OneImage:
    """By what one training image shows of the surfaces in an image from elsewhere: what needs no scene."""
    known = [camera.name for camera in capture.cameras]
    if unknown := sorted(set(names) - set(known)):
        raise found_instead(file, f"{unknown[0]} among the training_cameras", f"some of {', '.join(known)}")
    training = list(enumerate(map(known.index, names), 1))
    store = FrameStore.open(capture) if names else None

    def psnr(image: FlyImage, truth: Image, mask: Mask) -> float | None:
        sources = image.sources()
        if sources is None or store is None:
            return None
        points, numbers = sources
        cv2, shown, found = load_opencv(), np.zeros_like(truth), np.zeros_like(mask)
        for number, index in training:
            chosen, shot = mask & (numbers == number), capture.shot_index(index, image.frame)
            if shot is None or not chosen.any():
                continue
            places = np.zeros((*mask.shape, 2), np.float32)
            places[chosen] = capture.cameras[index].project(capture.world.local_points(points[chosen]))[0] - 0.5
            colors = store.image(shot).astype(np.float32) / 255
            taken = cv2.remap(colors, places, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            shown[chosen] = taken[chosen]
            found |= chosen
        return _psnr(shown, truth, found)

    return psnr


def _psnr(image: Image, truth: Image, mask: Mask) -> float | None:
    """In dB over the mask; None for an empty one."""
    return psnr_of(float(((image.astype(np.float64) - truth) ** 2)[mask].mean())) if mask.any() else None


def _mean(values: Iterable[float | None]) -> float | None:
    """Of those that are known; None for none."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
