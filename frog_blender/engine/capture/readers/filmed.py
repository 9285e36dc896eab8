"""Which footage each calibrated camera filmed: that of its name, of a name within the other, or of its number."""

import re
from collections.abc import Sequence
from pathlib import Path

from ...errors import found_instead, listed
from ..natural_order import natural
from ..video import composed
from .footage import BETWEEN, DIGITS, Footage, regrouped, several_recordings
from .readings import FOLDERS, check_choice, chosen, numbered

_Named = list[tuple[str, str, Footage]]
"""A camera's name, what footage is called beside it, and the footage."""


def filmed_by(
    path: Path, names: Sequence[str], footage: Sequence[Footage]
) -> tuple[dict[Path, dict[str, Footage]], list[Footage]]:
    """What each of the cameras of these names filmed, as far as some footage has its name, by the path that names the
    recording, {} where it is not clear; and all footage.

    Raises:
        FrogError: if names of images fit the cameras in two ways.
    """
    matches, films = _matches(path, names, footage)
    is_one = len({name for name, _, _ in matches}) == len(matches)
    recordings: dict[Path, dict[str, Footage]] = {}
    for name, rest, film in matches:
        recording = film.recording or film.files[0].parent / rest
        filmed = recordings.setdefault(Path() if is_one else recording, {})
        if name in filmed:
            return {}, films
        filmed[name] = film
    return recordings, films


def _matches(path: Path, names: Sequence[str], footage: Sequence[Footage]) -> tuple[_Named, list[Footage]]:
    """By the first rule that any footage follows, or, where folders are cameras, by a later one that finds more."""
    found: tuple[_Named, list[Footage]] = ([], [*footage])
    ways = [way for way in regrouped(footage) if way[0].is_allowed]
    ways = [way for way in ways if way[0].words >= 0] or ways  # cam1/0000.png is of no moment cam1
    for rule in (_same_name, _same_unpadded, _part_of_name, _same_number):
        if found[0] and rule is _part_of_name:
            break  # names that are the same are never left for those that are alike
        is_exact, in_folders = rule is _same_name, bool(found[0]) or rule is _same_unpadded
        tried = [(reading, films) for reading, films in ways if reading.layout == FOLDERS or not in_folders]
        fits = [(rule(names, films), films, reading) for reading, films in tried]
        fits = [fit for fit in fits if fit[0] and (is_exact or fit[2].layout == FOLDERS or len(fit[0]) == len(fit[1]))]
        if fits:
            most = max(2 * len(matches) - len(films) for matches, films, _ in fits)  # with the least footage left over
            fits = [fit for fit in fits if 2 * len(fit[0]) - len(fit[1]) == most]
            best = chosen(path, [reading for *_, reading in fits])
            other = next((matches, films) for matches, films, reading in fits if reading.choice == best.choice)
            found = max(found, other, key=lambda of: len({name for name, _, _ in of[0]}))
    return found


def of_cameras(path: Path, names: Sequence[str], footage: Sequence[Footage]) -> tuple[dict[str, Footage], list[str]]:
    """The footage of each calibrated camera that has some, by the camera's name, and warnings about what has none.

    A camera's footage has its name, or a name of which one is a part of the other, or its number.

    Args:
        path: of the calibration, for messages.

    Raises:
        FrogError: if no camera has footage, there are several recordings, names of images fit the cameras in two ways,
            or either side's numbers may be counted from elsewhere.
    """
    recordings, films = filmed_by(path, names, footage)
    if len(recordings) > 1:
        raise several_recordings(path, list(recordings))
    filmed = next(iter(recordings.values()), {})
    if not filmed:
        check_choice(path, [reading for reading, _ in regrouped(footage)])
        there = listed([of_camera.name for of_camera in footage])
        have = f"videos or folders of images {there}" if footage else "no video and no folder of images"
        raise found_instead(path, f"cameras {listed(names)} and beside them {have}", "footage of the cameras' names")
    warnings = []
    if lacking := [name for name in names if name not in filmed]:
        counted = f"{len(lacking)} of {len(names)} cameras"
        warnings.append(f"{path}: {counted} are left out, without footage: {listed(lacking)}.")
    used = {of_camera.name for of_camera in filmed.values()}
    if extra := [of_camera.name for of_camera in films if of_camera.name not in used]:
        if lacking and fits_shifted(names, films):
            first, *_, last = sorted(names, key=natural)
            found = f"cameras {first} to {last} and footage {films[0].name} to {films[-1].name}"
            raise found_instead(
                path,
                f"{found}, which may be counted from different numbers",
                f"footage of the cameras' names: rename it, or take {listed(extra)} away if equal numbers are meant",
            )
        warnings.append(f"{path}: footage of no calibrated camera is left out: {listed(extra)}.")
    return filmed, warnings


def fits_shifted(names: Sequence[str], footage: Sequence[Footage]) -> int:
    """How many cameras have footage if films 1 to 4 are those of 0 to 3, and the like; 0 for no more than by number."""
    ours, theirs = (
        {number for number in _numbers(of) if number is not None} for of in (names, [film.name for film in footage])
    )
    steps = 0, *(end(theirs, default=0) - end(ours, default=0) for end in (min, max))
    counted, *shifted = (len(theirs & {number + step for number in ours}) for step in steps)
    return max(shifted) if max(shifted) > counted else 0


def _numbers(names: Sequence[str]) -> list[int | None]:
    """Those that tell most names apart; of names that have none, None."""
    return max((values for values, *_ in numbered(names)), key=lambda values: len({*values}), default=[])


def _same_name(names: Sequence[str], footage: Sequence[Footage]) -> _Named:
    return [(name, "", film) for name in names for film in footage if composed(name) == film.name]


def _same_unpadded(names: Sequence[str], footage: Sequence[Footage]) -> _Named:
    """But for large letters and zeros before numbers. None where these alone tell names apart."""
    if any(len({*map(_unpadded, of)}) < len(of) for of in ({*names}, {film.name for film in footage})):
        return []
    own = {_unpadded(name): name for name in names}
    return [(own[key], "", film) for film in footage if (key := _unpadded(film.name)) in own]


def _unpadded(name: str) -> str:
    return DIGITS.sub(lambda number: number[0].lstrip("0") or "0", composed(name).casefold())


def _part_of_name(names: Sequence[str], footage: Sequence[Footage]) -> _Named:
    """Footage whose name contains a camera's (``vid_cam01`` of ``cam01``), or is contained in it; of cameras' within
    each other that of the longest. None where it is not clear which.
    """
    matches: _Named = []
    for film in footage:
        spans = {name: match.span() for name in names if (match := _within(name, film.name))}
        start = min((first for first, _ in spans.values()), default=0)
        end = max((last for _, last in spans.values()), default=0)
        rests = {name: film.name[:start] + film.name[end:] for name, span in spans.items() if span == (start, end)}
        rests = rests if spans else {name: "" for name in names if _within(film.name, name)}
        if len(rests) != bool(spans or rests):
            return []
        matches += [(name, rest.strip(BETWEEN), film) for name, rest in rests.items()]
    return matches


def _within(part: str, whole: str) -> re.Match[str] | None:
    """Where a name contains another, not within a number or a word: ``camA`` contains ``A``, ``cam10`` no ``cam1``."""
    if not part or part.casefold() not in whole.casefold():
        return None
    return re.search(rf"(?<![^\W_])(cam(era)?[-_ ]?)?{re.escape(part)}(?![^\W_])", whole, re.IGNORECASE)


def _same_number(names: Sequence[str], footage: Sequence[Footage]) -> _Named:
    """Footage with the camera's number (``image1`` and ``cam01``): of several that after a word for cameras, else
    that of the most cameras. None where two cameras have the same, or it is not clear which.
    """
    ours = _numbers(names)
    if len({film.name for film in footage}) < len(footage) or len({*ours}) < len(names):
        return []
    of_numbers = {number: name for number, name in zip(ours, names, strict=True) if number is not None}
    fits = []
    for values, rests, word in numbered([film.name for film in footage]):
        found = zip(values, rests, footage, strict=True)
        matches = [
            (of_numbers[number], rest.strip(BETWEEN), film) for number, rest, film in found if number in of_numbers
        ]
        fits.append(((word > 0 and bool(matches), len({name for name, _, _ in matches}), len(matches)), matches))
    best = [matches for score, matches in fits if score == max(fit[0] for fit in fits)]
    is_clear = len({tuple((name, film.name) for name, _, film in matches) for matches in best}) == 1
    return best[0] if is_clear else []
