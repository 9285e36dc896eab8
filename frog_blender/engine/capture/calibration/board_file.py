"""A board as a person describes it: a small TOML or JSON file."""

from __future__ import annotations

import tomllib
from pathlib import Path

from ...errors import brief, found_instead
from ...io.plain_values import JsonObject, UnfitValue, entries, number, plain_json, text, whole
from ...io.regular_file import regular_file
from .board_detection import DICTIONARIES, MOST_SQUARES, Board

_MOST_BYTES = 2**16
_LARGEST = 10.0  # metres of a square
_INCH = 0.0254


def read_board(path: Path) -> Board:
    """The board of a TOML or JSON file.

    Either ``squares = [4, 5]`` (columns, rows), ``square_size`` and ``marker_size`` in metres (no marker: a
    checkerboard), ``dictionary = "DICT_4X4_50"``, and, where they are so, ``inverted = true`` and ``legacy = true``; or
    Caliscope's ``charuco.toml``: ``columns``, ``rows``, ``aruco_scale``, ``square_size_override_cm``, ``dictionary``,
    ``inverted``.

    Raises:
        FrogError: if the file cannot be read, or describes no board.
    """
    regular_file(path, "a board's description")
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise found_instead(path, f"a file of {path.stat().st_size} bytes", "a board's description")
        content = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise found_instead(path, f"a file that cannot be read ({brief(error)})", "a board's description") from error
    try:
        if path.suffix.lower() == ".json":
            values = entries(plain_json(content, "a text"), "a board")
        else:
            values = tomllib.loads(content)
        return _caliscope(values) if "columns" in values else _board(values)
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise found_instead(
            path, f"no TOML ({brief(error)})", "a board: squares = [4, 5], square_size = 0.05"
        ) from error


def _board(values: JsonObject) -> Board:
    squares = values.get("squares")
    if not isinstance(squares, list) or len(squares) != 2:
        raise UnfitValue(f"squares = {brief(squares)}", "the numbers of columns and rows, as in squares = [4, 5]")
    columns, rows = (whole(count, "a number of squares", 2, MOST_SQUARES) for count in squares)
    square = number(values.get("square_size"), "square_size", 1e-4, _LARGEST)
    if "marker_size" not in values and "dictionary" not in values:
        return _checked(Board(columns, rows, square, 0.0, inverted=_flag(values, "inverted")))
    marker = number(values.get("marker_size"), "marker_size", 0.2 * square, 0.99 * square) / square
    return _checked(
        Board(columns, rows, square, marker, _dictionary(values), _flag(values, "inverted"), _flag(values, "legacy"))
    )


def _caliscope(values: JsonObject) -> Board:
    columns, rows = (whole(values.get(key), key, 2, MOST_SQUARES) for key in ("columns", "rows"))
    marker = number(values.get("aruco_scale"), "aruco_scale", 0.2, 0.99)
    if "square_size_override_cm" in values:
        square = number(values["square_size_override_cm"], "square_size_override_cm", 0.01, 100 * _LARGEST) / 100
    else:
        unit = {"inch": _INCH, "cm": 0.01}.get(str(values.get("units")))
        if unit is None:
            raise UnfitValue(f"units = {brief(values.get('units'))}", "inch or cm, or square_size_override_cm")
        sides = (number(values.get(f"board_{side}"), f"board_{side}", 0.1, 1000) for side in ("width", "height"))
        square = unit * min(side / count for side, count in zip(sides, (columns, rows), strict=True))
    return _checked(
        Board(columns, rows, square, marker, _dictionary(values), _flag(values, "inverted"), _flag(values, "legacy"))
    )


def _checked(board: Board) -> Board:
    if not board.dictionary and (board.columns + board.rows) % 2 == 0:
        raise UnfitValue(
            f"a checkerboard of {board.columns} x {board.rows} squares, which looks the same upside down",
            "an odd and an even number of squares",
        )
    if (board.columns - 1) * (board.rows - 1) < 4:
        raise UnfitValue(f"a board of {board.columns} x {board.rows} squares", "four inner corners or more")
    if board.dictionary and _markers_of(board.dictionary) < board.columns * board.rows // 2:
        raise UnfitValue(f"{board.dictionary} for {board.columns} x {board.rows} squares", "a larger dictionary")
    return board


def _markers_of(dictionary: str) -> int:
    """How many markers a dictionary has, as far as its name says."""
    size = dictionary.rsplit("_", 1)[-1]
    return int(size) if size.isdecimal() else MOST_SQUARES**2


def _dictionary(values: JsonObject) -> str:
    name = text(values.get("dictionary"), "dictionary", 64)
    known = {dictionary.lower(): dictionary for dictionary in DICTIONARIES}
    if name.lower() not in known:
        raise UnfitValue(f"dictionary = {brief(name)}", "one of OpenCV's, such as DICT_4X4_50")
    return known[name.lower()]


def _flag(values: JsonObject, key: str) -> bool:
    value = values.get(key, False)
    if type(value) is not bool:
        raise UnfitValue(f"{key} = {brief(value)}", "true or false")
    return value
