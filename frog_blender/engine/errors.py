"""The one exception type for input that cannot be used, and how text from files is shown."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

_LONGEST = 300  # characters of what a damaged file says, which may be anything

# What a terminal obeys, breaks a line at or writes backwards from, and halves of characters, which nothing can encode.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


class FrogError(Exception):
    """Something the user gave cannot be used, or something the user asked for cannot be done.

    The message is one sentence that says what was found, where, and what was expected, so that a
    command line or a panel can show it as it is: control characters in it are escaped.
    """

    def __init__(self, message: object = "") -> None:
        super().__init__(printable(message))


class UsageError(FrogError):
    """Something was asked for that does not exist, or not together: it has to be asked for otherwise."""


class CaptureRefused(FrogError):
    """A capture, or footage, cannot be used as it is: files are missing or damaged, or do not say enough."""


class GuestFailed(FrogError):
    """Code of a package that is not ours raised what is the cause of this."""


@contextmanager
def told_as(kind: type[FrogError]) -> Iterator[None]:
    """Inside the block, or the function that it decorates, a plain FrogError becomes one of that kind."""
    try:
        yield
    except FrogError as error:
        if type(error) is not FrogError or isinstance(error.__cause__, ImportError):
            raise
        raise kind(error) from error


def found_instead(path: str | Path, found: object, expected: str) -> FrogError:
    """The sentence most readers need: ``PATH: found X, expected Y.``"""
    return FrogError(f"{path}: found {brief(found)}, expected {expected}.")


@contextmanager
def in_words(
    failed: str, rest: str = ".", *, kinds: type[Exception] | tuple[type[Exception], ...] = OSError
) -> Iterator[None]:
    """Around what may fail: an error of these kinds becomes the FrogError ``FAILED (REASON)REST``."""
    try:
        yield
    except kinds as error:
        raise FrogError(f"{failed} ({getattr(error, 'strerror', None) or error}){rest}") from error


def named(kind: str, name: str, known: Mapping[str, T]) -> T:
    """What a name stands for; UsageError that lists the names there are for any other."""
    if name not in known:
        raise UsageError(f"There is no {kind} {brief(repr(name))}; there are {', '.join(known)}.")
    return known[name]


def brief(value: object) -> str:
    """What was found, on one line, cut where it goes on and on."""
    text = printable(" ".join(str(value).splitlines()))
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."


def listed(names: Sequence[object], most: int = 8) -> str:
    """Names in a sentence: the first of them, and how many more there are; "none" for none."""
    shown = [*map(str, names[:most]), *([f"{len(names) - most} more"] if len(names) > most else [])]
    return " and ".join(filter(None, [", ".join(shown[:-1]), *shown[-1:]])) or "none"


def how_it_ended(code: int) -> str:
    """What became of a process, by its exit status: "ended with status 1", "was ended by signal 9"."""
    return f"was ended by signal {-code}" if code < 0 else f"ended with status {code}"


def printable(text: object) -> str:
    """Text in which control characters are written out, as ``\\x1b``: what a file says must not command a terminal."""
    shown = str(text)
    return shown if shown.isprintable() else _CONTROLS.sub(lambda match: ascii(match[0])[1:-1], shown)


def reason(error: BaseException) -> str:
    """What an error says, on one line and without a full stop, to stand within a sentence."""
    return brief(str(error) or type(error).__name__).rstrip(".")
