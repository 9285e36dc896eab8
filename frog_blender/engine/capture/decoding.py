"""From files to a capture's images: decoded, undistorted and resized to their cameras."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, repeat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import Float64s, ImageArray
from ..errors import CaptureRefused, found_instead, told_as
from .camera import Camera
from .capture import Capture, Distortion, Shot
from .lenses import bend
from .masking import MaskSource, over, recolored
from .media import read_film_header
from .video import VIDEO_SUFFIXES, decode, load_opencv, read_alpha, read_image, read_mask

Maps = tuple[NDArray[np.int16], NDArray[np.uint16]]
_LINES = 256  # of an image, whose undistortion is computed at a time


_IGNORED = 127  # a mask of what is ignored is ignored where it is brighter


@dataclass(frozen=True, eq=False)
class DecodedShot:
    """One image with its masks, all at its camera's size.

    Attributes:
        image: (H, W, 3) uint8 RGB, contiguous; over the capture's background where there is an ``alpha``.
        alpha: (H, W) uint8, the subject's share of each pixel; None where it is all of the image.
        ignored: (H, W) uint8, 255 for pixels of which a part is to be ignored, else 0; None where nothing is.
    """

    image: ImageArray
    alpha: ImageArray | None = None
    ignored: ImageArray | None = None


def decode_shots(capture: Capture, order: Sequence[int]) -> Iterator[ImageArray]:
    """The frames of the shots in ``order`` whatever masks there are, see ``decode_masked``."""
    return (shot.image for shot in decode_masked(capture.without_masks(), order))


def decode_masked(capture: Capture, order: Sequence[int]) -> Iterator[DecodedShot]:
    """The frames of the shots in ``order`` and their masks.

    Shots of one video must follow each other in ascending frames; an image and its masks are open at a time.

    Raises:
        CaptureRefused: if a file cannot be decoded, its proportions are not the camera's, or a mask has another size.
    """
    with told_as(CaptureRefused):
        yield from _decoded(capture, order)


def _decoded(capture: Capture, order: Sequence[int]) -> Iterator[DecodedShot]:
    for (camera_index, path), group in groupby(order, key=lambda i: (capture.shots[i].camera, capture.shots[i].path)):
        shots = [capture.shots[index] for index in group]
        camera, distortion = capture.cameras[camera_index], capture.distortions[camera_index]
        if path.suffix.lower() in VIDEO_SUFFIXES:
            images: Iterator[ImageArray] = decode(path, [shot.index for shot in shots])
            aspect = read_film_header(path).aspect if capture.has_masks else 1.0
        else:
            aspect = 1.0
            # One image may serve several frames: a damaged one is replaced by that of the frame before.
            images = repeat(read_image(path, capture.background), len(shots))
        maps: Maps | None = None
        map_shape: tuple[int, ...] = ()
        alphas, ignores = (_masks([getattr(shot, kind) for shot in shots]) for kind in ("mask", "ignore"))
        for shot, image, alpha, ignored in zip(shots, images, alphas, ignores, strict=True):
            alpha = _fitting(alpha, image, shot.mask, aspect)
            ignored = _fitting(ignored, image, shot.ignore, aspect)
            if image.shape != map_shape:
                map_shape = image.shape
                _check_proportions(camera, map_shape, path)
                maps = None if distortion is None else undistortion_maps(camera, distortion, map_shape[1], map_shape[0])
            image, alpha = _matted(capture, shot, image, alpha)
            yield DecodedShot(
                _finish(image, camera, maps),
                None if alpha is None else _finish(alpha, camera, maps),
                None if ignored is None else _touched(_finish(_touched(ignored, _IGNORED), camera, maps), 0),
            )


def _matted(
    capture: Capture, shot: Shot, image: ImageArray, alpha: ImageArray | None
) -> tuple[ImageArray, ImageArray | None]:
    """A stored image over the capture's background, and its alpha by its mask, its own transparency and the key."""
    if capture.key is not None:
        image, keyed = capture.key.apply(image)
        if alpha is not None:
            image = over(image, alpha, (0.0, 0.0, 0.0))
            keyed = ((keyed.astype(np.uint16) * alpha + 127) // 255).astype(np.uint8)
        return recolored(image, keyed, (0.0, 0.0, 0.0), capture.background), keyed
    if alpha is not None and shot.mask is not None and not shot.mask.is_alpha:
        image = over(image, alpha, capture.background)
    return image, alpha  # an image's own transparency already lies over the background


def _masks(sources: Sequence[MaskSource | None]) -> Iterator[ImageArray | None]:
    """The masks (H, W) of shots of one file; one that serves several shots is decoded once."""
    for path, group in groupby(sources, key=lambda source: None if source is None else source.path):
        same = list(group)
        given = [source for source in same if source is not None]
        if path is None:
            yield from repeat(None, len(same))
        elif path.suffix.lower() in VIDEO_SUFFIXES:
            images = decode(path, [source.index for source in given])
            yield from (_meant(image.max(axis=2), given[0]) for image in images)
        else:
            mask = read_alpha(path) if given[0].is_alpha else read_mask(path)
            yield from repeat(_meant(mask, given[0]), len(same))


def _meant(mask: ImageArray, source: MaskSource) -> ImageArray:
    return ~mask if source.inverted else mask


def _touched(mask: ImageArray, above: int) -> ImageArray:
    """(H, W) uint8, 255 where a mask is above a value, else 0."""
    return np.where(mask > above, np.uint8(255), np.uint8(0))


def _fitting(mask: ImageArray | None, image: ImageArray, source: MaskSource | None, aspect: float) -> ImageArray | None:
    """A mask at its image's size; that of an image before its pixels of ``aspect`` were made square is resized."""
    if mask is None or source is None or mask.shape == image.shape[:2]:
        return mask
    height, width = image.shape[:2]
    if aspect == 1 or mask.shape not in ((height, round(width / aspect)), (round(height / aspect), width)):
        found = f"a mask of {mask.shape[1]} x {mask.shape[0]} pixels"
        raise found_instead(source.path, found, f"{width} x {height} pixels as its image has")
    return np.asarray(load_opencv().resize(mask, (width, height), interpolation=load_opencv().INTER_LINEAR))


def undistortion_maps(camera: Camera, distortion: Distortion, width: int, height: int) -> Maps:
    """For each pixel of the undistorted image its position in the stored one (fixed-point, for ``cv2.remap``).

    Both images are ``width`` x ``height`` pixels and share the camera's K at that size, or the stored one has the K of
    ``distortion.lens``.
    """
    cv2 = load_opencv()
    if distortion.lens is not None:
        return _lens_maps(camera.resized(width, height), distortion, distortion.lens)
    intrinsics = camera.resized(width, height).intrinsics.copy()
    intrinsics[:2, 2] -= 0.5  # OpenCV counts pixel centres from 0, the camera from 0.5
    given = (intrinsics, distortion.coefficients, None, intrinsics, (width, height))
    if not distortion.skew:
        maps = cv2.initUndistortRectifyMap(*given, cv2.CV_16SC2)
        return maps[0], maps[1]
    columns, lines = cv2.initUndistortRectifyMap(*given, cv2.CV_32FC1)
    # OpenCV's distortion knows no skew: x_pixel = f_x (x + skew y) + c_x
    columns += distortion.skew * intrinsics[0, 0] * (lines - intrinsics[1, 2]) / intrinsics[1, 1]
    maps = cv2.convertMaps(columns, lines, cv2.CV_16SC2)
    return maps[0], maps[1]


def _lens_maps(camera: Camera, distortion: Distortion, lens: Float64s) -> Maps:
    """``undistortion_maps`` of a lens with a K of its own, for stored images of the camera's size."""
    cv2 = load_opencv()
    size = np.array([camera.width, camera.height])
    focal, center = camera.intrinsics.diagonal()[:2], camera.intrinsics[:2, 2]
    points, fractions = [], []
    for top in range(0, camera.height, _LINES):  # in parts: the numbers of a large image would fill the memory
        lines = np.arange(top, min(top + _LINES, camera.height)) + 0.5
        pixels = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, lines), axis=-1)
        bent = bend(distortion.model, distortion.coefficients, (pixels - center) / focal)
        stored = ((bent @ lens[:2, :2].T + lens[:2, 2]) * size - 0.5).astype(np.float32)
        maps = cv2.convertMaps(stored[..., 0], stored[..., 1], cv2.CV_16SC2)
        points.append(maps[0])
        fractions.append(maps[1])
    return np.concatenate(points), np.concatenate(fractions)


def _check_proportions(camera: Camera, shape: tuple[int, ...], path: Path) -> None:
    height, width = shape[:2]
    # Rounding a small camera's size bends its proportions by up to half a pixel.
    tolerance = 0.02 + 0.5 / min(camera.width, camera.height)
    if abs(width * camera.height / (height * camera.width) - 1) > tolerance:
        expected = f"the proportions of its camera, {camera.width} x {camera.height}"
        raise found_instead(path, f"an image of {width} x {height} pixels", expected)


def _finish(image: ImageArray, camera: Camera, maps: Maps | None) -> ImageArray:
    cv2 = load_opencv()
    if maps is not None:
        image = cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    if image.shape[:2] != (camera.height, camera.width):
        is_smaller = camera.width < image.shape[1]
        method = cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR
        image = cv2.resize(image, (camera.width, camera.height), interpolation=method)
    return np.ascontiguousarray(image)
