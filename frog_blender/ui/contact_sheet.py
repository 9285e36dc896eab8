"""One small image of each camera, decoded in the background."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import bpy
import numpy as np

from .. import addon_state, redrawing
from ..engine.capture.calibration.sequences import still_images
from ..engine.capture.contact_sheet import first_shots, marked_image
from ..engine.capture.video import VIDEO_SUFFIXES, composed, decode, find_videos, load_opencv, read_image
from ..engine.errors import FrogError, brief
from . import preview_image
from .capture_summary import CaptureSummary

LONGEST_SIDE = 192  # pixels
MOST = 48  # images; of more cameras, evenly spread ones
TICK_SECONDS = 0.1
_JOIN_SECONDS = 5.0

Source = tuple[str, Callable[[], np.ndarray]]
"""A camera's name, and what decodes its image."""


class ContactSheet:
    """The images of one folder. ``start()`` it, ``pump()`` it until ``is_whole``.

    Attributes:
        names: of the cameras whose images are there, in order.
        total: of the images.
        error: one sentence, if one cannot be decoded; the others are shown.
    """

    def __init__(self, folder: str, sources: Sequence[Source]) -> None:
        self.folder, self.total = folder, len(sources)
        self.names: list[str] = []
        self.error = ""
        self.is_whole = False
        self._sources = sources
        self._stop = threading.Event()
        self._images: queue.Queue[tuple[str, np.ndarray | str] | None] = queue.Queue()
        self._thread = threading.Thread(target=self._work, name="FRoG contact sheet", daemon=True)

    def start(self) -> ContactSheet:
        self._thread.start()
        return self

    def stop(self) -> bool:
        """Ends after the present image; true if it did in time."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(_JOIN_SECONDS)
        return not self._thread.is_alive()

    def join(self, seconds: float) -> bool:
        """Waits; true if all is decoded."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def pump(self) -> bool:
        """Shows what has been decoded; returns whether anything was. Never waits."""
        some = False
        while not self._images.empty():
            some = True
            found = self._images.get_nowait()
            if found is None:
                self.is_whole = True
                continue
            name, image = found
            if isinstance(image, str):
                self.error = self.error or image
                continue
            preview_image.show(image, icon_name(name))
            self.names.append(name)
        return some

    def _work(self) -> None:
        try:
            for name, decoded in self._sources:
                if self._stop.is_set():
                    break
                self._images.put((name, _image_or_error(name, decoded)))
        finally:
            self._images.put(None)


def _image_or_error(name: str, decoded: Callable[[], np.ndarray]) -> np.ndarray | str:
    """An image, or why there is none."""
    try:
        return decoded()
    except FrogError as error:
        return str(error)
    except Exception as error:  # would be lost otherwise
        return f"{name}: could not be decoded ({brief(error)})."


def _small_image(path: Path) -> np.ndarray:
    """The first image of raw footage, at most LONGEST_SIDE a side."""
    image = next(iter(decode(path, [0]))) if path.suffix.lower() in VIDEO_SUFFIXES else read_image(path)
    scale = LONGEST_SIDE / max(image.shape[:2])
    if scale >= 1:
        return image
    cv2 = load_opencv()
    size = (max(1, round(image.shape[1] * scale)), max(1, round(image.shape[0] * scale)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


class CurrentContactSheet:
    """The contact sheet that is shown."""

    def __init__(self) -> None:
        self.sheet: ContactSheet | None = None


def shown(folder: str) -> ContactSheet | None:
    """The contact sheet of a folder, if it is the one that was asked for last."""
    sheet = addon_state.get(CurrentContactSheet).sheet
    return sheet if sheet is not None and sheet.folder == folder else None


def show(folder: str, summary: CaptureSummary) -> ContactSheet:
    """Decodes the images of a folder's cameras, in place of those of another one; OSError as of ``sources``."""
    sheet = ContactSheet(folder, sources(Path(folder), summary))
    close()
    sheet.start()
    addon_state.get(CurrentContactSheet).sheet = sheet
    if not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=TICK_SECONDS, persistent=True)
    return sheet


def close() -> None:
    """Ends the work, and removes the images."""
    current = addon_state.get(CurrentContactSheet)
    if current.sheet is not None:
        current.sheet.stop()
        for name in current.sheet.names:
            preview_image.show(None, icon_name(name))
    current.sheet = None


def icon_name(camera: str) -> str:
    """The name of a camera's image in ``preview_image``."""
    return f"contact sheet {camera}"


def sources(folder: Path, summary: CaptureSummary) -> list[Source]:
    """What to decode: each camera's first image with its masks, or that of each raw video; at most MOST.

    Raises:
        OSError: if the folder cannot be read.
    """
    capture = summary.capture
    if capture is not None:
        shots = first_shots(capture, MOST)
        names = [capture.cameras[capture.shots[shot].camera].name for shot in shots]
        return [
            (name, partial(marked_image, capture, shot, LONGEST_SIDE)) for name, shot in zip(names, shots, strict=True)
        ]
    paths = find_videos(folder) or still_images(folder)
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(MOST, len(paths))).round().astype(int)) if paths else []
    return [(composed(paths[index].stem), partial(_small_image, paths[index])) for index in chosen]


def tick() -> float | None:
    """What Blender's timer calls. Returns the seconds until the next call, None to end."""
    sheet = addon_state.get(CurrentContactSheet).sheet
    if sheet is None:
        return None
    is_last = sheet.is_whole
    if sheet.pump():
        redrawing.sidebars()
    return None if is_last else TICK_SECONDS


def register() -> None:
    """There is nothing to register."""


def unregister() -> None:
    close()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
