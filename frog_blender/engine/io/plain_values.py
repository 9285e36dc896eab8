"""Plain values from a file's JSON, checked one by one: kind, range, length. Nothing is believed before."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeAlias, Union, get_args, get_origin, get_type_hints

import numpy as np

from ..arrays import Array
from ..errors import brief, printable

_MOST_LISTS = 2**20  # a hundred bytes each, however few the text takes for them
_LARGEST = 2**63
_FARTHEST = 1e300  # of a number that is read back
_LONGEST = 2**20  # characters of a text that is read back


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
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UnfitValue(f"{what} that is no JSON ({brief(error)})", "a whole one") from error


def kept_json(path: Path) -> JsonObject:
    """The JSON object that an earlier run wrote to a file; {} where it cannot be read."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}


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
        rows = flat = [part for row in rows for part in row]
    if not (set(map(type, flat)) <= {int, float} and all(-most <= part <= most for part in flat)):
        for part in flat:
            number(part, what, -most, most)
    return np.array(flat, np.float64).reshape(shape)


def text(value: object, what: str, longest: int) -> str:
    """A text of at most so many characters, in which control characters are written out; UnfitValue otherwise."""
    if type(value) is not str or len(value) > longest:
        raise UnfitValue(f"{what} = {brief(value)}", f"a text of at most {longest} characters")
    return printable(value)


def items(value: object, what: str, most: int) -> JsonList:
    """A list of at most ``most`` values; UnfitValue otherwise."""
    if type(value) is not list or len(value) > most:
        said = f"{len(value)} {what}" if isinstance(value, list) else f"{what} = {brief(value)}"
        raise UnfitValue(said, f"a list of at most {most}")
    return value


def entries(value: object, what: str) -> JsonObject:
    """A JSON object; UnfitValue for anything else."""
    if type(value) is not dict:
        raise UnfitValue(f"{what} = {brief(value)}", "an object of named values")
    return value


def finite_entries(value: object, what: str) -> JsonObject:
    """The same, all of whose numbers, however deep, are finite and fit into 64 bits."""
    named = entries(value, what)
    waiting: list[object] = [named]
    while waiting:
        part = waiting.pop()
        if isinstance(part, dict | list):
            waiting += part.values() if isinstance(part, dict) else part
        elif isinstance(part, int | float) and not abs(part) < (_LARGEST if isinstance(part, int) else math.inf):
            raise UnfitValue(f"{what} with {brief(part)}", "finite numbers")
    return named


def plain(value: Any) -> Any:
    """Dataclasses, tuples, arrays and paths as JSON has them, numbers that are not finite as null; see ``typed``."""
    if is_dataclass(value):
        return {part.name: plain(getattr(value, part.name)) for part in fields(value)}
    if isinstance(value, np.ndarray):
        if not value.size and value.ndim > 1:
            return {"shape": list(value.shape)}
        if np.isfinite(value).all():
            return value.tolist()
        known = value.astype(object)
        known[~np.isfinite(value)] = None
        return known.tolist()
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def typed(kind: Any, value: Any, what: str) -> Any:
    """What ``plain`` made plain, by its type, such as ``tuple[Camera, ...]``; null is NaN where a number is expected.

    UnfitValue for anything else. What a number may be beyond its kind is the caller's to check.
    """
    origin, parts = get_origin(kind) or kind, get_args(kind)
    if origin in (Union, UnionType):
        if value is None and NoneType in parts:
            return None
        return typed(next(part for part in parts if part is not NoneType), value, what)
    if origin in (Any, NoneType):
        return value
    if origin is Literal:
        if value not in parts:
            raise UnfitValue(f"{what} = {brief(value)}", f"one of {', '.join(parts)}")
        return value
    if origin is np.ndarray:
        return _typed_array(get_args(parts[1])[0], value, what)
    if is_dataclass(origin) and isinstance(origin, type):
        given, hints = entries(value, what), get_type_hints(origin)
        names = [part.name for part in fields(origin)]
        if missing := set(names) ^ set(given):
            raise UnfitValue(f"{what} with or without {min(missing)}", f"one with {', '.join(names)}")
        return origin(**{name: typed(hints[name], given[name], f"{name} of {what}") for name in names})
    if issubclass(origin, Mapping):
        return {str(name): typed(parts[1], item, f"{name} of {what}") for name, item in entries(value, what).items()}
    if issubclass(origin, str | Path):
        shown = text(value, what, _LONGEST)
        return origin(value if issubclass(origin, Path) else shown)  # a file's name may hold anything
    if issubclass(origin, tuple) and parts[-1:] != (...,):
        kinds = parts or tuple(get_type_hints(origin).values())
        if len(items(value, what, len(kinds))) != len(kinds):
            raise UnfitValue(f"{what} of {len(value)}", f"{len(kinds)}")
        each_typed = [typed(part, item, what) for part, item in zip(kinds, value, strict=True)]
        return tuple(each_typed) if parts else origin(*each_typed)
    if issubclass(origin, Sequence):
        values = [typed(parts[0], item, what) for item in items(value, what, _MOST_LISTS)]
        return tuple(values) if issubclass(origin, tuple) else values
    if origin is float:
        return math.nan if value is None else number(value, what, -_FARTHEST, _FARTHEST)
    if type(value) is not origin:
        raise UnfitValue(f"{what} = {brief(value)}", f"a value of kind {origin.__name__}")
    return value


def _typed_array(kind: Any, value: Any, what: str) -> Array:
    try:
        if isinstance(value, dict):
            return np.empty([whole(length, what, 0, _MOST_LISTS) for length in value["shape"]], kind)
        return np.array(items(value, what, _LARGEST), kind)
    except (KeyError, TypeError, ValueError, OverflowError, MemoryError) as error:
        raise UnfitValue(f"{what} that is no array ({brief(error)})", "numbers") from error
