"""Which camera, and which time, an image has: by its name, its pose and its lens. The one place that decides it.

``cam0/0003.png``, ``cam0_frame3.png``, ``0003/images/cam0.png`` and ``frame3_cam0.png`` are all of camera 0 at time 3.
What varies in names tells cameras and times, but often not which is which. Then poses do: those of a camera that stands
agree, and those of a rig that moves keep to one another. A camera has one lens and one size of images. Without poses
words tell (cam0, frame3). Where several readings are left, the user says which.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path, PurePosixPath

import numpy as np

from ...arrays import Float64s
from ...errors import FrogError
from ..natural_order import natural

AUTO, CAMERAS, MOMENTS, MOVING, ONE_MOMENT = "auto", "cameras", "moments", "moving", "one-moment"
FOLDERS = "a folder a camera"
LAYOUTS = (AUTO, CAMERAS, MOMENTS, MOVING, ONE_MOMENT)
CHOSEN: ContextVar[str] = ContextVar("layout", default=AUTO)
"""What the user says of the names of the capture that is being opened: ``AUTO`` is nothing; what stands first in them,
folders for instance, are cameras, or moments; all are of one moving camera; or of one moment."""

_TOKEN = re.compile(r"[0-9]+|/|[^0-9/]+")
_LAST_NUMBER = re.compile(r"(.*?)(\d+)\D*", re.DOTALL)
_MOST_DIGITS = 18
_HOLDERS = frozenset({"images", "image", "imgs", "img", "input", "rgb"})  # folders that tell nothing
_OF_CAMERAS = re.compile(r"(.*(cam|camera|view|gopro|kinect)|(.*[^a-z])?c)[\W_]*", re.IGNORECASE)
_OF_TIMES = re.compile(r"(.*(frame|time|moment|step)s?|(.*[^a-z])?(f|t|ts|colmap))[\W_]*", re.IGNORECASE)
_MOST_FIELDS = 6  # of a name, between which cameras may end and times begin
_SHORT = 2  # digits of the row or the column of a camera
_SAME_TURN, _SAME_PLACE = np.radians(0.5), 0.005  # of the distance between the outermost cameras
_FILLED = 0.75  # of the images that the reading with the fewest gaps has of all cameras at all times


_CONDITIONS = {
    FOLDERS: "folders are cameras",
    "a folder a moment": "folders are moments",
    "camera_time": "names begin with the camera",
    "time_camera": "names begin with the moment",
    "one moving camera": "one camera moved",
    "one moment": "all were taken at once",
}
"""The layouts, and what a user would know of them."""


@contextmanager
def chosen_layout(choice: str) -> Iterator[None]:
    """The user's ``choice`` for what is opened inside the block; FrogError for none of ``LAYOUTS``."""
    if choice not in LAYOUTS:
        raise FrogError(f"layout = {choice!r}, expected one of {', '.join(LAYOUTS)}.")
    before = CHOSEN.set(choice)
    try:
        yield
    finally:
        CHOSEN.reset(before)


@dataclass(frozen=True, eq=False)
class View:
    """What is known of an image.

    Attributes:
        pose: (4, 4) world to camera; None where it is not known.
        kind: its lens, or its size: images of one camera have one.
    """

    pose: Float64s | None = None
    kind: object = None


@dataclass(frozen=True)
class Reading:
    """A way to read the names of images.

    Attributes:
        choice: what ``CHOSEN`` says of it.
        layout: one of ``_CONDITIONS``.
        cameras: the name of each image's camera.
        times: of each image; equal numbers are one time.
        words: in the names that speak for it, less those against it.
        doubt: a sentence, where another reading is as likely.
    """

    choice: str
    layout: str
    cameras: tuple[str, ...]
    times: tuple[int, ...]
    words: int = 0
    doubt: str = ""

    @property
    def is_grid(self) -> bool:
        """Whether it has cameras and times."""
        return self.choice in (CAMERAS, MOMENTS)

    @property
    def is_allowed(self) -> bool:
        """Whether the user has chosen it, or nothing."""
        return CHOSEN.get() in (AUTO, self.choice)

    @property
    def is_unique(self) -> bool:
        """Whether no camera has two images of one time."""
        return len({*zip(self.cameras, self.times, strict=True)}) == len(self.cameras)

    def __str__(self) -> str:
        cameras, moments = len({*self.cameras}), len({*self.times})
        counted = f"{cameras} camera{'s'[: cameras > 1]} of {moments} moment{'s'[: moments > 1]}"
        return f"{counted}, if {_CONDITIONS[self.layout]} (--layout {self.choice})"


@dataclass(frozen=True)
class _Field:
    """A number or a text that varies in names; the first of several that vary together.

    Attributes:
        columns: its places among the tokens of the names.
        part: of the path: 0 for the first folder.
        values: of each image.
        word: 1 after a word for cameras, -1 after one for times, else 0.
    """

    columns: tuple[int, ...]
    part: int
    values: tuple[str, ...]
    word: int

    @property
    def is_numbered(self) -> bool:
        return all(map(_is_number, self.values))


_Columns = list[tuple[int, tuple[str, ...]]]
"""The tokens of names, of each place that of every name, with the part of the path that it is in."""


def is_moment(name: str) -> bool:
    """Whether a folder of this name may be of one moment: a number, with no word or one for times before it."""
    word = name.rstrip("0123456789")
    return word != name and (not word or _OF_TIMES.fullmatch(word) is not None)


def number_of(stem: str) -> int | None:
    """The last number in a name (``frame_00012`` and ``00012_rgb``: 12); None where there is none."""
    return split_number(stem)[1]


def split_number(stem: str) -> tuple[str, int | None]:
    """What stands before the last number of a name, and the number; the whole name and None where there is none."""
    match = _LAST_NUMBER.fullmatch(stem)
    return (match[1], int(match[2])) if match and len(match[2]) <= _MOST_DIGITS else (stem, None)


def read_names(path: Path, names: Sequence[str], views: Sequence[View] = (), extent: float = 0.0) -> Reading:
    """The reading of images' names that poses, lenses and words leave, or that the user has ``CHOSEN``.

    Args:
        path: of the capture, for messages.
        names: of the images, no two alike: paths below one folder, with slashes.
        views: of each image; none where nothing is known.
        extent: of the places of the cameras, in the poses' units.

    Raises:
        FrogError: if several readings are left, or the chosen one is none.
    """
    return chosen(path, readings(names, every=CHOSEN.get() != AUTO), views, extent)


def chosen(path: Path, candidates: Sequence[Reading], views: Sequence[View] = (), extent: float = 0.0) -> Reading:
    """The reading of several that ``read_names`` takes."""
    left = check_choice(path, candidates)
    left = likely(left, views, extent) if len(left) > 1 else left
    first, *others = left
    if others and {reading.choice for reading in left} != {MOVING, ONE_MOMENT}:  # a scan of a scene is often both
        raise several_readings(path, left)
    doubt = f"{path}: the images may be {_listed(left)}; the first is taken." if others else ""
    return replace(first, doubt=doubt)


def several_readings(path: Path, left: Sequence[Reading]) -> FrogError:
    """The error for names of which the user is to say how they are read."""
    return FrogError(f"{path}: the images' names can be read in {len(left)} ways, say which: {_listed(left)}.")


def check_choice(path: Path, candidates: Sequence[Reading]) -> list[Reading]:
    """The readings that the user's choice allows; FrogError for none."""
    left = [reading for reading in candidates if reading.is_allowed]
    if not left:
        raise FrogError(
            f"{path}: --layout {CHOSEN.get()} does not fit the images' names, expected {_listed(candidates)}."
        )
    return left


def _listed(candidates: Sequence[Reading]) -> str:
    return "; or ".join(map(str, candidates))


def readings(names: Sequence[str], *, every: bool = False) -> list[Reading]:
    """The ways to read the names of images, at least one, the likelier ones of equal rights first.

    Args:
        every: also those that only somebody who knows it would choose.
    """
    columns = _columns(names)
    fields, fixed = _fields(columns)
    candidates = [reading for reading in _grids(columns, fields) if reading.is_unique]
    word = sum(field.word for field in fields if field.part == fields[-1].part) or -fixed
    is_alone = every or not candidates or any(len({*field.values}) == len(names) for field in fields)
    if is_alone or fields[-1].word > 0 or _is_array(fields):
        cameras = _names(columns, fields, is_whole=True)
        at_once = Reading(ONE_MOMENT, "one moment", cameras, (0,) * len(names), word)
        candidates += [at_once] if at_once.is_unique else []
    if not candidates or (is_alone and len(names) > 1):
        times = numbers_of(names) or order_of(names)
        moving = Reading(MOVING, "one moving camera", ("camera",) * len(names), times, -word)
        in_file = [field for field in fields if field.part == columns[-1][0]]
        is_first = any(number_of(value) is not None for field in in_file for value in field.values)
        candidates.insert(max(len(candidates) - is_first, 0), moving)
    return candidates


def likely(candidates: Sequence[Reading], views: Sequence[View] = (), extent: float = 0.0) -> list[Reading]:
    """The readings that poses, lenses and words leave, one of each choice."""
    left, poses, kinds = list(candidates), [view.pose for view in views], [view.kind for view in views]
    if any(pose is not None for pose in poses):
        left = _best(left, [_standing(reading, poses, extent) for reading in left], 0.0)
    if len(left) > 1 and any(pose is not None for pose in poses):
        rigid = _best(left, [_standing(reading, _on_rig(reading, poses), extent) for reading in left], 0.5)
        left = left if sum(reading.is_grid for reading in left) == len(rigid) > 1 else rigid
    elif MOVING not in {reading.choice for reading in left}:  # no name tells an image: cameras and times do
        left = [reading for reading in left if reading.is_grid] or left
    if 1 < len({*kinds}) < len(kinds) and all(of.is_grid for of in left):
        left = [of for of in left if len({*zip(of.cameras, kinds, strict=True)}) == len({*of.cameras})] or left
    left = [reading for reading in left if reading.words == max(other.words for other in left)]
    share = {id(of): len(of.times) / len({*of.cameras}) / len({*of.times}) for of in left if of.is_grid}
    left = [reading for reading in left if share.get(id(reading), 1.0) >= _FILLED * max(share.values(), default=0.0)]
    return list({reading.choice: reading for reading in reversed(left)}.values())[::-1]


def middle(poses: Sequence[Float64s], extent: float) -> int | None:
    """Which of a camera's poses, each (4, 4), is in their middle; None if it moves by more than COLMAP may be off.

    Args:
        extent: of the places of all cameras.
    """
    stacked = np.array(poses)
    turns = stacked[:, :3, :3]
    centers = -np.einsum("nji,nj->ni", turns, stacked[:, :3, 3])
    apart = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    nearest = int(apart.argmin())
    cosines = (np.einsum("nij,ij->n", turns, turns[nearest]) - 1) / 2
    turned = np.arccos(np.clip(cosines, -1, 1)).max()
    return nearest if turned <= _SAME_TURN and apart.max() <= _SAME_PLACE * extent else None


def _best(candidates: list[Reading], scores: list[float], least: float) -> list[Reading]:
    """The readings whose scores are near the best one; all where that is too low to tell."""
    best = max(scores, default=0.0)
    return [reading for reading, score in zip(candidates, scores, strict=True) if score >= best - 0.5 or best < least]


def _standing(reading: Reading, poses: Sequence[Float64s | None], extent: float) -> float:
    """1 where the cameras of a reading stand, -1 where they move, 0 where their poses do not tell."""
    if reading.choice == ONE_MOMENT:
        return -1.0  # no pose can contradict it
    of_cameras: dict[str, list[Float64s]] = defaultdict(list)
    for camera, pose in zip(reading.cameras, poses, strict=False):
        if pose is not None:
            of_cameras[camera].append(pose)
    several = [of_camera for of_camera in of_cameras.values() if len(of_camera) > 1]
    stand = sum(len(of_camera) for of_camera in several if middle(of_camera, extent) is not None)
    return 2 * stand / sum(map(len, several)) - 1 if several else 0.0


def _on_rig(reading: Reading, poses: Sequence[Float64s | None]) -> list[Float64s | None]:
    """The poses relative to those that the camera with the most images has at the same times."""
    if not reading.is_grid:
        return []
    images = list(zip(reading.cameras, reading.times, poses, strict=True))
    ((first, _),) = Counter(camera for camera, _, pose in images if pose is not None).most_common(1)
    inverse = {time: np.linalg.inv(pose) for camera, time, pose in images if camera == first and pose is not None}
    return [
        None if pose is None or camera == first or time not in inverse else pose @ inverse[time]
        for camera, time, pose in images
    ]


def _is_number(token: str) -> bool:
    return token.isascii() and token.isdecimal() and len(token) <= _MOST_DIGITS


def _columns(names: Sequence[str]) -> _Columns:
    paths = [PurePosixPath(name) for name in names]
    folders = ["/".join(part for part in path.parent.parts if part.lower() not in _HOLDERS) for path in paths]
    stems = [path.stem for path in paths]
    numbered = [split_number(stem) for stem in stems]
    irregular = [*zip(*((text, str(number)) for text, number in numbered), strict=True)]
    if any(number is None for _, number in numbered):
        irregular = [tuple(stems)]
    before = _split(folders) or [tuple(folder.replace("/", "_") for folder in folders)]
    tokens = [*before, ("/",) * len(names), *(_split(stems) or irregular)]
    return list(zip(accumulate(int(token[0] == "/") for token in tokens), tokens, strict=True))


def _split(texts: Sequence[str]) -> list[tuple[str, ...]]:
    """The tokens of texts by their places; none where the texts are not alike."""
    rows = [_TOKEN.findall(text) for text in texts]
    kinds = {tuple("/" if token == "/" else _is_number(token) for token in row) for row in rows}
    return list(zip(*rows, strict=True)) if len(kinds) == 1 else []


def _fields(columns: _Columns) -> tuple[list[_Field], int]:
    """What varies, and the words of those numbers that do not."""
    fields: dict[tuple[int, ...], _Field] = {}
    fixed = 0
    for index, (part, values) in enumerate(columns):
        word = _word(columns, index)
        order: dict[str, int] = {}
        ranks = tuple(order.setdefault(value, len(order)) for value in values)
        if len(order) == 1:
            fixed += word
        else:
            field = fields.get(ranks, _Field((), part, values, word))
            fields[ranks] = replace(field, columns=(*field.columns, index), word=field.word or word)
    return list(fields.values()), fixed


def _word(columns: _Columns, index: int) -> int:
    """1 for a number after a word for cameras, -1 after one for times, else 0."""
    (part, values), before = columns[index], columns[index - 1] if index else (-1, ("",))
    text = before[1][0] if before[0] == part and len({*before[1]}) == 1 and _is_number(values[0]) else ""
    return bool(_OF_CAMERAS.fullmatch(text)) - bool(_OF_TIMES.fullmatch(text))


def _grids(columns: _Columns, fields: list[_Field]) -> Iterator[Reading]:
    """The readings as cameras and times: of those of one choice first the one that ends at a folder."""
    cuts = list(range(max(1, len(fields) - _MOST_FIELDS), len(fields)))
    cuts.sort(key=lambda cut: (fields[cut - 1].part == fields[cut].part, len(fields) - cut))
    for cut in cuts:
        first, last = fields[:cut], fields[cut:]
        is_folder = first[-1].part < last[0].part
        if is_folder or all(field.is_numbered for field in last):
            words = sum(field.word for field in first) - sum(field.word for field in last)
            cameras = _names(columns, first, is_whole=is_folder)
            yield Reading(CAMERAS, FOLDERS if is_folder else "camera_time", cameras, _numbers(last), words)
        if all(field.is_numbered for field in first):
            words = sum(field.word for field in last) - sum(field.word for field in first)
            words += not all(field.is_numbered for field in last)  # left.png: no program numbers frames by texts
            after = max(column for field in first for column in field.columns if column < last[0].columns[0])
            cameras = _names(columns, last, after=after)
            if len({*cameras}) < len(cameras):
                layout = "a folder a moment" if is_folder else "time_camera"
                yield Reading(MOMENTS, layout, cameras, _numbers(first), words)


def _names(columns: _Columns, fields: list[_Field], *, after: int = -1, is_whole: bool = False) -> tuple[str, ...]:
    """Of cameras: from the begin of the part of the path that their first field is in to their last field.

    Args:
        after: the column that they begin behind.
        is_whole: to the end of that part.
    """
    first, last = (fields[0], fields[-1]) if fields else (_Field((0,), columns[-1][0], (), 0),) * 2
    tokens = [
        values
        for index, (part, values) in enumerate(columns)
        if index > after and first.part <= part and (part <= last.part if is_whole else index <= last.columns[0])
    ]
    return tuple("".join(name).strip("_-. /").replace("/", "_") for name in zip(*tokens, strict=True))


def _numbers(fields: list[_Field]) -> tuple[int, ...]:
    """The times that fields tell: their number, or where there are several, or texts, their order."""
    if len(fields) == 1 and fields[0].is_numbered:
        return tuple(map(int, fields[0].values))
    return order_of(["/".join(values) for values in zip(*(field.values for field in fields), strict=True)])


def numbers_of(names: Sequence[str]) -> tuple[int, ...]:
    """The number that alone varies in names, and is another in each; () where there is none."""
    fields, _ = _fields(_columns(names))
    numbers = _numbers(fields) if len(fields) == 1 and fields[0].is_numbered else ()
    return numbers if len({*numbers}) == len(names) else ()


def numbered(names: Sequence[str]) -> Iterator[tuple[list[int | None], list[str], int]]:
    """The numbers that vary in names, and the last one, which comes first: of each name its value, None where the name
    is not made as most are, and what else the name says; and 1 after a word for cameras, -1 after one for times, else
    0.
    """
    rows = [_TOKEN.findall(name) for name in names]
    kinds = [tuple(map(_is_number, row)) for row in rows]
    ((common, _),) = Counter(kinds).most_common(1) or [((), 0)]
    columns = list(zip(*(row for row, kind in zip(rows, kinds, strict=True) if kind == common), strict=True))
    places = [place for place, is_number in enumerate(common) if is_number]
    for place in reversed(places):
        if place == places[-1] or len({*columns[place]}) > 1:
            values = [int(row[place]) if kind == common else None for row, kind in zip(rows, kinds, strict=True)]
            rests = ["".join(row[:place] + row[place + 1 :]) for row in rows]
            yield values, rests, _word([(0, tokens) for tokens in columns], place)


def order_of(names: Sequence[str]) -> tuple[int, ...]:
    """The places of names, of which no two are alike, in their natural order."""
    ranks = {name: rank for rank, name in enumerate(sorted({*names}, key=lambda name: (natural(name), name)))}
    return tuple(ranks[name] for name in names)


def _is_array(fields: list[_Field]) -> bool:
    """Whether the fields may be rows and columns of cameras, which are counted from 0 or 1."""
    are_short = all(field.part == fields[0].part and max(map(len, field.values)) <= _SHORT for field in fields)
    return are_short and all(min(map(int, field.values)) <= 1 for field in fields if field.is_numbered)
