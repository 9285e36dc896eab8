"""What a folder that no reader knows nearly is, and what is missing: one sentence, not a list of all layouts."""

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path

from ...errors import FrogError, found_instead, listed
from ..video import READABLE, VIDEO_SUFFIXES, find_images, unread_format
from .footage import find_footage

_LOOKED_AT = 5000  # entries of a folder
_HEAD = 4096  # bytes of a file
_SPLATS = frozenset({".ply", ".splat", ".splatv", ".spz", ".sog", ".ksplat"})
_ARCHIVES = frozenset({".zip", ".tar", ".gz", ".7z", ".rar", ".r3d", ".tgz"})


def not_a_folder(path: Path) -> FrogError:
    """The error for a path that is a file, or nothing."""
    if not path.exists():
        return FrogError(f"{path}: there is no such folder, expected that of a capture.")
    if path.suffix.lower() in _ARCHIVES:
        return found_instead(path, "an archive", "the folder that it unpacks to")
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return found_instead(path, "a video", "the folder that it lies in, with all the cameras' videos")
    return found_instead(path, "a file", f"the folder of a capture, such as {path.resolve().parent}")


def unknown_folder(path: Path, below: list[Path]) -> FrogError:
    """The error for a folder of no known layout.

    Args:
        below: folders in it that are captures: more than one, or they would have been opened.
    """
    if below:
        first = listed([folder.name for folder in below])
        return found_instead(path, f"{len(below)} captures one folder deeper ({first})", "one of these folders")
    names = sorted(entry.name for entry in _entries(path))
    rules = (_other_programs, _half_a_layout, _archives, _footage, _splats)
    unknown = contents(path), "videos or folders of images with the poses of their cameras (docs/captures.md)"
    return found_instead(path, *next((sentence for rule in rules for sentence in rule(path, names)), unknown))


def contents(folder: Path) -> str:
    """What a folder holds, in words: ``3 .mp4 files and 1 folder``."""
    kinds = Counter("folder" if e.is_dir() else f"{e.suffix.lower() or 'nameless'} file" for e in _entries(folder))
    if not kinds:
        return "an empty folder"
    parts = [f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in kinds.most_common(4)]
    return " and ".join([", ".join(parts[:-1]), parts[-1]]) if len(parts) > 1 else parts[0]


def _entries(folder: Path) -> Iterator[Path]:
    entries = folder.iterdir() if folder.is_dir() else ()  # of a path that names a recording
    return (entry for entry in islice(entries, _LOOKED_AT) if not entry.name.startswith("."))


_Sentence = tuple[str, str]
_COLMAP = "a COLMAP model (sparse/0 with cameras, images and points3D) beside the folder images: export one "
_METASHAPE = _COLMAP + "with File > Export > Export Cameras > COLMAP"
_REALITY_CAPTURE = _COLMAP + "with Alignment > Export > Registration > COLMAP"
_ITS_PROGRAM = _COLMAP + "from the program that wrote them"
_OTHER_PROGRAMS = {
    ".xml": ("<chunk", "cameras of Metashape", _METASHAPE),
    ".psx": ("", "a project of Metashape", _METASHAPE),
    ".psz": ("", "a project of Metashape", _METASHAPE),
    ".csv": ("#name", "cameras of RealityCapture", _REALITY_CAPTURE),
    ".rcproj": ("", "a project of RealityCapture", _REALITY_CAPTURE),
    ".out": ("bundle file", "cameras of Bundler", _ITS_PROGRAM),
    ".nvm": ("", "cameras of VisualSFM", _ITS_PROGRAM),
    ".sfm": ("", "cameras of Meshroom", _ITS_PROGRAM),
    "sfm_data.json": ("", "cameras of OpenMVG", _COLMAP + "with openMVG_main_openMVG2Colmap"),
    "reconstruction.json": ("", "cameras of OpenSfM", _COLMAP + "with opensfm export_colmap"),
}
"""Calibrations without a reader, by the end of their names: what the file says, whose they are, what to export."""
_MAPPER = "a COLMAP project without a model", "cameras.bin and images.bin in sparse/0: did its mapper finish?"
_NERFSTUDIO = "a transforms.json, which nerfstudio's ns-process-data writes of it"
_RECORD3D = "an export of Record3D", _NERFSTUDIO
_PARTS = {
    "annots.npy": ("annots.npy (ZJU-MoCap), which can run programs", "intri.yml and extri.yml of EasyMocap"),
    "extri.yml": ("extri.yml and no intri.yml (EasyVolcap)", "both: the cameras' poses and their lenses"),
    "test_meta.json": ("test_meta.json and no train_meta.json (PanopticSports)", "both, and the images in ims"),
    "dataset.json": ("dataset.json and no folder camera (HyperNeRF)", "camera/ID.json for each image, and rgb/2x"),
    "camera": ("a folder camera and no dataset.json (HyperNeRF)", "dataset.json, metadata.json and rgb beside it"),
    "keyframes": ("an export of Polycam", _NERFSTUDIO),
    "metadata.json": _RECORD3D,
    "metadata": _RECORD3D,
    "sparse_": ("sparse_ without a COLMAP model (multipleview)", "cameras.bin and images.bin in sparse_"),
    "database.db": _MAPPER,
    "sparse": _MAPPER,
}
"""Parts of known layouts, by their names: what is missing beside them, and what is expected."""


def _other_programs(folder: Path, names: list[str]) -> Iterator[_Sentence]:
    for ending, (head, whose, expected) in _OTHER_PROGRAMS.items():
        if (name := _ending(names, ending)) and head in _head(folder / name).lower():
            yield f"{whose} ({name})", expected


def _ending(names: list[str], *endings: str) -> str | None:
    """The first name with one of the endings, such as ``.xml``."""
    return next((name for name in names if name.lower().endswith(endings)), None)


def _head(file: Path) -> str:
    """The beginning of a file."""
    with suppress(OSError), file.open("rb") as opened:
        return opened.read(_HEAD).decode("utf-8", "replace")
    return ""


def _half_a_layout(folder: Path, names: list[str]) -> Iterator[_Sentence]:
    """Known layouts of which a part is missing, or has another name."""
    for below in ("", "sparse/", "sparse/0/"):
        for end in (".bin", ".txt"):
            for part, other in (("cameras", "images"), ("images", "cameras")):
                if (folder / f"{below}{part}{end}").is_file() and not (folder / f"{below}{other}{end}").is_file():
                    yield f"a COLMAP model's {below}{part}{end} and no {other}{end}", "both, and points3D"
    if name := _ending(names, "transforms.json", "transforms_train.json"):
        yield name, "the name transforms.json, beside the images that it lists"
    if name := next((name for name in names if name.startswith("poses_bounds")), None):
        yield name, "the name poses_bounds.npy, beside the videos cam00.mp4, cam01.mp4, ..."
    yield from (sentence for name, sentence in _PARTS.items() if name in names)


def _archives(_: Path, names: list[str]) -> Iterator[_Sentence]:
    archives = [name for name in names if Path(name).suffix.lower() in _ARCHIVES]
    if archives and not any(Path(name).suffix.lower() in VIDEO_SUFFIXES for name in names):
        yield f"{_some(len(archives), 'archive')} ({archives[0]})", "a folder: unpack it"


def raw_footage(folder: Path) -> str:
    """What a folder holds that is to be calibrated first, such as "4 videos"; "" for nothing."""
    footage = find_footage(folder)
    if videos := sum(filmed.is_video for filmed in footage):
        return _some(videos, "video")
    if len(footage) > 1:
        return f"{len(footage)} folders of images"
    count = len(find_images(folder)) or sum(len(filmed.files) + len(filmed.strays) for filmed in footage)
    return f"{count} images" if count > 1 else ""


def _footage(folder: Path, _: list[str]) -> Iterator[_Sentence]:
    """Videos or images without cameras."""
    for holder in (folder, folder / "videos", folder / "images", *sorted(filter(Path.is_dir, _entries(folder)))):
        if raw := raw_footage(holder):
            calibrate = f"poses of the cameras: run `frog calibrate {holder}` (or Calibrate in the panel)"
            yield f"{raw} without calibration", calibrate
    if unread := unread_format(islice(folder.rglob("*"), _LOOKED_AT)):
        yield f"images in {unread}", READABLE


def _splats(_: Path, names: list[str]) -> Iterator[_Sentence]:
    """What is no footage: finished scenes."""
    if name := _ending(names, ".frog"):
        yield f"a finished scene ({name})", "footage to train from; File > Import opens the scene"
    if splats := [name for name in names if Path(name).suffix.lower() in _SPLATS]:
        expected = "a capture; splats (.ply) open with File > Import or `frog import`"
        yield f"{_some(len(splats), 'file')} of finished splats ({splats[0]}) and no footage", expected


def _some(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
