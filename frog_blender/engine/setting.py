"""What a setting or an option may be, declared where it is: its values are checked, read from text and written as text
in one place, wherever they come from."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from typing import Any, TypeAlias

from .errors import FrogError, brief
from .registry import Registry

Field: TypeAlias = Any  # what dataclasses.field gives stands for a value of the annotated type
Settings: TypeAlias = Any  # an instance of any dataclass, or one


class Kind:
    """What values a setting takes."""

    def accepts(self, value: object) -> bool:
        """Never raises, whatever the value is."""
        raise NotImplementedError

    def parse(self, text: str) -> object:
        """The value that a text stands for; ValueError, or a value that is not accepted, where it stands for none."""
        return text

    @property
    def expected(self) -> str:
        """In words, after "expected"."""
        raise NotImplementedError


@dataclass(frozen=True)
class Number(Kind):
    """A number from ``least`` to ``most``, or zero where ``or_zero`` says so; True and NaN are none."""

    least: float
    most: float
    whole: bool = False
    or_zero: bool = False

    def accepts(self, value: object) -> bool:
        types = int if self.whole else (int, float)
        if not isinstance(value, types) or isinstance(value, bool):
            return False
        return self.least <= value <= self.most or (self.or_zero and value == 0)

    def parse(self, text: str) -> float:
        return int(text) if self.whole else float(text)

    @property
    def expected(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        return f"{'0 or ' if self.or_zero else ''}{kind} from {_plain(self.least)} to {_plain(self.most)}"


@dataclass(frozen=True)
class Choice(Kind):
    """One of some values, of the very same type: 1 is not True.

    Attributes:
        known: the values, or what gives them where they may become more while the program runs.
    """

    known: tuple[object, ...] | Callable[[], tuple[object, ...]]

    @property
    def values(self) -> tuple[object, ...]:
        """What may be chosen now."""
        return self.known() if callable(self.known) else self.known

    def accepts(self, value: object) -> bool:
        return any(type(value) is type(known) and value == known for known in self.values)

    def parse(self, text: str) -> object:
        return next((known for known in self.values if text_of(known) == text), text)

    @property
    def expected(self) -> str:
        return f"one of {', '.join(text_of(known) for known in self.values)}"


@dataclass(frozen=True)
class Weights(Kind):
    """Names of a registry with a weight each, as "NAME:WEIGHT,NAME:WEIGHT"; "" for none."""

    known: Registry[Any]
    most: float

    def accepts(self, value: object) -> bool:
        try:
            weights = weights_of(value) if isinstance(value, str) and len(value) <= 1000 else None
        except ValueError:
            return False
        return weights is not None and all(
            name in self.known and 0 <= weight <= self.most for name, weight in weights.items()
        )

    @property
    def expected(self) -> str:
        return f"NAME:WEIGHT, with commas between several, of {', '.join(self.known)}, from 0 to {self.most:g}"


def weights_of(text: str) -> dict[str, float]:
    """Weights by name of what ``Weights`` accepts; ValueError for other text."""
    pairs = [part.split(":") for part in text.split(",") if part]
    return {name.strip(): float(weight) for name, weight in pairs}


@dataclass(frozen=True)
class Name(Kind):
    """A word or a few, for people."""

    longest: int = 100

    def accepts(self, value: object) -> bool:
        return isinstance(value, str) and len(value) <= self.longest and value.isprintable()

    @property
    def expected(self) -> str:
        return f"a name of at most {self.longest} characters"


@dataclass(frozen=True)
class Fractions(Kind):
    """A tuple of ``least`` to ``most`` ascending numbers in [0, 1]."""

    least: int
    most: int

    def accepts(self, value: object) -> bool:
        if not isinstance(value, tuple) or not self.least <= len(value) <= self.most:
            return False
        return all(Number(0, 1).accepts(fraction) for fraction in value) and list(value) == sorted(value)

    def parse(self, text: str) -> tuple[float, ...]:
        return tuple(float(part) for part in text.strip("[]() ").split(",") if part.strip())

    @property
    def expected(self) -> str:
        count = str(self.least) if self.least == self.most else f"{self.least} to {self.most}"
        return f"{count} ascending numbers from 0 to 1"


@dataclass(frozen=True)
class Fitting(Kind):
    """What a function says yes to, which itself never raises.

    Attributes:
        words: what that is, after "expected".
    """

    fits: Callable[[Any], bool]
    words: str

    def accepts(self, value: object) -> bool:
        return self.fits(value)

    @property
    def expected(self) -> str:
        return self.words


@dataclass(frozen=True)
class OrNone(Kind):
    """What ``kind`` takes, or None."""

    kind: Kind

    def accepts(self, value: object) -> bool:
        return value is None or self.kind.accepts(value)

    def parse(self, text: str) -> object:
        return None if text == text_of(None) else self.kind.parse(text)

    @property
    def expected(self) -> str:
        return f"none, or {self.kind.expected}"


@dataclass(frozen=True)
class Meaning:
    """What a field of a dataclass says of itself.

    Attributes:
        kind: what it may be.
        help: what it is, as part of a sentence.
        group: the heading that it and the fields after it stand under; empty where that goes on.
    """

    kind: Kind
    help: str
    group: str = ""


MEANING = "meaning"


def setting(default: object, kind: Kind, help: str, group: str = "") -> Field:
    """A dataclass field with that default, which says what it may be and what it is."""
    return field(default=default, metadata={MEANING: Meaning(kind, help, group)})


def number(default: float, least: float, most: float, help: str, *, or_zero: bool = False, group: str = "") -> Field:
    """A number in [least, most], or zero where ``or_zero`` says so."""
    return setting(default, Number(least, most, or_zero=or_zero), help, group)


def whole(default: int, least: int, most: int, help: str, *, group: str = "") -> Field:
    """A whole number in [least, most]."""
    return setting(default, Number(least, most, whole=True), help, group)


def choice(default: object, known: Sequence[object], help: str, *, group: str = "") -> Field:
    """One of the values ``known``."""
    return setting(default, Choice(tuple(known)), help, group)


def flag(default: bool, help: str) -> Field:
    """True or False."""
    return choice(default, (True, False), help)


def fractions(default: tuple[float, ...], least: int, most: int, help: str) -> Field:
    """A tuple of ``least`` to ``most`` ascending numbers in [0, 1]."""
    return setting(default, Fractions(least, most), help)


def meanings_of(settings: Settings) -> dict[str, Meaning]:
    """What each field of a dataclass, or an instance of it, says of itself; KeyError where one says nothing."""
    return {declared.name: declared.metadata[MEANING] for declared in fields(settings)}


def check_all(settings: Settings) -> None:
    """FrogError for the first field of a dataclass that is of another kind than it says, or out of range."""
    for name, meaning in meanings_of(settings).items():
        check(name, getattr(settings, name), meaning.kind)


def check(name: str, value: object, kind: Kind) -> None:
    """FrogError in a sentence for a value of another kind, or out of range."""
    if not kind.accepts(value):
        raise FrogError(f"{name} is {brief(repr(value))}, expected {kind.expected}.")


def parsed(name: str, text: str, kind: Kind) -> Any:
    """The value that a text stands for; FrogError in a sentence where it stands for none."""
    try:
        value = kind.parse(text)
    except ValueError:
        value = text
    check(name, value, kind)
    return value


def plain(value: Any) -> Any:
    """A value as settings keep it: Python's own numbers for numpy's, tuples for lists."""
    if isinstance(value, list | tuple):
        return tuple(plain(part) for part in value)
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    return value.item() if type(value).__module__ == "numpy" and getattr(value, "shape", None) == () else value


def text_of(value: object) -> str:
    """A value as ``Kind.parse`` reads it."""
    if isinstance(value, tuple):
        return ",".join(text_of(part) for part in value)
    if value is None or isinstance(value, bool):
        return str(value).lower()
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def nearest(name: str, known: Sequence[str]) -> str:
    """The end of a sentence about a name that does not exist: which of those that exist is most like it, if one is."""
    close = get_close_matches(name, known, 1)
    return f"; the nearest is {close[0]!r}." if close else "."


def _plain(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"
