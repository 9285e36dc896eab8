"""Plain values from a file's JSON, checked one by one: kind, range, length. Nothing is believed before."""

from __future__ import annotations

import json
import math
from typing import Any, TypeAlias

import numpy as np

from ..arrays import Array
from ..errors import brief, printable

_MOST_LISTS = 2**20  # a hundred bytes each, however few the text takes for them
_LARGEST = 2**63


JsonObject: TypeAlias = dict[str, Any]
"""Named values as JSON gives them: of any kind until they are checked."""


class UnfitValue(ValueError):
    """A value that cannot be; ``found`` and ``expected`` are the halves of a sentence."""

    def __init__(self, found: str, expected: str) -> None:
        super().__init__(f"{found}, expected {expected}")
        self.found, self.expected = found, expected


def plain_json(text: str, what: str) -> Any:
    """What a JSON text says. UnfitValue when it is none, or would take far more memory than its characters."""
    if text.count("[") + text.count("{") > _MOST_LISTS:
        raise UnfitValue(f"{what} of more than {_MOST_LISTS} lists", "fewer")
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UnfitValue(f"{what} that is no JSON ({brief(error)})", "a whole one") from error


def whole(value: Any, what: str, least: int, most: int) -> int:
    """A whole number from ``least`` to ``most``; UnfitValue for anything else, ``true`` among it."""
    if type(value) is not int or not least <= value <= most:
        raise UnfitValue(f"{what} = {brief(value)}", f"a whole number from {least} to {most}")
    return value


def number(value: Any, what: str, least: float, most: float) -> float:
    """A number from ``least`` to ``most``; UnfitValue for anything else, NaN among it."""
    if type(value) not in (int, float) or not least <= value <= most:
        raise UnfitValue(f"{what} = {brief(value)}", f"a number from {least:g} to {most:g}")
    return float(value)


def numbers(value: Any, what: str, shape: tuple[int, ...], most: float) -> Array:
    """Finite float64 numbers of that shape, none beyond ``most`` either way; UnfitValue for anything else."""
    rows, flat = [value], value
    for length in shape:
        if any(type(row) is not list or len(row) != length for row in rows):
            raise UnfitValue(f"{what} = {brief(value)}", f"{' x '.join(map(str, shape))} numbers")
        rows = flat = [each for row in rows for each in row]
    if not (set(map(type, flat)) <= {int, float} and all(-most <= each <= most for each in flat)):
        for each in flat:
            number(each, what, -most, most)
    return np.array(flat, np.float64).reshape(shape)


def text(value: Any, what: str, longest: int) -> str:
    """A text of at most so many characters, in which control characters are written out; UnfitValue otherwise."""
    if type(value) is not str or len(value) > longest:
        raise UnfitValue(f"{what} = {brief(value)}", f"a text of at most {longest} characters")
    return printable(value)


def items(value: Any, what: str, most: int) -> list[Any]:
    """A list of at most ``most`` values; UnfitValue otherwise."""
    if type(value) is not list or len(value) > most:
        found = f"{len(value)} {what}" if isinstance(value, list) else f"{what} = {brief(value)}"
        raise UnfitValue(found, f"a list of at most {most}")
    return value


def entries(value: Any, what: str) -> JsonObject:
    """A JSON object; UnfitValue for anything else."""
    if type(value) is not dict:
        raise UnfitValue(f"{what} = {brief(value)}", "an object of named values")
    found: JsonObject = value
    return found


def finite_entries(value: Any, what: str) -> JsonObject:
    """The same, all of whose numbers, however deep, are finite and fit into 64 bits."""
    found = entries(value, what)
    waiting: list[Any] = [found]
    while waiting:
        each = waiting.pop()
        if isinstance(each, dict | list):
            waiting += each.values() if isinstance(each, dict) else each
        elif isinstance(each, int | float) and not (math.isfinite(each) if isinstance(each, float) else _fits(each)):
            raise UnfitValue(f"{what} with {brief(each)}", "finite numbers")
    return found


def _fits(value: int) -> bool:
    return -_LARGEST <= value < _LARGEST
