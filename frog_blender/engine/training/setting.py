"""What a setting may be, declared where it is: kind and range are checked in one place, wherever a value came from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Protocol, TypeAlias

from ..errors import FrogError, brief

_KIND = "kind"
Field: TypeAlias = Any  # what dataclasses.field gives stands for a value of the annotated type
Settings: TypeAlias = Any  # an instance of any dataclass, or one


class Kind(Protocol):
    """What values a setting takes."""

    def accepts(self, value: object) -> bool:
        """Never raises, whatever the value is."""
        ...

    @property
    def expected(self) -> str:
        """In words, after "expected"."""
        ...


@dataclass(frozen=True)
class Number:
    """A number from ``least`` to ``most``, or zero where ``or_zero`` says so; True and NaN are none."""

    least: float
    most: float
    whole: bool = False
    or_zero: bool = False

    def accepts(self, value: object) -> bool:
        kinds = int if self.whole else (int, float)
        if not isinstance(value, kinds) or isinstance(value, bool):
            return False
        return self.least <= value <= self.most or (self.or_zero and value == 0)

    @property
    def expected(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        return f"{'0 or ' if self.or_zero else ''}{kind} from {_plain(self.least)} to {_plain(self.most)}"


@dataclass(frozen=True)
class Choice:
    """One of some values, of the very same type: 1 is not True."""

    known: tuple[object, ...]

    def accepts(self, value: object) -> bool:
        return any(type(value) is type(known) and value == known for known in self.known)

    @property
    def expected(self) -> str:
        return f"one of {', '.join(str(known) for known in self.known)}"


@dataclass(frozen=True)
class Name:
    """A word or a few, for people."""

    longest: int = 100

    def accepts(self, value: object) -> bool:
        return isinstance(value, str) and len(value) <= self.longest and value.isprintable()

    @property
    def expected(self) -> str:
        return f"a name of at most {self.longest} characters"


@dataclass(frozen=True)
class Fractions:
    """A tuple of ``least`` to ``most`` ascending numbers in [0, 1]."""

    least: int
    most: int

    def accepts(self, value: object) -> bool:
        if not isinstance(value, tuple) or not self.least <= len(value) <= self.most:
            return False
        return all(Number(0, 1).accepts(each) for each in value) and list(value) == sorted(value)

    @property
    def expected(self) -> str:
        count = str(self.least) if self.least == self.most else f"{self.least} to {self.most}"
        return f"{count} ascending numbers from 0 to 1"


@dataclass(frozen=True)
class OrNone:
    """What ``kind`` takes, or None."""

    kind: Kind

    def accepts(self, value: object) -> bool:
        return value is None or self.kind.accepts(value)

    @property
    def expected(self) -> str:
        return f"none, or {self.kind.expected}"


def number(default: float, least: float, most: float, *, or_zero: bool = False) -> Field:
    """A dataclass field with that default: a number in [least, most], or zero where ``or_zero`` says so."""
    return _setting(default, Number(least, most, or_zero=or_zero))


def whole(default: int, least: int, most: int) -> Field:
    """A dataclass field: a whole number in [least, most]."""
    return _setting(default, Number(least, most, whole=True))


def choice(default: object, known: Sequence[object]) -> Field:
    """A dataclass field: one of the values ``known``."""
    return _setting(default, Choice(tuple(known)))


def flag(default: bool) -> Field:
    """A dataclass field: True or False."""
    return _setting(default, Choice((True, False)))


def name(default: str) -> Field:
    """A dataclass field: text of one line."""
    return _setting(default, Name())


def fractions(default: tuple[float, ...], least: int, most: int) -> Field:
    """A dataclass field: a tuple of ``least`` to ``most`` ascending numbers in [0, 1]."""
    return _setting(default, Fractions(least, most))


def kinds_of(settings: Settings) -> dict[str, Kind]:
    """What each field of a dataclass, or an instance of it, takes; KeyError where one does not say so."""
    return {each.name: each.metadata[_KIND] for each in fields(settings)}


def check(name: str, value: object, kind: Kind) -> None:
    """FrogError in a sentence for a value of another kind, or out of range."""
    if not kind.accepts(value):
        raise FrogError(f"{name} is {brief(repr(value))}, expected {kind.expected}.")


def check_all(settings: Settings) -> None:
    """FrogError for the first field of a dataclass that is of another kind than it says, or out of range."""
    for name, kind in kinds_of(settings).items():
        check(name, getattr(settings, name), kind)


def _setting(default: object, kind: Kind) -> Field:
    return field(default=default, metadata={_KIND: kind})


def _plain(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"
