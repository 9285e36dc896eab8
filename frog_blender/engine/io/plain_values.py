"""Plain values from a file's JSON, checked one by one: kind, range, length. Nothing is believed before."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from ..arrays import Array
from ..errors import brief, printable

_MOST_LISTS = 2**20  # a hundred bytes each, however few the text takes for them
_LARGEST = 2**63


# Any: of what kind a value is shows only when it is checked, one by one.
JsonObject: TypeAlias = dict[str, Any]
JsonMapping: TypeAlias = Mapping[str, Any]
JsonList: TypeAlias = list[Any]


class UnfitValue(ValueError):
    """A value that cannot be; ``found`` and ``expected`` are the halves of a sentence."""

    def __init__(self, found: str, expected: str) -> None:
        super().__init__(f"{found}, expected {expected}")
        self.found, self.expected = found, expected


def plain_json(text: str, what: str) -> object:
    """What a JSON text says. UnfitValue when it is none, or would take far more memory than its characters."""
    if text.count("[") + text.count("{") > _MOST_LISTS:
        raise UnfitValue(f"{what} of more than {_MOST_LISTS} lists", "fewer")
    try:
        found: object = json.loads(text)
        return found
    except (ValueError, RecursionError) as error:
        raise UnfitValue(f"{what} that is no JSON ({brief(error)})", "a whole one") from error


def whole(value: object, what: str, least: int, most: int) -> int:
    """A whole number from ``least`` to ``most``; UnfitValue for anything else, ``true`` among it."""
    if type(value) is not int or not least <= value <= most:
        raise UnfitValue(f"{what} = {brief(value)}", f"a whole number from {least} to {most}")
    return value


def number(value: object, what: str, least: float, most: float) -> float:
    """A number from ``least`` to ``most``; UnfitValue for anything else, NaN among it."""
    if (type(value) is int or type(value) is float) and least <= value <= most:
        return float(value)
    raise UnfitValue(f"{what} = {brief(value)}", f"a number from {least:g} to {most:g}")


def numbers(value: object, what: str, shape: tuple[int, ...], most: float) -> Array:
    """Finite float64 numbers of that shape, none beyond ``most`` either way; UnfitValue for anything else."""
    rows: JsonList = [value]
    flat: Any = value  # a list of numbers from here on, or a single one for no shape
    for length in shape:
        if any(type(row) is not list or len(row) != length for row in rows):
            raise UnfitValue(f"{what} = {brief(value)}", f"{' x '.join(map(str, shape))} numbers")
        rows = flat = [each for row in rows for each in row]
    if not (set(map(type, flat)) <= {int, float} and all(-most <= each <= most for each in flat)):
        for each in flat:
            number(each, what, -most, most)
    return np.array(flat, np.float64).reshape(shape)


def text(value: object, what: str, longest: int) -> str:
    """A text of at most so many characters, in which control characters are written out; UnfitValue otherwise."""
    if type(value) is not str or len(value) > longest:
        raise UnfitValue(f"{what} = {brief(value)}", f"a text of at most {longest} characters")
    return printable(value)


def items(value: object, what: str, most: int) -> JsonList:
    """A list of at most ``most`` values; UnfitValue otherwise."""
    if type(value) is not list or len(value) > most:
        found = f"{len(value)} {what}" if isinstance(value, list) else f"{what} = {brief(value)}"
        raise UnfitValue(found, f"a list of at most {most}")
    return value


def entries(value: object, what: str) -> JsonObject:
    """A JSON object; UnfitValue for anything else."""
    if type(value) is not dict:
        raise UnfitValue(f"{what} = {brief(value)}", "an object of named values")
    found: JsonObject = value
    return found


def finite_entries(value: object, what: str) -> JsonObject:
    """The same, all of whose numbers, however deep, are finite and fit into 64 bits."""
    found = entries(value, what)
    waiting: list[object] = [found]
    while waiting:
        each = waiting.pop()
        if isinstance(each, dict | list):
            waiting += each.values() if isinstance(each, dict) else each
        elif isinstance(each, int | float) and not (math.isfinite(each) if isinstance(each, float) else _fits(each)):
            raise UnfitValue(f"{what} with {brief(each)}", "finite numbers")
    return found


def _fits(value: int) -> bool:
    return -_LARGEST <= value < _LARGEST
