"""A capture's masks: ``masks`` for its subject, ``ignore`` for what must not be learned, and images' own alpha.

Both folders have the same layouts. White is the subject, or what is ignored.

- ``masks/IMAGE.png`` or ``masks/FOLDER/IMAGE.png``: of an image file of that name, below the capture's folder.
- ``masks/CAMERA/0000.png`` and on: of a film's frames in order, numbered from 0 or 1 without a gap.
- ``masks/CAMERA.png``: of all frames of a camera.
- ``masks/CAMERA.mp4``: a film of masks, a frame for each of the camera's film.
"""

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

from ...errors import FrogError, found_instead, listed
from ..capture import Capture, Shot
from ..masking import EVERY_MASK, MaskSettings, MaskSource, chroma_key
from ..media import read_photograph
from ..video import IMAGE_SUFFIXES, VIDEO_SUFFIXES, composed, image_size, read_facts
from .checks import check_images
from .readings import number_of

SUBJECT, IGNORED = "masks", "ignore"
"""Folders in a capture's."""
_MAY_BE_MASK = re.compile(r"(?i)(^|[^a-z])(masks?|mattes?|segmentations?)($|[^a-z])")
_DEPTH = 4  # folders below ``masks``
_SHOWN = 3  # names in a sentence


def with_masks(capture: Capture, settings: MaskSettings = EVERY_MASK) -> Capture:
    """The capture with the masks that lie in its folder, the alpha of its images, and the key. A folder of what is
    ignored stands for the masks that a list of images names.

    Raises:
        FrogError: for masks of a part of the images, or of another size than their images.
    """
    if not settings.use:
        return capture.without_masks()
    subjects, ignored = (_masks(capture, capture.path / name) for name in (SUBJECT, IGNORED))
    warnings = [
        f"{capture.path / name}: none of the masks has the name of a camera or an image; they are not used."
        for name, masks in ((SUBJECT, subjects), (IGNORED, ignored))
        if masks and not any(masks)
    ]
    warnings += _left_aside(capture)
    ignored = ignored or [shot.ignore for shot in capture.shots]
    masks = zip(capture.shots, subjects or [None] * len(ignored), ignored, strict=True)
    shots = [replace(shot, mask=mask, ignore=ignore) for shot, mask, ignore in masks]
    _check_complete(capture, shots)
    photographs = cache(read_photograph)
    for index, shot in enumerate(shots):
        if shot.mask is None and shot.path.suffix.lower() not in VIDEO_SUFFIXES:
            photograph = photographs(shot.path)
            if photograph is not None and photograph.has_alpha:
                shots[index] = replace(shot, mask=MaskSource(shot.path, is_alpha=True))
    _check_sizes(shots)
    key = chroma_key(settings.key) if settings.key else None
    return replace(capture, shots=tuple(shots), key=key, warnings=(*capture.warnings, *warnings))


def _left_aside(capture: Capture) -> Iterator[str]:
    """What is named as masks are and lies where none are looked for."""
    files = {source.path for shot in capture.shots for source in (shot, shot.mask, shot.ignore) if source}
    used = files.union(*((folder, *folder.parents) for folder in {file.parent for file in files}))
    folders = {path.parent for path in files if path.suffix.lower() not in VIDEO_SUFFIXES} | {capture.path}
    for folder in sorted(filter(Path.is_dir, folders)):  # the path of one of several recordings may be no folder
        named = [path for path in sorted(folder.iterdir()) if _MAY_BE_MASK.search(path.stem)]
        aside = [path for path in named if path.is_dir() or path.suffix.lower() in IMAGE_SUFFIXES]
        aside = [path for path in aside if path.name != SUBJECT and path not in used]
        if aside:
            yield (
                f"{folder}: {aside[0].name} (of {len(aside)} such) may be a mask and is not used: masks belong into "
                f"{capture.path.name}/{SUBJECT}, named as their images."
            )


def _check_complete(capture: Capture, shots: list[Shot]) -> None:
    """FrogError where some images have a mask and others none: those would teach their background."""
    missing = [shot for shot in shots if shot.mask is None]
    if not missing or len(missing) == len(shots):
        return
    names = [f"{capture.cameras[shot.camera].name} at frame {shot.frame}" for shot in missing]
    found = f"no mask for {len(missing)} of {len(shots)} images ({listed(names, _SHOWN)})"
    raise found_instead(capture.path / SUBJECT, found, "one for each image, or none")


def _check_sizes(shots: list[Shot]) -> None:
    """FrogError where the first mask of a camera has not its image's size; the others are compared when decoded."""
    first = {
        (shot.camera, kind): (shot, mask)
        for shot in reversed(shots)
        for kind, mask in (("mask", shot.mask), ("ignore", shot.ignore))
        if mask and not mask.is_alpha
    }
    for shot, mask in first.values():
        (width, height), expected = _sizes(mask.path)[0], _sizes(shot.path)
        if (width, height) not in expected:
            its = f"{expected[0][0]} x {expected[0][1]} pixels as {shot.path.name} has"
            raise found_instead(mask.path, f"a mask of {width} x {height} pixels", its)


def _sizes(path: Path) -> list[tuple[int, int]]:
    """(width, height) as it is shown and as it is stored."""
    if path.suffix.lower() not in VIDEO_SUFFIXES:
        return [image_size(path)]
    facts = read_facts(path)
    return [(facts.width, facts.height), facts.stored]


def _masks(capture: Capture, folder: Path) -> list[MaskSource | None]:
    """The mask of each shot in a folder of masks; [] where the folder holds none."""
    files = _files(folder) if folder.is_dir() else {}
    numbered: dict[str, dict[int, Path]] = {}
    stems = Counter(path.stem for path in {shot.path for shot in capture.shots})

    def find(shot: Shot) -> MaskSource | None:
        camera = capture.cameras[shot.camera].name
        if shot.path.suffix.lower() not in VIDEO_SUFFIXES:
            names = [*_names_of(capture, shot.path), f"{camera}/{shot.path.stem}"]
            names += [shot.path.stem] if stems[shot.path.stem] == 1 else []
            for name in names:
                if (path := files.get(name)) is not None and path.suffix.lower() in IMAGE_SUFFIXES:
                    return MaskSource(path)
        for name in dict.fromkeys((camera, composed(shot.path.stem))):
            if (path := files.get(name)) is not None:
                return MaskSource(path, shot.index if path.suffix.lower() in VIDEO_SUFFIXES else 0)
            if shot.path.suffix.lower() in VIDEO_SUFFIXES:
                if name not in numbered:
                    inside = [path for key, path in files.items() if key.rpartition("/")[0] == name]
                    images = [path for path in inside if path.suffix.lower() in IMAGE_SUFFIXES]
                    needed = max(other.index + 1 for other in capture.shots if other.path == shot.path)
                    numbered[name] = _in_order(folder / name, images, needed) if images else {}
                if numbered[name]:
                    return MaskSource(numbered[name][shot.index])
        return None

    return list(map(find, capture.shots)) if files else []


def _files(folder: Path) -> dict[str, Path]:
    """The images and videos below a folder by their paths in it without the ending."""
    known = VIDEO_SUFFIXES | set(IMAGE_SUFFIXES)
    files: dict[str, Path] = {}
    for depth in range(_DEPTH + 1):
        for path in sorted(folder.glob("*/" * depth + "*")):
            inside = path.relative_to(folder)
            if path.suffix.lower() in known and path.is_file() and not any(part[0] == "." for part in inside.parts):
                files.setdefault(composed(inside.with_suffix("").as_posix()), path)
                check_images(folder, len(files))
    return files


def _names_of(capture: Capture, image: Path) -> list[str]:
    """The names that the mask of an image may have: its path in the capture, without and with its ending."""
    try:
        inside = image.resolve().relative_to(capture.path.resolve())
    except ValueError:
        return []
    below = Path(*inside.parts[1:])  # ``images/cam00/0000.png`` may have its mask in ``masks/cam00``
    paths = [inside, below] if len(inside.parts) > 1 else [inside]
    return [composed(name.as_posix()) for path in paths for name in (path.with_suffix(""), path)]


def _in_order(folder: Path, files: list[Path], needed: int) -> dict[int, Path]:
    """The masks of a film's frames by frame; FrogError unless they are numbered from 0 or 1 and none is missing."""
    numbered: dict[int, Path] = {}
    for path in files:
        number = number_of(path.stem)
        if number is None:
            raise found_instead(path, "a name without a number", "the number of a frame")
        numbered[number] = path
    first = 0 if 0 in numbered else 1
    missing = [frame for frame in range(first, first + needed) if frame not in numbered]
    if missing:
        shown = f"{len(missing)} of {needed} masks are missing (number {listed(missing, _SHOWN)})"
        raise FrogError(f"{folder}: {shown}, expected one for each frame of the film, numbered from 0 or 1.")
    return {number - first: path for number, path in numbered.items() if number >= first}
