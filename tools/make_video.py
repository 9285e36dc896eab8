"""A short film of the add-on, for the README: films of a capture, screenshots of a Blender window, and the trained
scene as its engine renders it, with captions.

    python tools/make_video.py OUT.mp4 SCENE.frog CAPTURE STORY.txt [--poster OUT.jpg]

STORY.txt has a line for each part, in their order; paths are relative to its folder:

    films | SECONDS | CAPTION               the films of CAPTURE beside each other
    orbit | SECONDS | CAPTION               SCENE while the camera moves around it and time passes
    PATTERN | SECONDS | CAPTION             the images that match, one after the other (shots/02_*.png)

Screenshots come from `make tour`, or from any other window.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw

SIZE = (1280, 720)
RATE = 20
QUALITY = 28  # x264's constant rate factor
EACH = 2  # frames that a rendered image is shown for: as good as every one at a capture's rate, in half the time
LARGEST = 5_000_000  # bytes: what GitHub and a reader's patience allow
_FADE = 0.35  # seconds from one part to the next
_SWAY = (0.75, 0.45)  # of the rig's width and height, which the camera moves through
_POSTER_AT = 0.5  # of the orbit


def fitted(image: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) uint8 as large as fits into the frame, on black."""
    height, width = image.shape[:2]
    scale = min(SIZE[0] / width, SIZE[1] / height)
    size = round(width * scale), round(height * scale)
    inside = cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    frame = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    left, top = (SIZE[0] - size[0]) // 2, (SIZE[1] - size[1]) // 2
    frame[top : top + size[1], left : left + size[0]] = inside
    return frame


def captioned(frame: np.ndarray, caption: str) -> np.ndarray:
    """The frame with a caption on a dark band at its lower edge."""
    if not caption:
        return frame
    found = frame.copy()
    found[-56:] = (0.25 * found[-56:]).astype(np.uint8)
    width = cv2.getTextSize(caption, cv2.FONT_HERSHEY_DUPLEX, 0.9, 1)[0][0]
    place = (SIZE[0] - width) // 2, SIZE[1] - 20
    cv2.putText(found, caption, place, cv2.FONT_HERSHEY_DUPLEX, 0.9, (255, 255, 255), 1, cv2.LINE_AA)
    return found


def with_arrow(frame: np.ndarray) -> np.ndarray:
    """The frame with the sign in its middle that says: a film."""
    x, y, size = SIZE[0] // 2, SIZE[1] // 2, 60
    marked = frame.copy()
    cv2.circle(marked, (x, y), 2 * size, (0, 0, 0), -1, cv2.LINE_AA)
    marked = cv2.addWeighted(marked, 0.55, frame, 0.45, 0)
    corners = np.array([[x - size * 2 // 3, y - size], [x - size * 2 // 3, y + size], [x + size * 4 // 3, y]])
    return cv2.fillPoly(marked, [corners], (255, 255, 255), cv2.LINE_AA)


def of_films(folder: Path, count: int) -> Iterator[np.ndarray]:
    """The films of a capture beside each other, back and forth."""
    films = []
    for path in sorted(folder.glob("*.mp4")):
        opened, images = cv2.VideoCapture(str(path)), []
        while (read := opened.read())[0]:
            images.append(read[1][..., ::-1])
        films.append(images)
    if not films:
        raise SystemExit(f"{folder}: found no films (*.mp4).")
    columns = int(np.ceil(np.sqrt(len(films))))
    length = min(map(len, films))
    for number in range(count):
        at = number % max(1, 2 * length - 2)
        images = [film[min(at, 2 * length - 2 - at)] for film in films]
        images += [np.zeros_like(images[0])] * (-len(images) % columns)
        rows = [np.hstack(images[row : row + columns]) for row in range(0, len(images), columns)]
        yield fitted(np.vstack(rows))


def of_images(paths: list[Path], count: int) -> Iterator[np.ndarray]:
    """Images for equal times."""
    before, image = None, np.zeros((1, 1, 3), np.uint8)
    for number in range(count):
        path = paths[number * len(paths) // count]
        if path != before:
            before, read = path, cv2.imread(str(path))
            if read is None:
                raise SystemExit(f"{path}: found no image that can be read.")
            image = fitted(read[..., ::-1])
        yield image


def orbit(cameras: tuple[Camera, ...]) -> Callable[[float], Camera]:
    """A camera at a share of its way through a rig's middle, at what the rig looks at, as wide as the frame."""
    centers = np.array([camera.center for camera in cameras])
    forward = np.array([camera.rotation[2] for camera in cameras])
    middle, looks = centers.mean(axis=0), forward.mean(axis=0)
    down = np.mean([camera.rotation[1] for camera in cameras], axis=0)
    # Where the cameras' axes come nearest to each other.
    sides = np.eye(3) - forward[:, :, None] * forward[:, None, :]
    target = np.linalg.solve(sides.sum(axis=0), np.einsum("nij,nj->i", sides, centers))
    right = np.cross(down, looks)
    right, down = right / np.linalg.norm(right), down / np.linalg.norm(down)
    reach = np.abs((centers - middle) @ np.stack([right, down]).T).max(axis=0) * _SWAY
    focal = cameras[0].intrinsics[1, 1] / cameras[0].height * SIZE[1]
    intrinsics = np.array([[focal, 0, SIZE[0] / 2], [0, focal, SIZE[1] / 2], [0, 0, 1]])

    def at(share: float) -> Camera:
        turn = 2 * np.pi * share
        eye = middle + reach[0] * np.sin(turn) * right - reach[1] * np.sin(2 * turn) * down
        axis = (target - eye) / np.linalg.norm(target - eye)
        across = np.cross(down, axis)
        across /= np.linalg.norm(across)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([across, np.cross(axis, across), axis])
        pose[:3, 3] = -pose[:3, :3] @ eye
        return Camera("orbit", *SIZE, intrinsics, pose)

    return at


def of_scene(path: Path, count: int) -> Iterator[np.ndarray]:
    """A scene while the camera moves and time passes as it was filmed, back and forth."""
    scene = ScenePlayer.load(path)
    header, seen_from = scene.header, orbit(scene.header.cameras)
    last = header.frame_count - 1
    image = np.zeros((1, 1, 3), np.uint8)
    for number in range(count):
        if number % EACH == 0:
            frame = number * header.frames_per_second / RATE % max(2 * last, 1)
            drawing = draw(scene.at_frame(min(frame, 2 * last - frame)), seen_from(number / count))
            image = (np.clip(drawing.rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
        yield image


@dataclass(frozen=True)
class Part:
    """Frames without their caption, how many, and whether the camera moves around the scene in them."""

    frames: Iterator[np.ndarray]
    count: int
    caption: str
    is_orbit: bool = False


def parts(story: Path, scene: Path, capture: Path) -> Iterator[Part]:
    """What the story names."""
    for line in story.read_text(encoding="utf-8").splitlines():
        words = [word.strip() for word in line.split("|")]
        if len(words) != 3:
            raise SystemExit(f"{story}: found {line!r}, expected WHAT | SECONDS | CAPTION.")
        what, count, caption = words[0], round(float(words[1]) * RATE), words[2]
        if what == "films":
            yield Part(of_films(capture, count), count, caption)
        elif what == "orbit":
            yield Part(of_scene(scene, count), count, caption, is_orbit=True)
        else:
            paths = sorted(story.parent.glob(what))
            if not paths:
                raise SystemExit(f"{story.parent}: found nothing that matches {what}.")
            yield Part(of_images(paths, count), count, caption)


def film(story: Path, scene: Path, capture: Path, poster: Path | None) -> Iterator[np.ndarray]:
    """All frames, each part faded into the next; writes the poster on its way."""
    before, fading = np.zeros((SIZE[1], SIZE[0], 3), np.uint8), round(_FADE * RATE)
    for part in parts(story, scene, capture):
        shown = before
        for number, image in enumerate(part.frames):
            if poster is not None and part.is_orbit and number == int(_POSTER_AT * part.count):
                cv2.imwrite(str(poster), with_arrow(image)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
            shown = captioned(image, part.caption)
            share = min(1.0, (number + 1) / (fading + 1))
            yield shown if share == 1.0 else cv2.addWeighted(shown, share, before, 1 - share, 0)
        before = shown


def main() -> None:
    parser = argparse.ArgumentParser(prog="make_video.py", description="A short film of the add-on.")
    parser.add_argument("out", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("story", type=Path)
    parser.add_argument("--poster", type=Path, help="an image of the scene for where films are not shown")
    options = parser.parse_args()
    writer = imageio_ffmpeg.write_frames(
        str(options.out), SIZE, fps=RATE, codec="libx264", quality=None, macro_block_size=2,
        output_params=["-crf", str(QUALITY), "-preset", "medium", "-movflags", "+faststart"],
    )  # fmt: skip
    writer.send(None)
    count = 0
    for frame in film(options.story, options.scene, options.capture, options.poster):
        writer.send(np.ascontiguousarray(frame))
        count += 1
    writer.close()
    size = options.out.stat().st_size
    print(f"{options.out}: {count / RATE:.1f} s, {size / 1e6:.2f} MB")
    if size > LARGEST:
        raise SystemExit(f"{options.out}: {size:,} bytes, expected at most {LARGEST:,}.")


if __name__ == "__main__":
    main()
