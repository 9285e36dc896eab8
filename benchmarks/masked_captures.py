"""Makes captures with masks: the bundled room's frog, the same frog on a blue stage, and what moves in other films.

    python benchmarks/masked_captures.py room OUT
    python benchmarks/masked_captures.py stage OUT
    python benchmarks/masked_captures.py moving OUT --films CAPTURE

``room`` needs bpy: the true masks are drawn from the meshes that were rendered, the farthest quad first. ``stage`` lays
the frog of those masks over blue with an uneven light and noise; nothing but the key tells them apart. ``moving``
subtracts the background, the colour that each pixel shows most often, and lets GrabCut find the outline by colour:
someone who walks on the spot is a part of a median.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
ROOM = ROOT / "examples" / "captures" / "room"
FRAMES = 30
SUBJECT = ("body", "right arm", "left arm", "right eye", "left eye")
LARGEST = 1.5  # metres: walls and floor are behind everything
FINER = 4  # times as many pixels, of which a mask is the mean
BLUE = (0, 71, 187)  # of 255, as `--key blue` has it: the frog is green
NOISE = 2.0  # of 255
SIDE = 480  # pixels of the longer side, at which a background is subtracted
DIFFERS, SAME = 20.0, 6.0  # of 255: from the background, and between two times of it
SURE = 0.8  # share of the times at which a background that can be relied on is seen
TIMES, ROUNDS = 25, 1  # of the background, and of GrabCut
AROUND = 12  # pixels
DOUBT = -0.7  # logarithm of how much likelier the subject's colours must be
LARGE, HOLE = 0.1, 0.03  # of the largest part: smaller parts are noise, and smaller holes

Image = NDArray[np.uint8]
Quads = NDArray[np.float64]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("kind", choices=("room", "stage", "moving"))
    parser.add_argument("out", type=Path)
    parser.add_argument("--films", type=Path, help="a folder of films and their calibration, for moving")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.kind == "moving":
        moving(options.films, options.out)
    elif options.kind == "room":
        copy_all(ROOM, options.out)
        for name, frame, alpha in true_masks():
            write_mask(options.out, name, frame, alpha)
    else:
        stage(options.out)


def copy_all(source: Path, out: Path) -> None:
    for path in sorted(source.iterdir()):
        if path.is_file():
            shutil.copy(path, out)


def write_mask(out: Path, camera: str, frame: int, alpha: Image) -> None:
    folder = out / "masks" / camera
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / f"{frame:04d}.png"), alpha)


def frames_of(film: Path) -> Iterator[Image]:
    """Each (H, W, 3) uint8, blue first."""
    reader = cv2.VideoCapture(str(film))
    while (read := reader.read())[0]:
        yield np.asarray(read[1], np.uint8)


# The frog ------------------------------------------------------------------------------------------------------------


def true_masks() -> Iterator[tuple[str, int, Image]]:
    """Camera, frame and (H, W) uint8 alpha of the frog in the bundled films."""
    sys.path.insert(0, str(ROOT / "examples"))
    import bpy
    from capture_rig import Rig
    from room_scene import Room

    rig, scene = Rig(320, 240, 300.0), Room()
    for frame in range(FRAMES):
        scene.pose(frame / FRAMES)
        bpy.context.view_layer.update()
        quads, subject = quads_of([item for item in bpy.context.scene.objects if item.type == "MESH"])
        for view in rig.views:
            seen = (quads - view.center) @ view.matrix[:3, :3] @ np.diag([1.0, -1.0, -1.0])
            pixels = seen[..., :2] / seen[..., 2:] * view.focal + np.array([view.width, view.height]) / 2
            order = (-seen[..., 2].mean(1)).argsort()
            yield view.name, frame, painted(pixels[order], subject[order], (view.height, view.width))


def quads_of(items: list[object]) -> tuple[Quads, NDArray[np.bool_]]:
    """(N, 4, 3) the world places of the faces' corners, and (N,) which are the subject's."""
    quads, subject = [], []
    for item in items:
        mesh = item.data
        places = np.array([vertex.co[:] for vertex in mesh.vertices])
        if np.ptp(places, axis=0).max() > LARGEST and item.name not in SUBJECT:
            continue
        faces = np.array([face.vertices[:] for face in mesh.polygons])
        quads.append(places[faces])
        subject.append(np.full(len(faces), item.name in SUBJECT))
    return np.concatenate(quads), np.concatenate(subject)


def painted(quads: Quads, subject: NDArray[np.bool_], shape: tuple[int, int]) -> Image:
    """(H, W) the subject's alpha, of quads (N, 4, 2) in pixels, the farthest first."""
    height, width = shape
    large = np.zeros((height * FINER, width * FINER), np.uint8)
    corners = (quads * FINER * 16 - 8).round().astype(np.int32)  # in sixteenths, from the middle of the first pixel
    for quad, white in zip(corners, subject.tolist(), strict=True):
        cv2.fillConvexPoly(large, quad, 255 if white else 0, cv2.LINE_8, 4)
    return np.asarray(cv2.resize(large, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def stage(out: Path) -> None:
    """Films of the frog before blue."""
    shutil.copy(ROOM / "poses_bounds.npy", out)
    masks = {(name, frame): alpha for name, frame, alpha in true_masks()}
    for number, film in enumerate(sorted(ROOM.glob("*.mp4"))):
        random = np.random.default_rng(number)
        command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "bgr24"]
        command += ["-s", "320x240", "-r", "15", "-i", "-", "-vf", "scale=out_color_matrix=bt601:out_range=tv"]
        command += ["-c:v", "libx264", "-crf", "13", "-pix_fmt", "yuv444p", "-colorspace", "smpte170m"]
        with subprocess.Popen([*command, str(out / film.name)], stdin=subprocess.PIPE) as encoder:
            assert encoder.stdin is not None
            for frame, image in enumerate(frames_of(film)):
                encoder.stdin.write(before_blue(image, masks[film.stem, frame], random).tobytes())


def before_blue(image: Image, alpha: Image, random: np.random.Generator) -> Image:
    """The subject of an image over a blue that is lit from above; a pixel less of it, which has no other's colour."""
    height, width = alpha.shape
    inner = cv2.GaussianBlur(cv2.erode(alpha, np.ones((3, 3), np.uint8)), (3, 3), 0)[..., None] / 255
    light = np.linspace(1.0, 0.72, height)[:, None, None] * np.linspace(0.9, 1.05, width)[None, :, None]
    mixed = image * inner + np.array(BLUE[::-1]) * light * (1 - inner) + random.normal(0, NOISE, image.shape)
    return np.asarray(mixed.round().clip(0, 255), np.uint8)


# What moves ----------------------------------------------------------------------------------------------------------


def moving(films: Path, out: Path) -> None:
    """Copies a capture, and masks what moves before its standing cameras."""
    copy_all(films, out)
    for film in sorted(films.glob("*.mp4")):
        images = []
        for image in frames_of(film):
            images.append(reduced(image))
            size = image.shape[1], image.shape[0]
        spread = np.linspace(0, len(images) - 1, TIMES).round().astype(int)
        background = Background(np.stack([images[index] for index in spread]))
        for frame, image in enumerate(images):
            write_mask(out, film.stem, frame, cv2.resize(background.outlined(image), size))


def reduced(image: Image) -> Image:
    height, width = image.shape[:2]
    scale = min(1.0, SIDE / max(height, width))
    size = round(width * scale), round(height * scale)
    return np.asarray(cv2.resize(cv2.GaussianBlur(image, (3, 3), 0), size, interpolation=cv2.INTER_AREA), np.uint8)


class Background:
    """What stands in images (N, H, W, 3): the colour that each pixel and those around it show most often.

    Where that is seen at few times it may be the subject's, which colours alone tell: those of what surely moves
    against those of what surely stands.
    """

    def __init__(self, images: Image) -> None:
        values = images.astype(np.int16)
        alike = np.zeros(values.shape[:3], np.float32)
        for other in values:
            alike += np.abs(values - other).max(-1) < SAME
        alike = np.stack([cv2.blur(count, (5, 5)) for count in alike]) / len(values)
        self._plate = np.take_along_axis(images, alike.argmax(0)[None, ..., None], 0)[0]
        self._sure = alike.max(0) >= SURE
        moved = np.concatenate([image[self._sure & (self._difference(image) > 2 * DIFFERS)] for image in images])
        self._subject, self._rest = _colors(moved), _colors(self._plate[self._sure])
        self._wrong = self._like_subject(self._plate)

    def outlined(self, image: Image) -> Image:
        """(H, W) uint8 0 or 255 the subject of an image (H, W, 3)."""
        difference, like = self._difference(image), self._like_subject(image)
        differs = large_parts((difference > DIFFERS) & ~(self._wrong & ~like) | (self._wrong & like))
        labels = np.where(self._sure & (difference < DIFFERS), cv2.GC_BGD, cv2.GC_PR_BGD).astype(np.uint8)
        labels[differs > 0] = cv2.GC_PR_FGD
        labels[(differs > 0) & (difference > 2 * DIFFERS) & (self._sure | like)] = cv2.GC_FGD
        if not (labels == cv2.GC_FGD).any():
            return differs
        left, top, width, height = cv2.boundingRect(differs)
        part = slice(max(0, top - AROUND), top + height + AROUND), slice(max(0, left - AROUND), left + width + AROUND)
        found, models = np.ascontiguousarray(labels[part]), (np.zeros((1, 65)), np.zeros((1, 65)))
        cv2.grabCut(np.ascontiguousarray(image[part]), found, None, *models, ROUNDS, cv2.GC_INIT_WITH_MASK)
        whole = np.zeros(image.shape[:2], bool)
        whole[part] = (found == cv2.GC_FGD) | (found == cv2.GC_PR_FGD)
        return large_parts(whole)

    def _difference(self, image: Image) -> NDArray[np.int16]:
        return np.asarray(np.abs(image.astype(np.int16) - self._plate).max(-1))

    def _like_subject(self, image: Image) -> NDArray[np.bool_]:
        """(H, W) where the background is not sure: whether the colours there are rather the subject's."""
        ratio = np.zeros(image.shape[:2])
        pixels = image[~self._sure].astype(np.float64)
        ratio[~self._sure] = _likelihood(self._subject, pixels) - _likelihood(self._rest, pixels)
        return np.asarray((cv2.blur(ratio.clip(-8, 8), (5, 5)) > DOUBT) & ~self._sure)


def _colors(pixels: Image) -> cv2.ml.EM:
    """Six normal distributions of colours (N, 3)."""
    model = cv2.ml.EM_create()
    model.setClustersNumber(6)
    chosen = pixels[np.random.default_rng(0).permutation(len(pixels))[:6000]]
    model.trainEM(chosen.astype(np.float64))
    return model


def _likelihood(model: cv2.ml.EM, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N,) the logarithm of each colour's."""
    weights, means = model.getWeights()[0], model.getMeans()
    logs = []
    for weight, mean, covariance in zip(weights, means, model.getCovs(), strict=True):
        inverse = np.linalg.inv(covariance + 4 * np.eye(3))
        offsets = pixels - mean
        squared = np.einsum("ni,ij,nj->n", offsets, inverse, offsets)
        logs.append(np.log(max(weight, 1e-9)) + 0.5 * np.linalg.slogdet(inverse)[1] - 0.5 * squared)
    return np.asarray(np.logaddexp.reduce(logs))


def large_parts(mask: NDArray[np.bool_]) -> Image:
    """(H, W) uint8 0 or 255."""
    opened = cv2.morphologyEx(np.where(mask, np.uint8(255), np.uint8(0)), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    _, labels, found, _ = cv2.connectedComponentsWithStats(opened)
    areas = found[1:, cv2.CC_STAT_AREA]
    kept = np.flatnonzero(areas >= LARGE * areas.max(initial=0)) + 1
    parts = np.where(np.isin(labels, kept), np.uint8(255), np.uint8(0))
    _, holes, found, _ = cv2.connectedComponentsWithStats(255 - parts, connectivity=4)
    small = np.flatnonzero(found[:, cv2.CC_STAT_AREA] < HOLE * areas.max(initial=0))
    return np.where(np.isin(holes, small), np.uint8(255), parts)


if __name__ == "__main__":
    main()
