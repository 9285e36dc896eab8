"""The points that a person clicks in each camera's image, for a calibration by them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..engine.capture.calibration.points import read_points
from ..engine.capture.synchronization.films import Film
from ..engine.io.atomic_files import write_atomically

FILE = "clicked_points.json"
"""Beside the videos; ``frog calibrate --points`` takes it as well."""
MOST = 99  # points
ENDING = ("RET", "NUMPAD_ENTER", "ESC")

Pixel = tuple[float, float]
"""x and y from the image's upper left corner; pixel centres at +0.5."""


class ClickedPoints:
    """Numbered points in several images, and the place where the next click goes.

    Attributes:
        cameras: names, in order.
        camera, point: places of the image that is shown and of the point that a click sets.
    """

    def __init__(self, cameras: Sequence[str], points: Mapping[str, Sequence[Pixel | None]] | None = None) -> None:
        self.cameras = tuple(cameras)
        self.camera, self.point = 0, 0
        self._points = {name: list((points or {}).get(name, ())) for name in self.cameras}
        self._undone: list[tuple[int, int, Pixel | None]] = []
        self._go_to_gap()

    @property
    def name(self) -> str:
        """Of the camera whose image is shown."""
        return self.cameras[self.camera]

    @property
    def count(self) -> int:
        """Points that any camera sees."""
        seen = [i for points in self._points.values() for i, pixel in enumerate(points) if pixel is not None]
        return max(seen, default=-1) + 1

    def of(self, name: str) -> list[Pixel | None]:
        """A camera's points, None where it sees none; ``count`` of them."""
        points = self._points[name][: self.count]
        return [*points, *[None] * (self.count - len(points))]

    def seen_in(self, name: str) -> int:
        """How many points a camera has."""
        return sum(pixel is not None for pixel in self._points[name])

    def click(self, pixel: Pixel | None) -> None:
        """Sets the point in the image that is shown, in place of an earlier click, and goes on to the next one. None
        where the camera does not see the point.
        """
        self._set(self.camera, self.point, pixel)
        self.choose(1)

    def choose(self, step: int) -> None:
        """Goes so many points on; at most one beyond those that there are."""
        self.point = min(max(self.point + step, 0), min(self.count, MOST - 1))

    def turn(self, step: int) -> None:
        """Shows another camera's image, from its first point that is not set."""
        self.camera = (self.camera + step) % len(self.cameras)
        self._go_to_gap()

    def undo(self) -> bool:
        """Takes the last click or skip back, in whichever image it was; false if there is none."""
        if not self._undone:
            return False
        camera, point, before = self._undone.pop()
        self._points[self.cameras[camera]][point] = before
        self.camera, self.point = camera, point
        return True

    def press(self, key: str, ctrl: bool = False) -> bool:
        """What a key of Blender's does; false for a key that does nothing."""
        if key == "Z" and ctrl:
            return self.undo()
        actions = {
            "TAB": lambda: self.turn(-1 if ctrl else 1),
            "RIGHT_ARROW": lambda: self.turn(1),
            "LEFT_ARROW": lambda: self.turn(-1),
            "DOWN_ARROW": lambda: self.choose(1),
            "UP_ARROW": lambda: self.choose(-1),
            "N": lambda: self.click(None),
        }
        if (ctrl and key != "TAB") or key not in actions:
            return False
        actions[key]()
        return True

    def save(self, path: Path) -> None:
        """Writes the file that a calibration takes; removes one that would hold no point. FrogError if it cannot be."""
        if not self.count:
            path.unlink(missing_ok=True)
            return
        content = {name: self.of(name) for name in self.cameras}
        write_atomically(path, json.dumps(content).encode())

    def _set(self, camera: int, point: int, pixel: Pixel | None) -> None:
        points = self._points[self.cameras[camera]]
        points.extend([None] * (point + 1 - len(points)))
        self._undone.append((camera, point, points[point]))
        points[point] = pixel

    def _go_to_gap(self) -> None:
        points = self.of(self.name)
        self.point = min(points.index(None) if None in points else len(points), MOST - 1)


def points_of(path: Path, films: Sequence[Film]) -> ClickedPoints:
    """The points of a file, or none where there is no such file. FrogError for a file that does not fit the films."""
    names = [film.name for film in films]
    if not path.exists():
        return ClickedPoints(names)
    clicked = {
        name: [None if pixel != pixel else (pixel, other) for pixel, other in points.tolist()]  # NaN
        for name, points in read_points(path, {film.name: film.size for film in films}).items()
    }
    return ClickedPoints(names, clicked)
