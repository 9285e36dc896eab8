"""What calibration looks at in a film: its background, where something moves, and images at common times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...arrays import Array, Bools, Float32s, Float64s, ImageArray
from ...errors import FrogError, found_instead
from ...io.plain_values import JsonObject
from ..readers.footage import decode_film, film_facts, find_footage
from ..video import VideoFacts, composed, find_videos, load_opencv
from .camera_kinds import kind_of, numbered

LONGEST_SIDE = 1600
"""Pixels of the images that features are sought in: more of them cost time and win nothing."""
_BACKGROUND_IMAGES = 30
_BACKGROUND_FRAMES = 1200  # frames from the start among which they are spread: all before the last one are decoded
_CHANGES = 6.0  # of 255: standard deviation over time of what moves
_STILL = 0.5  # pixels that the background of a standing camera moves by, at 500 pixels of width
_STILL_SHARE = 0.15  # of the corners: people may cover the rest, and of a moving camera none stays
_CORNERS = 400


@dataclass(frozen=True, eq=False)
class Film:
    """A video of one camera, or a folder of its frames.

    Attributes:
        name: of the camera: the video's, without its ending, or the folder's.
        facts: of the video.
        offset, rate: capture time = offset + rate * film time, seconds.
        kind: make and model of its camera, "" where the file does not say.
    """

    name: str
    path: Path
    facts: VideoFacts
    offset: float = 0.0
    rate: float = 1.0
    kind: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.facts.width, self.facts.height

    @property
    def stamps(self) -> Float64s:
        """(N,) film times in seconds at which the frames are shown."""
        return self.facts.timestamps

    def frame_at(self, time: float) -> float:
        """The frame, a real number, that was taken at a capture time in seconds; beyond the ends at the mean rate."""
        stamps, wanted = self.stamps, (time - self.offset) / self.rate
        if wanted < stamps[0] or wanted > stamps[-1]:
            end = 0 if wanted < stamps[0] else len(stamps) - 1
            return end + float(wanted - stamps[end]) * self.facts.frames_per_second
        return float(np.interp(wanted, stamps, np.arange(len(stamps))))

    def time_of(self, frame: int) -> float:
        """The capture time in seconds at which a frame was taken."""
        return self.offset + self.rate * float(self.stamps[min(max(frame, 0), len(self.stamps) - 1)])


@dataclass(frozen=True, eq=False)
class View:
    """One standing camera as calibration sees it.

    Attributes:
        name, size: of the camera; width and height in pixels of its film.
        background: (h, w) uint8 brightness of the background: the median over time, at most LONGEST_SIDE a side.
        changing: (h, w) bool, where something moves.
        images: brightness like ``background``, one at each common time; None where the film has none then.
        shares: for each of them by how many frames the common time is later than the image, and ``nexts`` the image
            one frame later or earlier, towards it; None where the image was taken at that time.
        group: cameras of one group are of one kind and share their focal length.
    """

    name: str
    size: tuple[int, int]
    background: ImageArray
    changing: Bools
    images: tuple[ImageArray | None, ...] = ()
    shares: tuple[float, ...] = ()
    nexts: tuple[ImageArray | None, ...] = ()
    group: int = 0


def find_films(folder: Path) -> list[Film]:
    """The films of a folder, a camera each, in order of their names: its videos, or else its folders of frames.

    Raises:
        FrogError: if there are neither, two have one name, or one cannot be decoded.
    """
    paths = find_videos(folder)
    names = [composed(video.stem) for video in paths]
    if not paths:
        paths = sorted((each.files[0].parent for each in find_footage(folder)), key=lambda path: path.name)
        paths = [path.parent if path.name == "images" else path for path in paths]
        names = [composed(path.name) for path in paths]
    if not paths:
        expected = "one video of each camera, such as cam01.mp4, cam02.mp4, or a folder of frames of each"
        raise found_instead(folder, "no video", expected)
    if len(set(names)) != len(names):
        twice = max(names, key=names.count)
        raise found_instead(folder, f"several videos named {twice}", "one video for each camera")
    return [Film(n, path, film_facts(path), kind=kind_of(path)) for n, path in zip(names, paths, strict=True)]


def is_standing(film: Film) -> bool:
    """Whether the background rests between the film's first, middle and last image."""
    cv2 = load_opencv()
    last = min(film.facts.frame_count, _BACKGROUND_FRAMES) - 1
    frames = sorted({0, last // 2, last})
    first, *others = [_gray(image, film.size) for image in decode_film(film.path, frames)]
    corners = cv2.goodFeaturesToTrack(first, _CORNERS, 0.01, max(4, first.shape[1] / 60))
    if corners is None or not others:
        return True
    still = max(_STILL, _STILL * first.shape[1] / 500)
    for other in others:
        ends, found, _ = cv2.calcOpticalFlowPyrLK(first, other, corners, None)
        rests = (np.linalg.norm(ends - corners, axis=-1)[:, 0] < still) & (found[:, 0] > 0)
        if np.mean(rests) < _STILL_SHARE:
            return False
    return True


def common_times(films: Sequence[Film], count: int) -> list[float]:
    """At most ``count`` capture times in seconds, evenly spread over what all films saw, off its ends.

    Raises:
        FrogError: if the films share no time.
    """
    start = max(film.time_of(0) for film in films)
    end = min(film.time_of(min(film.facts.frame_count, _BACKGROUND_FRAMES) - 1) for film in films)
    if end < start:
        raise FrogError("The films have no time in common: each starts when another has ended.")
    first = films[0]  # at the times of its frames: where films are in step nothing has to be carried
    spread = [start + (end - start) * (index + 0.5) / count for index in range(count)]
    return sorted({min(max(first.time_of(round(first.frame_at(time))), start), end) for time in spread})


def view_film(film: Film, times: Sequence[float], cancelled: Callable[[], None]) -> View:
    """A standing camera's view: its background, and its images at capture times in seconds.

    Args:
        cancelled: called before each image; it raises what ends the work.
    """
    count = film.facts.frame_count
    spread = np.unique(
        np.linspace(0, min(count, _BACKGROUND_FRAMES) - 1, _BACKGROUND_IMAGES).round().astype(int)
    ).tolist()
    exact = [film.frame_at(time) for time in times]
    nearest = [round(frame) for frame in exact]
    towards = [near + (1 if frame > near else -1) for near, frame in zip(nearest, exact, strict=True)]
    wanted = {frame for frame in (*spread, *nearest, *towards) if 0 <= frame < count}
    images: dict[int, ImageArray] = {}
    for frame, image in zip(sorted(wanted), decode_film(film.path, sorted(wanted)), strict=True):
        cancelled()
        images[frame] = _gray(image, film.size)
    stack = np.stack([images[frame] for frame in spread])
    return View(
        film.name,
        film.size,
        _median(stack),
        _changing(stack),
        tuple(images.get(near) for near in nearest),
        tuple(float(frame - near) for near, frame in zip(nearest, exact, strict=True)),
        tuple(
            images.get(next_) if abs(frame - near) > 1e-3 else None
            for near, next_, frame in zip(nearest, towards, exact, strict=True)
        ),
    )


def arrays_of(view: View) -> dict[str, Array]:
    """A view's arrays for the work folder; ``view_of`` reads them back."""
    arrays: dict[str, Array] = {
        "background": view.background,
        "changing": view.changing,
        "shares": np.array(view.shares),
    }
    for kind, images in (("image", view.images), ("next", view.nexts)):
        arrays |= {f"{kind}{index}": image for index, image in enumerate(images) if image is not None}
    return arrays


def view_of(entry: JsonObject, arrays: dict[str, Array]) -> View:
    """The view of a request's entry and its arrays."""
    shares = tuple(arrays["shares"].tolist())

    def images(kind: str) -> tuple[ImageArray | None, ...]:
        return tuple(arrays.get(f"{kind}{index}") for index in range(len(shares)))

    return View(
        entry["name"],
        (int(entry["size"][0]), int(entry["size"][1])),
        arrays["background"],
        arrays["changing"],
        images("image"),
        shares,
        images("next"),
        int(entry["group"]),
    )


def with_groups(views: Sequence[View], alike: float = 0.0, kinds: Sequence[str] = ()) -> list[View]:
    """The views, with equal groups for films of one kind of camera: of equal size, and of one make and model.

    Args:
        kinds: make and model of each view's camera; none where nothing is known.
        alike: by what part of a side sizes may differ within a group; encoders pad some films by a few pixels.
    """
    sizes: list[tuple[int, int]] = []
    for size in sorted(view.size for view in views):
        if not any(_are_alike(size, other, alike) for other in sizes):
            sizes.append(size)
    likes = [next(index for index, size in enumerate(sizes) if _are_alike(view.size, size, alike)) for view in views]
    groups = numbered([*zip(likes, kinds or [""] * len(views), strict=True)])
    return [replace(view, group=group) for view, group in zip(views, groups, strict=True)]


def _are_alike(one: tuple[int, int], other: tuple[int, int], share: float) -> bool:
    return all(abs(a - b) <= share * max(a, b) for a, b in zip(one, other, strict=True))


def _median(stack: Array) -> ImageArray:
    """(H, W) uint8 median over the images (N, H, W), in strips: numpy's copies are large."""
    rows = [np.median(stack[:, top : top + 64], axis=0) for top in range(0, stack.shape[1], 64)]
    return np.asarray(np.concatenate(rows).round(), np.uint8)


def _changing(stack: Array) -> Bools:
    """(H, W) bool: where the brightness varies, widened by what a feature sees of its surroundings."""
    cv2 = load_opencv()
    deviation: Float32s = np.concatenate(
        [stack[:, top : top + 64].std(axis=0, dtype=np.float32) for top in range(0, stack.shape[1], 64)]
    )
    side = 2 * max(1, round(stack.shape[2] / 160)) + 1
    wide = cv2.dilate((deviation > _CHANGES).astype(np.uint8), np.ones((side, side), np.uint8))
    return np.asarray(wide > 0)


def _gray(image: ImageArray, size: tuple[int, int]) -> ImageArray:
    """(h, w) uint8 brightness, at most LONGEST_SIDE a side."""
    cv2 = load_opencv()
    return resized(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), size)


def resized(gray: ImageArray, size: tuple[int, int]) -> ImageArray:
    """Brightness (H, W) of an image of that width and height, at most LONGEST_SIDE a side."""
    cv2 = load_opencv()
    scale = LONGEST_SIDE / max(size)
    if scale >= 1:
        return gray
    smaller = (round(size[0] * scale), round(size[1] * scale))
    return np.asarray(cv2.resize(gray, smaller, interpolation=cv2.INTER_AREA))
