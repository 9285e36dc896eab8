"""The one exception type for input that cannot be used."""

from __future__ import annotations

from pathlib import Path

_LONGEST = 300  # characters of what a damaged file says, which may be anything


class FrogError(Exception):
    """Something the user gave cannot be used, or something the user asked for cannot be done.

    The message is one sentence that says what was found, where, and what was expected, so that a
    command line or a panel can show it as it is.
    """


def found_instead(path: str | Path, found: str, expected: str) -> FrogError:
    """The sentence most readers need: ``PATH: found X, expected Y.``"""
    return FrogError(f"{path}: found {brief(found)}, expected {expected}.")


def brief(found: object) -> str:
    """What was found, on one line, cut where it goes on and on."""
    text = " ".join(str(found).splitlines())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
