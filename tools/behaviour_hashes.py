"""Records what the program computes, bit by bit, so that a refactoring can show that it changed nothing.

    python tools/behaviour_hashes.py record BEFORE.json      # before a change
    python tools/behaviour_hashes.py record AFTER.json       # after it, on the same machine
    python tools/behaviour_hashes.py compare BEFORE.json AFTER.json

``record`` writes tiny captures, trains them with every method and in many settings, resumes, plays, renders, exports,
imports and evaluates, calibrates films and images, and hashes every array and image. ``compare`` prints what differs
and exits with status 1.

Only the command line, the file formats on disk and Blender's operator and property names are used: no module of the
package is imported (but for ``frog_blender`` itself, which Blender registers), so any of them may be renamed.

The same bits are expected on one machine with one set of libraries. Some things are not recorded, since two runs of
the same code differ in them or since words are no behaviour: seconds, memory, file sizes (which depend on how many
digits a number of seconds has), paths, versions, what is printed, and the image of the capacity report. Trainings
that a signal stops are not among the runs, since where they stop is chance.
"""

from __future__ import annotations

import argparse
import fnmatch
import hashlib
import json
import multiprocessing
import os
import platform
import re
import runpy
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
WIDTH, HEIGHT, FOCAL = 64, 48, 67.0
FRAMES = 8
MOVING_FRAMES = 16
_UNSTABLE = re.compile(
    r"seconds|milliseconds|memory|megabytes|version|path|(^|_)(date|capture|folder|file|files|bytes|torch|device)$|^scene$"
)
_SENTENCES = re.compile(r"^(training|reductions|warning)$")
"""Names of entries in JSON that are left out: those that no two runs share, and the words of ``frog info``."""

Hashes = dict[str, str]


# Captures: a ray traced wall, with a ball before it ------------------------------------------------------------------


def _texture(u: np.ndarray, v: np.ndarray, salt: int) -> np.ndarray:
    """Colours (N, 3) in [0, 1] of surface points: smooth noise of two sizes, so that views can be matched."""
    color = np.zeros((*u.shape, 3))
    for size, weight in ((0.45, 0.6), (0.14, 0.4)):
        x, y = u / size, v / size
        left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        across, down = x - left, y - top
        across, down = across * across * (3 - 2 * across), down * down * (3 - 2 * down)
        for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
            corner = (left + dx) * 7919 + (top + dy) * 104729 + salt * 1299709 + round(size * 100)
            share = (across if dx else 1 - across) * (down if dy else 1 - down)
            for channel in range(3):
                bits = (corner + channel * 15485863) & 0x7FFFFFFF
                bits = ((bits ^ (bits >> 13)) * 1274126177) & 0x7FFFFFFF
                noise = ((bits ^ (bits >> 16)) % 1024) / 1023
                color[..., channel] += weight * share * noise
    return color


def _look_at(center: np.ndarray) -> np.ndarray:
    """(3, 3) rotation from world to camera (x right, y down, z forward) of a camera that looks at the origin."""
    forward = -center / np.linalg.norm(center)
    right = np.cross((0.0, 1.0, 0.0), forward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _rays(center: np.ndarray, distortion: np.ndarray | None, size: int = 1) -> np.ndarray:
    """(H, W, 3) directions in the world, one for each pixel's centre of an image ``size`` times as large."""
    columns, rows = np.meshgrid(np.arange(size * WIDTH) + 0.5, np.arange(size * HEIGHT) + 0.5)
    pixels = np.stack([columns, rows], -1).reshape(-1, 1, 2) / size
    matrix = _intrinsics()
    coefficients = np.zeros(5) if distortion is None else distortion
    plane = cv2.undistortPoints(pixels, matrix, coefficients).reshape(*columns.shape, 2)
    return np.concatenate([plane, np.ones((*columns.shape, 1))], -1) @ _look_at(center)


def _intrinsics() -> np.ndarray:
    return np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])


def _ball(time_: float) -> np.ndarray:
    return np.array([-0.7 + 1.4 * time_, 0.25 * np.sin(5 * time_), -0.5])


def _image(
    center: np.ndarray, ball: np.ndarray, distortion: np.ndarray | None = None, gain: float = 1.0, wall: bool = True
) -> np.ndarray:
    """(H, W, 4) uint8, BGRA: what a camera at ``center`` sees of the wall at z = 0.6 and of a ball."""
    rays = _rays(center, distortion)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    distance = (0.6 - center[2]) / rays[..., 2]
    on_wall = center + distance[..., None] * rays
    color = 0.15 + 0.6 * _texture(on_wall[..., 0], on_wall[..., 1], 1)
    alpha = np.full((HEIGHT, WIDTH), 1.0 if wall else 0.0)
    away, radius = center - ball, 0.32
    half = rays @ away
    root = half * half - (away @ away - radius * radius)
    hit = root > 0
    at = center + (-half - np.sqrt(np.maximum(root, 0)))[..., None] * rays - ball
    painted = np.array([1.0, 0.7, 0.25]) * (0.35 + 0.65 * _texture(at[..., 0] * 1.5, at[..., 1] * 1.5 + at[..., 2], 2))
    color[hit], alpha[hit] = painted[hit], 1.0
    rgba = np.concatenate([gain * color, alpha[..., None]], -1)
    return np.ascontiguousarray(np.rint(rgba.clip(0, 1) * 255).astype(np.uint8)[..., [2, 1, 0, 3]])


def _arc(count: int, reach: float = 0.4) -> list[np.ndarray]:
    return [
        np.array([3 * np.sin(angle), 0.3 * np.cos(7 * angle), -3 * np.cos(angle)])
        for angle in np.linspace(-reach, reach, count)
    ]


def _write_video(path: Path, images: list[np.ndarray]) -> None:
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 24.0, (width, height))
    for image in images:
        writer.write(np.ascontiguousarray(image[..., :3]))
    writer.release()


def _write_n3dv(folder: Path, ball: Callable[[float], np.ndarray]) -> None:
    """Videos of four standing cameras and ``poses_bounds.npy``; the first camera is held out."""
    rows = []
    for name, center in enumerate(np.array(_arc(4))[[2, 0, 1, 3]]):
        images = [_image(center, ball(frame / (FRAMES - 1))) for frame in range(FRAMES)]
        _write_video(folder / f"cam{name:02}.mp4", images)
        right, down, forward = _look_at(center)
        matrix = np.stack([down, right, -forward, center, [HEIGHT, WIDTH, FOCAL]], axis=1)
        rows.append([*matrix.ravel(), 1.5, 6.0])
    np.save(folder / "poses_bounds.npy", np.array(rows))


def _write_rig(folder: Path) -> None:
    _write_n3dv(folder, _ball)


def _write_still(folder: Path) -> None:
    _write_n3dv(folder, lambda time_: _ball(0.5))


def _write_appearing(folder: Path) -> None:
    """The ball is there for three of the frames."""
    hidden = np.array([0.0, 0.0, 5.0])  # behind the wall
    _write_n3dv(folder, lambda time_: _ball(time_) if 0.3 < time_ < 0.8 else hidden)


def _write_exposed(folder: Path) -> None:
    """Videos of three cameras through distorting lenses, unlike in exposure, and ``cameras_opencv.json``."""
    cameras = []
    settings = zip("abc", _arc(3), (1.0, 0.8, 1.2), (-0.12, 0.05, 0.08), strict=True)
    for name, center, gain, bend in settings:
        distortion = np.array([bend, 0.01, 0.001, -0.001, 0.0])
        images = [_image(center, _ball(frame / (FRAMES - 1)), distortion, gain) for frame in range(FRAMES)]
        _write_video(folder / f"{name}.mp4", images)
        rotation = _look_at(center)
        place = {"R": rotation.tolist(), "t": (-rotation @ center).tolist()}
        lens = {"K": _intrinsics().tolist(), "dist": distortion.tolist()}
        cameras.append({"name": name, "width": WIDTH, "height": HEIGHT, **lens, **place})
    (folder / "cameras_opencv.json").write_text(json.dumps({"cameras": cameras}))


def _listed(center: np.ndarray, file: Path, frame_time: float) -> dict[str, Any]:
    pose = np.eye(4)
    pose[:3, :3] = _look_at(center).T @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = center
    return {"file_path": file.name, "time": frame_time, "transform_matrix": pose.tolist()}


def _write_moving(folder: Path) -> None:
    """One camera on its way along an arc, and ``transforms.json``."""
    entries = []
    for frame, center in enumerate(_arc(MOVING_FRAMES)):
        frame_time = frame / (MOVING_FRAMES - 1)
        file = folder / f"{frame:03}.png"
        cv2.imwrite(str(file), _image(center, _ball(frame_time))[..., :3])
        entries.append(_listed(center, file, frame_time))
    lens = {"w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2}
    (folder / "transforms.json").write_text(json.dumps({**lens, "fps": 12.0, "frames": entries}))


def _write_cutout(folder: Path) -> None:
    """Images with an alpha channel in D-NeRF's lists."""
    lens = {"camera_angle_x": 2 * float(np.arctan(WIDTH / 2 / FOCAL))}
    for split, count, shift in (("train", 12, 0.0), ("test", 3, 0.02)):
        entries = []
        for frame, center in enumerate(_arc(count)):
            frame_time = frame / (count - 1)
            file = folder / f"{split}_{frame:03}.png"
            cv2.imwrite(str(file), _image(center + shift, _ball(frame_time), wall=False))
            entries.append(_listed(center + shift, file, frame_time))
        (folder / f"transforms_{split}.json").write_text(json.dumps({**lens, "frames": entries}))


_ROOM = ((2, 1.2), (1, 0.7), (0, 1.1), (0, -1.1))
"""Walls and floor of the films to be calibrated: the axis that each is square to, and where."""
_FILMED = 5  # times as large as the captures


def _film_frame(center: np.ndarray, ball: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8, BGR: a room and a ball in it, large enough for features."""
    rays = _rays(center, None, _FILMED)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    color, nearest = np.zeros(rays.shape), np.full(rays.shape[:2], np.inf)
    for salt, (axis, place) in enumerate(_ROOM):
        with np.errstate(divide="ignore"):
            distance = (place - center[axis]) / rays[..., axis]
        on = center + distance[..., None] * rays
        u, v = np.delete(on, axis, axis=-1).reshape(-1, 2).T.reshape(2, *distance.shape)
        seen = (distance > 0) & (distance < nearest)
        color[seen] = 0.1 + 0.8 * _texture(2 * u[seen], 2 * v[seen], 3 + salt)
        nearest[seen] = distance[seen]
    away, radius = center - ball, 0.25
    half = rays @ away
    root = half * half - (away @ away - radius * radius)
    hit = (root > 0) & (-half < nearest)
    at = (away + (-half - np.sqrt(root.clip(0)))[..., None] * rays)[hit]
    color[hit] = np.array([1.0, 0.7, 0.25]) * _texture(3 * at[:, 0], 3 * at[:, 1] + at[:, 2], 2)
    return np.ascontiguousarray(np.rint(color.clip(0, 1) * 255).astype(np.uint8)[..., ::-1])


def _write_films(folder: Path) -> None:
    """Videos of four standing cameras and no calibration."""
    for name, center in enumerate(_arc(4, 0.25)):
        images = [_film_frame(center, _ball(frame / (FRAMES - 1))) for frame in range(FRAMES)]
        _write_video(folder / f"cam{name:02}.mp4", images)


def _write_path(folder: Path) -> None:
    """Images of a camera on its way, and no calibration."""
    for frame, center in enumerate(_arc(10, 0.25)):
        cv2.imwrite(str(folder / f"{frame:03}.png"), _film_frame(center, _ball(0.5)))


CAPTURES = {
    "rig": _write_rig,
    "moving": _write_moving,
    "still": _write_still,
    "appearing": _write_appearing,
    "exposed": _write_exposed,
    "cutout": _write_cutout,
}
FOOTAGE = {"films": _write_films, "path": _write_path}
"""What is calibrated, and not trained on."""


# Runs ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """One training and what follows it.

    Attributes:
        name: unique; the beginning of its hashes' names.
        capture: one of CAPTURES, or of FOOTAGE to be calibrated; "" for neither.
        arguments: of ``frog train``.
        then: of a second ``frog train --resume``, where there is one.
        quick: part of ``--quick``.
        plays: rendered, exported and evaluated as well.
        blender: played in Blender as well.
        scene: a file that is played instead of a training's.
    """

    name: str
    capture: str
    arguments: tuple[str, ...] = ()
    then: tuple[str, ...] = ()
    quick: bool = False
    plays: bool = False
    blender: bool = False
    scene: Path | None = None


def _run(name: str, capture: str, arguments: str, then: str = "", **options: Any) -> Run:
    return Run(name, capture, tuple(arguments.split()), tuple(then.split()), **options)


_DRAFT = "--recipe draft --steps"
_SMALL = "--max-gaussians 800 --recipe draft --steps"
RUNS = (
    _run("rig-frog", "rig", f"{_SMALL} 200", quick=True, plays=True, blender=True),
    _run("rig-frog-lossless", "rig", f"{_SMALL} 200 --lossless", quick=True),
    _run("rig-frog-fixed", "rig", f"{_SMALL} 150 --capacity fixed", quick=True, plays=True),
    _run("rig-frog-fixed-lossless", "rig", f"{_SMALL} 100 --capacity fixed --lossless"),
    _run("rig-frog-seed", "rig", f"{_SMALL} 100 --seed 2"),
    _run("rig-frog-bytes", "rig", f"{_DRAFT} 150 --max-bytes 48000", quick=True),
    _run("rig-frog-many", "rig", f"{_DRAFT} 80"),
    _run("rig-frog-half", "rig", f"{_SMALL} 120 --scale 0.5 --holdout-frames 3"),
    _run("rig-frog-resumed", "rig", f"{_SMALL} 100 --save-every 1", "--steps 200", quick=True),
    _run("rig-frog-standard", "rig", "--recipe standard --max-gaussians 800 --steps 100"),
    _run("rig-frog-paper", "rig", "--recipe paper --max-gaussians 800 --steps 40"),
    _run("rig-frog-hypernerf", "rig", "--recipe hypernerf --max-gaussians 800 --steps 40"),
    _run("rig-frog-technicolor", "rig", "--recipe technicolor --max-gaussians 800 --steps 40"),
    _run("rig-static", "rig", f"{_SMALL} 120 --method static", quick=True, plays=True),
    _run("rig-ed3dgs", "rig", f"{_SMALL} 150 --method ed3dgs", quick=True, plays=True),
    _run("rig-ed3dgs-resumed", "rig", f"{_SMALL} 60 --method ed3dgs", "--steps 120"),
    _run("rig-d3dgs", "rig", f"{_SMALL} 80 --method d3dgs", quick=True, plays=True),
    _run("rig-d3dgs-resumed", "rig", f"{_SMALL} 40 --method d3dgs", "--steps 80"),
    _run("rig-hexplane", "rig", f"{_SMALL} 80 --method hexplane", quick=True, plays=True),
    _run("rig-hexplane-resumed", "rig", f"{_SMALL} 40 --method hexplane", "--steps 80"),
    _run("rig-curves", "rig", f"{_SMALL} 150 --method curves", quick=True, plays=True),
    _run("rig-curves-resumed", "rig", f"{_SMALL} 60 --method curves", "--steps 120"),
    _run("moving-frog", "moving", f"{_SMALL} 200", quick=True, plays=True, blender=True),
    _run("moving-frog-resumed", "moving", f"{_SMALL} 100 --holdout-frames 0", "--steps 200"),
    _run("moving-ed3dgs-fixed", "moving", f"{_SMALL} 100 --method ed3dgs --capacity fixed"),
    _run("still-frog", "still", f"{_SMALL} 200", quick=True, plays=True, blender=True),
    _run("still-frog-resumed", "still", f"{_SMALL} 100", "--steps 200"),
    _run("still-curves", "still", f"{_SMALL} 100 --method curves"),
    _run("appearing-frog", "appearing", f"{_SMALL} 300", plays=True),
    _run("exposed-frog", "exposed", f"{_SMALL} 200", quick=True, plays=True),
    _run("exposed-frog-resumed", "exposed", f"{_SMALL} 100", "--steps 200"),
    _run("exposed-static", "exposed", f"{_SMALL} 100 --method static --capacity fixed"),
    _run("cutout-frog", "cutout", f"{_SMALL} 150", plays=True),
    _run("calibrated-films", "films", "", quick=True),
    _run("calibrated-path", "path", "--moving", quick=True),
)


_CONTEXT = multiprocessing.get_context(
    "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else None
)


def _command_line(arguments: list[str], folder: Path, said: Path) -> None:
    """``frog`` in a process of its own; what it prints goes into a file."""
    os.chdir(folder)
    with said.open("wb") as file:
        for stream in (sys.stdout, sys.stderr):
            os.dup2(file.fileno(), stream.fileno())
    sys.argv = ["frog", *arguments]
    runpy.run_module("frog_blender.cli", run_name="__main__")


def _isolate(folder: Path) -> None:
    """Nothing that other trainings left in the user's folders may decide anything, and nothing stays there."""
    os.environ |= {f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS")}
    places = {"FROG_CACHE": "cache", "HOME": "home", "XDG_CACHE_HOME": "home/cache", "XDG_CONFIG_HOME": "home/config"}
    os.environ |= {name: str(folder / place) for name, place in places.items()}
    (folder / "home").mkdir(parents=True)
    # Processes are forked from one that has imported what takes seconds: half of the time that all runs would take.
    _CONTEXT.set_forkserver_preload(["cv2", "torch", "torch.fx.experimental.symbolic_shapes"])


def _file_runs() -> list[Run]:
    """Scenes of the tests: no training as short as these finds Gaussians that come and go."""
    files = sorted((ROOT / "tests" / "fixtures" / "scenes").glob("*.frog"))
    return [Run(f"file-{path.stem}", "", quick=True, plays=True, blender=True, scene=path) for path in files]


@dataclass(frozen=True)
class Recorder:
    """Runs commands below ``folder`` and hashes what they leave there."""

    folder: Path
    blender: bool

    def frog(self, *arguments: str | Path) -> str:
        """What the command prints; SystemExit with it where it fails."""
        handle, name = tempfile.mkstemp(dir=self.folder)
        os.close(handle)
        words, said = [*map(str, arguments)], Path(name)
        process = _CONTEXT.Process(target=_command_line, args=(words, self.folder, said))
        process.start()
        process.join()
        text = said.read_text(errors="replace")
        said.unlink()
        if process.exitcode:
            raise SystemExit(f"frog {' '.join(words)}\nfailed with status {process.exitcode}:\n{text[-4000:]}")
        return text

    def _play_in_blender(self, scene: Path, folder: Path) -> None:
        command = [sys.executable, str(Path(__file__).resolve()), "blender", str(scene), str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=self.folder)
        if done.returncode:
            raise SystemExit(f"{' '.join(command)}\nfailed with status {done.returncode}:\n{done.stderr[-4000:]}")

    def _values(self, *arguments: str | Path) -> dict[str, Any]:
        """The JSON that a command prints, behind what it says of its progress."""
        text = self.frog(*arguments, "--json")
        values: dict[str, Any] = json.loads(text[text.index("{\n") :])
        return values

    def info(self, path: Path) -> Hashes:
        said = self._values("info", path)
        return hash_values({key: value for key, value in said.items() if not _SENTENCES.search(key)})

    def record(self, run: Run) -> Hashes:
        """All hashes of a run; its names begin with the run's."""
        folder = self.folder / run.name
        folder.mkdir()
        scene = folder / "scene.frog"
        found: Hashes = {}
        if run.scene:
            shutil.copyfile(run.scene, scene)
            found |= self._played(scene, folder)
        elif run.capture in FOOTAGE:
            found |= self._calibrated(run, folder)
        else:
            found |= self._trained(run, scene, self.folder / "captures" / run.capture)
        if run.blender and self.blender:
            self._play_in_blender(scene, folder / "blender")
            found |= _named("blender", hash_folder(folder / "blender"))
        shutil.rmtree(folder)
        return _named(run.name, found)

    def _calibrated(self, run: Run, folder: Path) -> Hashes:
        """What ``frog calibrate`` writes; pycolmap gives the same bits as well."""
        FOOTAGE[run.capture](folder)
        self.frog("calibrate", folder, *run.arguments)
        files = [folder / name for name in ("cameras_opencv.json", "transforms.json") if (folder / name).is_file()]
        return {k: v for path in files for k, v in hash_values(json.loads(path.read_text()), path.stem).items()}

    def _trained(self, run: Run, scene: Path, capture: Path) -> Hashes:
        found: Hashes = {}
        self.frog("train", capture, "--out", scene, "--device", "cpu", *run.arguments)
        if run.then:
            found |= _named("half", self._files(scene))
            self.frog("train", capture, "--out", scene, "--device", "cpu", "--resume", *run.then)
        found |= self._files(scene)
        if run.plays:
            found |= self._evaluated(scene, capture) | self._played(scene, scene.parent)
        return found

    def _files(self, scene: Path) -> Hashes:
        found = _named("scene", hash_tensors(scene))
        checkpoint = scene.with_name(f"{scene.name}.checkpoint")
        return found | (_named("checkpoint", hash_tensors(checkpoint)) if checkpoint.exists() else {})

    def _evaluated(self, scene: Path, capture: Path) -> Hashes:
        seen = self._values("eval", scene, capture, "--split", "training")
        found = _named("eval", hash_values(self._values("eval", scene, capture)))
        return found | _named("eval-training", hash_values(seen))

    def _played(self, scene: Path, folder: Path) -> Hashes:
        found = _named("info", self.info(scene))
        camera = json.loads(_header(scene)[0]["frog"])["cameras"][-1]["name"]
        self.frog("render", scene, "--camera", camera, "--frames", "0:4", "--out", folder / "render")
        self.frog("export", scene, "--frames", "1:4", "--out", folder / "export")
        self.frog("export", scene, "--frames", "2:3", "--y-down", "--out", folder / "export_y_down")
        splats = min((folder / "export").glob("*.ply"))
        self.frog("import", splats, "--out", folder / "imported" / "lossless.frog")
        self.frog("import", splats, "--packed", "--out", folder / "imported" / "packed.frog")
        for name in ("render", "export", "export_y_down", "imported"):
            found |= _named(name, hash_folder(folder / name))
        return found


def _named(prefix: str, hashes: Hashes) -> Hashes:
    return {f"{prefix}/{name}": value for name, value in hashes.items()}


# Hashes of files -----------------------------------------------------------------------------------------------------


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:20]


def hash_array(array: np.ndarray) -> str:
    """Type, shape and a hash of the bytes."""
    return f"{array.dtype}{list(array.shape)} {_digest(np.ascontiguousarray(array).tobytes())}"


def hash_values(values: Any, name: str = "") -> Hashes:
    """One entry for each name in (nested) JSON, short values as they are; what no two runs share is left out."""
    if isinstance(values, dict):
        found: Hashes = {}
        unstable = {"before", "after"} if values.get("what") == "packed" else set()  # which are bytes
        for key, value in sorted(values.items()):
            if key not in unstable and not _UNSTABLE.search(key):
                found |= hash_values(value, f"{name}.{key}" if name else key)
        return found
    if isinstance(values, list) and values and all(isinstance(value, dict) for value in values):
        return {k: v for i, value in enumerate(values) for k, v in hash_values(value, f"{name}.{i}").items()}
    content = json.dumps(values)
    return {name: content if len(content) <= 60 else f"{len(content)} characters {_digest(content.encode())}"}


def _header(path: Path) -> tuple[dict[str, str], dict[str, Any], bytes]:
    """Metadata, entries and the arrays' bytes of a safetensors file."""
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    return header.pop("__metadata__", {}), header, data[8 + length :]


def hash_tensors(path: Path) -> Hashes:
    """Arrays and metadata of a .frog, a checkpoint or a bake."""
    metadata, entries, data = _header(path)
    found: Hashes = {}
    for name, entry in sorted(entries.items()):
        begin, end = entry["data_offsets"]
        found[name] = f"{entry['dtype']}{entry['shape']} {_digest(data[begin:end])}"
    for key, content in metadata.items():
        if _UNSTABLE.search(key):
            continue
        try:
            found |= _named("metadata", hash_values(json.loads(content), key))
        except ValueError:
            found |= _named("metadata", hash_values({key: content}))
    return found


def hash_file(path: Path) -> Hashes:
    """The decoded content of a file, by its kind."""
    if path.suffix in (".png", ".jpg", ".exr"):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        return {path.name: hash_array(image)}
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return _named(path.name, {name: hash_array(arrays[name]) for name in arrays.files})
    if path.suffix in (".frog", ".checkpoint", ".frogbake"):
        return _named(path.name, hash_tensors(path))
    return {path.name: f"{path.stat().st_size} bytes {_digest(path.read_bytes())}"}


def hash_folder(folder: Path) -> Hashes:
    """Every file below a folder."""
    found: Hashes = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            inside = path.parent.relative_to(folder).as_posix()
            found |= hash_file(path) if inside == "." else _named(inside, hash_file(path))
    return found


# Blender -------------------------------------------------------------------------------------------------------------


def play_in_blender(options: argparse.Namespace) -> int:
    """Imports a scene into the bpy module and writes what frames show, a bake and a rendered image into ``folder``."""
    import bpy

    import frog_blender
    from frog_blender.scene_import.capture_objects import active_capture

    folder: Path = options.folder
    folder.mkdir(parents=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    frog_blender.register()
    bpy.ops.import_scene.frog(filepath=str(options.scene), show_clips=False)
    scene, carrier = bpy.context.scene, active_capture(bpy.context)
    for frame in (1, 3, 6):
        scene.frame_set(frame)
        np.savez(folder / f"points_{frame}.npz", **_attributes(carrier.data))
    scene.frame_start, scene.frame_end = 2, 5
    carrier.frog.bake_folder = str(folder)
    try:
        bpy.ops.frog.bake()
        scene.frame_set(4)
        np.savez(folder / "baked_points.npz", **_attributes(carrier.data))
    except RuntimeError as error:  # nothing moves; where something does, the hashes are missed
        print(error)
    cameras = [obj for obj in scene.objects if obj.type == "CAMERA"]
    np.savez(folder / "cameras.npz", **{obj.name: np.array(obj.matrix_world) for obj in cameras})
    scene.render.engine = "FROG"
    scene.render.resolution_percentage = 100
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = str(folder / "image.png")
    bpy.ops.render.render(write_still=True)
    frog_blender.unregister()
    return 0


def _attributes(data: Any) -> dict[str, np.ndarray]:
    """The attributes of a point cloud or a mesh, flat."""
    found = {}
    for attribute in data.attributes:
        if not len(attribute.data):
            continue
        fields = ("vector", "color", "value")
        name = next(name for name in fields if name in attribute.data[0].bl_rna.properties)
        size = np.size(getattr(attribute.data[0], name))
        values = np.zeros(size * len(attribute.data), np.float32)
        attribute.data.foreach_get(name, values)
        found[attribute.name] = values
    return found


# Commands ------------------------------------------------------------------------------------------------------------


def record(options: argparse.Namespace) -> int:
    began = time.monotonic()
    package = find_spec("frog_blender")
    if package is None or package.origin is None:
        raise SystemExit("frog_blender is not installed for this Python.")
    print(f"Recording {Path(package.origin).parent}", flush=True)
    runs = [run for run in (*RUNS, *_file_runs()) if run.quick or not options.quick]
    runs = [run for run in runs if any(fnmatch.fnmatch(run.name, pattern) for pattern in options.only)]
    hashes: Hashes = {}
    with tempfile.TemporaryDirectory(prefix="behaviour_") as parent:
        _isolate(Path(parent))
        blender = find_spec("bpy") is not None if options.blender is None else options.blender
        recorder = Recorder(Path(parent).resolve(), blender)
        for name in sorted({run.capture for run in runs} & CAPTURES.keys()):
            folder = recorder.folder / "captures" / name
            folder.mkdir(parents=True)
            CAPTURES[name](folder)
            # This decodes the frames as well, which no two runs may do at once.
            hashes |= _named(f"capture-{name}", recorder.info(folder))
        with ThreadPoolExecutor(options.jobs) as pool:
            for done, (run, found, seconds) in enumerate(pool.map(lambda run: _timed(recorder, run), runs), 1):
                hashes |= found
                print(f"[{done}/{len(runs)}] {run.name}: {len(found)} hashes, {seconds:.1f} s", flush=True)
    about = {"machine": _machine(), "quick": options.quick, "blender": blender}
    options.file.write_text(json.dumps({"about": about, "hashes": dict(sorted(hashes.items()))}, indent=0) + "\n")
    print(f"{len(hashes):,} hashes of {len(runs)} runs in {options.file} ({time.monotonic() - began:.0f} s).")
    return 0


def _timed(recorder: Recorder, run: Run) -> tuple[Run, Hashes, float]:
    began = time.monotonic()
    return run, recorder.record(run), time.monotonic() - began


def _machine() -> str:
    model = re.search(r"model name\s*: (.*)", _read(Path("/proc/cpuinfo")))
    return f"{platform.system()} {model.group(1) if model else platform.processor()}"


def _read(path: Path) -> str:
    return path.read_text() if path.exists() else ""


def differences(before: Hashes, after: Hashes, ignored: list[str] | None = None) -> Iterator[str]:
    """A line for each hash that is not the same; names that match a pattern of ``ignored`` are passed over."""
    for name in sorted(before.keys() | after.keys()):
        if before.get(name) == after.get(name) or any(fnmatch.fnmatch(name, pattern) for pattern in ignored or ()):
            continue
        yield f"{name}: {before.get(name, 'missing')} -> {after.get(name, 'missing')}"


def compare(options: argparse.Namespace) -> int:
    before, after = (json.loads(path.read_text()) for path in (options.before, options.after))
    if before["about"]["machine"] != after["about"]["machine"]:
        print(f"Recorded on different machines: {before['about']['machine']}; {after['about']['machine']}.")
    old, new = before["hashes"], after["hashes"]
    if options.common:  # such as a quick record and a full one
        runs = {name.split("/")[0] for name in old} & {name.split("/")[0] for name in new}
        old, new = ({k: v for k, v in each.items() if k.split("/")[0] in runs} for each in (old, new))
    lines = list(differences(old, new, options.ignore))
    for line in lines:
        print(line)
    touched = sorted({line.split("/")[0] for line in lines})
    where = f", in {', '.join(touched)}" if touched else ""
    print(f"{len(lines):,} of {len(old.keys() | new.keys()):,} hashes differ{where}.")
    return 1 if lines else 0


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(required=True)
    recording = commands.add_parser("record", help="run everything and write the hashes")
    recording.add_argument("file", type=Path)
    recording.add_argument("--quick", action="store_true", help="one run of each kind")
    recording.add_argument("--only", nargs="+", default=["*"], metavar="RUN", help="runs by name, such as 'rig-*'")
    recording.add_argument("--jobs", type=int, default=2, help="runs at once; default: 2")
    recording.add_argument("--blender", action=argparse.BooleanOptionalAction, help="default: where bpy is installed")
    recording.set_defaults(run=record)
    comparing = commands.add_parser("compare", help="print what differs; exit status 1 if anything does")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    comparing.add_argument("--ignore", nargs="+", default=[], metavar="NAME", help="hashes by name, such as '*/eval/*'")
    comparing.add_argument("--common", action="store_true", help="compare only the runs that both files have")
    comparing.set_defaults(run=compare)
    playing = commands.add_parser("blender", help="play one scene in the bpy module (used by record)")
    playing.add_argument("scene", type=Path)
    playing.add_argument("folder", type=Path)
    playing.set_defaults(run=play_in_blender)
    options = parser.parse_args(arguments)
    status: int = options.run(options)
    return status


if __name__ == "__main__":
    sys.exit(main())
