"""Files of a calibration, and headers of films and images."""

import json
from pathlib import Path

import cv2
import numpy as np
from support.clicks import clicks
from support.films import encode, numbered
from support.layouts.rigs import opencv_frames

from frog_blender.engine.capture.calibration.board_detection import read_board
from frog_blender.engine.capture.calibration.report import REPORT, report_lines
from frog_blender.engine.capture.media import read_film_header, read_photograph, read_sound
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.video import read_facts, read_image
from frog_blender.engine.errors import FrogError, printable
from frog_blender.engine.io.work_folder import WorkFolder
from frog_blender.tasks.clocks import CAMERAS, read_clocks, write_clock
from fuzzing.of_captures import timed_films
from fuzzing.worker import Kind


class Boards(Kind):
    """Descriptions of boards: our own, in TOML and JSON, Caliscope's and anipose's."""

    def __init__(self, folder: Path) -> None:
        own = {"squares": [4, 5], "square_size": 0.05, "marker_size": 0.037, "dictionary": "DICT_4X4_50"}
        toml = "".join(f"{name} = {value!r}\n" for name, value in own.items()) + "inverted = true\nlegacy = false\n"
        other = "columns = 4\nrows = 5\naruco_scale = 0.75\nsquare_size_override_cm = 5.4\nboard_height = 11.0\n"
        other += 'board_width = 8.5\nunits = "inch"\ndictionary = "DICT_4X4_1000"\ninverted = true\n'
        third = '[calibration]\nboard_type = "charuco"\nboard_size = [6, 5]\nboard_marker_bits = 4\n'
        third += "board_marker_dict_number = 50\nboard_marker_length = 18\nboard_square_side_length = 24\n"
        boards = {"board.toml": [toml, other, third], "board.json": [json.dumps(own)]}
        self.whole = {folder / name: [text.encode() for text in texts] for name, texts in boards.items()}
        for path, contents in self.whole.items():
            path.write_bytes(contents[0])

    def use(self) -> bool:
        boards = [read_board(path) for path in self.whole]
        assert all(min(board.columns, board.rows) >= 2 and 0 < (board.square or 0) < np.inf for board in boards)
        return True


class Reports(Kind):
    """``calibration_report.json``, of which a damaged one is told in a sentence among the lines."""

    def __init__(self, folder: Path) -> None:
        opencv_frames(folder)
        self._capture = open_capture(folder)
        cameras = [
            {"name": each.name, "focal": each.intrinsics[0, 0], "focal_uncertainty": 0.001, "residual": 0.2}
            for each in self._capture.cameras
        ]
        facts = {"kind": "standing cameras", "source": "features", "points": 300, "residual": 0.2, "images": 8}
        facts |= {"halves_apart": 0.001, "cameras": cameras, "warnings": ["cam01 sees little."]}
        facts |= {"lines": ["3 standing cameras from features", "cam01 sees little."]}
        self.keep(folder / REPORT, json.dumps(facts).encode())

    def use(self) -> bool:
        told = report_lines(self._capture)
        assert all(line == printable(line) and len(line) < 11_000 for line in told)
        if told and told[0].startswith(str(self.path)):
            raise FrogError(told[0])
        return bool(told)  # without lines it has nothing to say


class Clocks(Kind):
    """``cameras_opencv.json`` of unequal clocks: opened as a capture, shown in the panel, and corrected."""

    def __init__(self, folder: Path) -> None:
        timed_films(folder)
        self.keep(folder / CAMERAS)

    def use(self) -> bool:
        try:
            clocks = read_clocks(self.path.parent)
            if clocks is not None and clocks.is_own:
                write_clock(self.path.parent, *next(iter(clocks.clocks.items())))
        finally:
            capture = open_capture(self.path.parent)
        assert all(np.isfinite(each.world_to_camera).all() for each in capture.cameras)
        assert all(0 <= shot.frame < capture.frame_count for shot in capture.shots)
        return True


class Stages(Kind):
    """What an earlier run kept: whatever is wrong with it, the stage is done again."""

    def __init__(self, folder: Path) -> None:
        self._work, random = WorkFolder(folder), np.random.default_rng(0)
        self._arrays = {
            "pixels": random.uniform(0, 64, (40, 2)),
            "descriptors": random.integers(0, 255, (40, 128)).astype(np.uint8),
            "moments": np.zeros(40, np.int64),
        }
        self._work.keep("features", "0", self._arrays)
        self.keep(self._work.file("features", "0"))

    def use(self) -> bool:
        found = self._work.load("features", "0")
        assert found is None or all(np.array_equal(found[name], array) for name, array in self._arrays.items())
        return found is not None


class FilmHeaders(Kind):
    """MP4 and Matroska: what PyAV says of them, their sound, and then their images."""

    def __init__(self, folder: Path) -> None:
        contents = []
        sound = clicks([0.1], 0.3).values
        for name in ("a.mp4", "b.mov", "c.mkv"):
            contents.append(encode(folder / name, numbered(9), key_every=4, sound=sound).read_bytes())
        contents.append(encode(folder / "d.webm", numbered(9), codec="libvpx").read_bytes())
        self.keep(folder / "film.bin", *contents)

    def use(self) -> bool:
        times = read_film_header(self.path, with_times=True).times
        assert times is None or (len(times) and np.isfinite(times).all() and (np.diff(times) >= 0).all())
        heard = read_sound(self.path, 16_000, 1, 0.0, 1.0)
        assert heard is None or len(heard) <= 16_000
        facts = read_facts(self.path)
        assert facts.frame_count == len(facts.timestamps) and np.isfinite(facts.timestamps).all()
        return True


class StillHeaders(Kind):
    """Images with EXIF: what Pillow says of them, and then their pixels."""

    def __init__(self, folder: Path) -> None:
        contents = []
        pixels = np.random.default_rng(0).integers(0, 255, (40, 56, 3)).astype(np.uint8)
        exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
        for suffix in (".jpg", ".png", ".webp"):
            content = cv2.imencode(suffix, pixels)[1].tobytes()
            if suffix == ".jpg":
                content = content[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + content[2:]
            contents.append(content)
        self.keep(folder / "image.bin", *contents)

    def use(self) -> bool:
        said = read_photograph(self.path)
        assert said is None or (1 <= said.orientation <= 8 and min(said.size) > 0)
        assert read_image(self.path).ndim == 3
        return True


KINDS: dict[str, type[Kind]] = {
    "boards": Boards,
    "reports": Reports,
    "clocks": Clocks,
    "stages": Stages,
    "films": FilmHeaders,
    "stills": StillHeaders,
}
