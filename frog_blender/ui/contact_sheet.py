"""One small image of each camera, decoded in the background."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from .. import redrawing
from ..engine.capture.calibration.sequences import still_images
from ..engine.capture.contact_sheet import first_shots, marked_image
from ..engine.capture.readers.footage import find_footage
from ..engine.capture.synchronization.films import spread
from ..engine.capture.video import VIDEO_SUFFIXES, composed, decode, read_image
from ..engine.errors import FrogError, brief
from ..engine.io.child_process import Stopped
from ..tasks.background_task import BackgroundTask
from . import preview_image
from .capture_summary import CaptureSummary

LONGEST_SIDE = 192  # pixels
MOST = 48  # images; of more cameras, evenly spread ones

Source = tuple[str, Callable[[], np.ndarray]]
"""A camera's name, and what decodes its image."""


class ContactSheet(BackgroundTask):
    """The images of one folder.

    Attributes:
        names: of the cameras whose images are there, in order.
        total: of the images.
        problem: one sentence, if one cannot be decoded; the others are shown.
    """

    what = "decoding of the contact sheet"

    def __init__(self, folder: str, sources: Sequence[Source]) -> None:
        super().__init__()
        self.folder, self.total, self._sources = folder, len(sources), sources
        self.names: list[str] = []
        self.problem = ""

    def work(self) -> None:
        for name, decoded in self._sources:
            if self.stopped.is_set():
                raise Stopped
            try:
                self.put((name, decoded()))
            except FrogError as error:
                self.put((name, str(error)))
            except Exception as error:  # would end all the others
                self.put((name, f"{name}: could not be decoded ({brief(error)})."))

    def take(self, message: tuple[str, np.ndarray | str]) -> None:
        name, image = message
        if isinstance(image, str):
            self.problem = self.problem or image
            return
        preview_image.show(image, icon_name(name))
        self.names.append(name)

    def redraw(self) -> None:
        redrawing.sidebars()


def _small_image(path: Path) -> np.ndarray:
    """The first image of raw footage, at most LONGEST_SIDE a side."""
    image = next(iter(decode(path, [0]))) if path.suffix.lower() in VIDEO_SUFFIXES else read_image(path)
    step = -(-max(image.shape[:2]) // LONGEST_SIDE)
    return np.ascontiguousarray(image[::step, ::step])


def shown(folder: str) -> ContactSheet | None:
    """The contact sheet of a folder, if it is the one that was asked for last."""
    sheet = ContactSheet.current()
    return sheet if sheet is not None and sheet.folder == folder else None


def show(folder: str, summary: CaptureSummary) -> None:
    """Decodes the images of a folder's cameras, in place of those of another one; OSError as of ``sources``."""
    sheet = ContactSheet(folder, sources(Path(folder), summary))
    close()
    sheet.start().show()


def close() -> None:
    """Ends the work, and removes the images."""
    sheet = ContactSheet.current()
    if sheet is not None:
        sheet.stop()
        for name in sheet.names:
            preview_image.show(None, icon_name(name))
        sheet.forget()


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
    films = [(film.name, film.path) for film in find_footage(folder) if film.is_video]
    shown = films or [(composed(path.stem), path) for path in still_images(folder)]
    return [(name, partial(_small_image, path)) for name, path in (shown[index] for index in spread(len(shown), MOST))]
