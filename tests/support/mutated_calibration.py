"""Opens damaged and hostile files of a calibration, and headers of films and images; run by
test_damaged_files.py in a process of its own.

    python mutated_calibration.py KIND FOLDER COUNT SEED

What it prints, and how it ends, is as of ``mutated_files.py``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cv2
import numpy as np
from fuzzing.mutating import cut, flipped, torn
from support.clicks import clicks
from support.filmed_scene import rig
from support.films import encode, numbered
from support.layouts.rigs import opencv_frames
from support.mutated_captures import counts, json_values, lines, words
from support.mutated_files import ARCHIVES, Kind, main

from frog_blender.engine.capture.calibration.board_file import read_board
from frog_blender.engine.capture.calibration.points import read_points
from frog_blender.engine.capture.calibration.report import REPORT, report_lines
from frog_blender.engine.capture.calibration.work_folder import WorkFolder
from frog_blender.engine.capture.media import read_film_header, read_photograph, read_sound
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.video import read_facts, read_image
from frog_blender.engine.errors import FrogError, printable
from frog_blender.tasks.clocks import CAMERAS, read_clocks, write_clock

JSON = [flipped, cut, torn, json_values, json_values, json_values, json_values, json_values]
TEXT = [flipped, cut, torn, words, words, words, lines]
BYTES = [flipped, flipped, cut, torn, counts, counts, counts, counts]


class Boards(Kind):
    """Descriptions of boards: our own and Caliscope's."""

    mutations = TEXT

    def __init__(self, folder: Path) -> None:
        self.path = folder / "board.toml"
        own = 'squares = [4, 5]\nsquare_size = 0.05\nmarker_size = 0.037\ndictionary = "DICT_4X4_50"\n'
        own += "inverted = true\nlegacy = false\n"
        other = "columns = 4\nrows = 5\naruco_scale = 0.75\nsquare_size_override_cm = 5.4\nboard_height = 11.0\n"
        other += 'board_width = 8.5\nunits = "inch"\ndictionary = "DICT_4X4_1000"\ninverted = true\n'
        self.whole = [own.encode(), other.encode()]

    def use(self) -> bool:
        board = read_board(self.path)
        assert board.columns >= 2 and board.rows >= 2 and 0 < board.square < np.inf
        return True


class PlainBoards(Boards):
    """The same in JSON."""

    mutations = JSON

    def __init__(self, folder: Path) -> None:
        self.path = folder / "board.json"
        board = {"squares": [4, 5], "square_size": 0.05, "marker_size": 0.037, "dictionary": "DICT_4X4_50"}
        self.whole = [json.dumps(board).encode()]


class ClickedPoints(Kind):
    mutations = JSON

    def __init__(self, folder: Path) -> None:
        self.path = folder / "points.json"
        self._sizes = dict.fromkeys(("cam00", "cam01", "cam02"), (64, 48))
        clicks = {name: [[3.5 * i, 2.5 * i] if i % 7 else None for i in range(16)] for name in self._sizes}
        self.whole = [json.dumps(clicks).encode()]

    def use(self) -> bool:
        for clicked in read_points(self.path, self._sizes).values():
            assert clicked.dtype == np.float64 and np.nanmin(np.nan_to_num(clicked)) >= 0
        return True


class Reports(Kind):
    """``calibration_report.json``, of which a damaged one is told in a sentence among the lines."""

    mutations = JSON

    def __init__(self, folder: Path) -> None:
        opencv_frames(folder)
        self._capture = open_capture(folder)
        self.path = folder / REPORT
        cameras = [
            {"name": each.name, "focal": each.intrinsics[0, 0], "focal_uncertainty": 0.001, "residual": 0.2}
            for each in self._capture.cameras
        ]
        facts = {"kind": "standing cameras", "source": "features", "points": 300, "residual": 0.2, "images": 8}
        facts |= {"halves_apart": 0.001, "cameras": cameras, "warnings": ["cam01 sees little."]}
        facts |= {"lines": ["3 standing cameras from features", "cam01 sees little."]}
        self.whole = [json.dumps(facts).encode()]

    def use(self) -> bool:
        told = report_lines(self._capture)
        assert told and all(line == printable(line) and len(line) < 11_000 for line in told)
        if told[0].startswith(str(self.path)):
            raise FrogError(told[0])
        return True


class Clocks(Kind):
    """``cameras_opencv.json`` of unequal clocks: opened as a capture, shown in the panel, and corrected."""

    mutations = JSON

    def __init__(self, folder: Path) -> None:
        entries = []
        (folder / "films").mkdir()
        for number, camera in enumerate(rig()):
            encode(folder / "films" / f"{camera.name}.mp4", numbered(6))
            lens = {"K": camera.intrinsics.tolist(), "dist": [-0.1, 0.01, 0, 0, 0], "width": 64, "height": 48}
            pose = {"R": camera.rotation.tolist(), "t": camera.world_to_camera[:3, 3].tolist()}
            clock = {"offset": 0.013 * number, "rate": 1.0, "video": f"films/{camera.name}.mp4"}
            entries.append({"name": camera.name, **lens, **pose, **clock})
        self.path = folder / CAMERAS
        points = np.zeros((3, 3)).tolist()
        self.whole = [json.dumps({"made_by": "frog calibrate", "cameras": entries, "points": points}).encode()]

    def use(self) -> bool:
        try:
            clocks = read_clocks(self.path.parent)
            if clocks is not None and clocks.is_own:
                write_clock(self.path.parent, clocks.clocks[0])
        finally:
            capture = open_capture(self.path.parent)
        assert all(np.isfinite(each.world_to_camera).all() for each in capture.cameras)
        assert all(0 <= shot.frame < capture.frame_count for shot in capture.shots)
        return True


class Stages(Kind):
    """What an earlier run kept: whatever is wrong with it, the stage is done again."""

    mutations = ARCHIVES

    def __init__(self, folder: Path) -> None:
        self._work, random = WorkFolder(folder), np.random.default_rng(0)
        self.path = self._work.file("features", "0")
        self._arrays = {
            "pixels": random.uniform(0, 64, (40, 2)),
            "descriptors": random.integers(0, 255, (40, 128)).astype(np.uint8),
            "moments": np.zeros(40, np.int64),
        }
        self._work.keep("features", "0", self._arrays)
        self.whole = [self.path.read_bytes()]

    def use(self) -> bool:
        found = self._work.load("features", "0")
        assert found is None or all(np.array_equal(found[name], array) for name, array in self._arrays.items())
        return found is not None


class FilmHeaders(Kind):
    """MP4 and Matroska: what PyAV says of them, their sound, and then their images."""

    mutations = BYTES

    def __init__(self, folder: Path) -> None:
        self.path, self.whole = folder / "film.bin", []
        sound = clicks([0.1], 0.3).values
        for name in ("a.mp4", "b.mov", "c.mkv"):
            self.whole.append(encode(folder / name, numbered(9), key_every=4, sound=sound).read_bytes())
        self.whole.append(encode(folder / "d.webm", numbered(9), codec="libvpx").read_bytes())

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

    mutations = BYTES

    def __init__(self, folder: Path) -> None:
        self.path, self.whole = folder / "image.bin", []
        pixels = np.random.default_rng(0).integers(0, 255, (40, 56, 3)).astype(np.uint8)
        exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
        for suffix in (".jpg", ".png", ".webp"):
            content = cv2.imencode(suffix, pixels)[1].tobytes()
            if suffix == ".jpg":
                content = content[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + content[2:]
            self.whole.append(content)

    def use(self) -> bool:
        said = read_photograph(self.path)
        assert said is None or (1 <= said.orientation <= 8 and min(said.size) > 0)
        assert read_image(self.path).ndim == 3
        return True


KINDS: dict[str, type[Kind]] = {
    "boards": Boards,
    "plain boards": PlainBoards,
    "clicked points": ClickedPoints,
    "reports": Reports,
    "clocks": Clocks,
    "stages": Stages,
    "films": FilmHeaders,
    "stills": StillHeaders,
}


if __name__ == "__main__":
    main(KINDS)
