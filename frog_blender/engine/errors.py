"""The one exception type for input that cannot be used."""

from __future__ import annotations

from pathlib import Path


class FrogError(Exception):
    """Something the user gave cannot be used, or something the user asked for cannot be done.

    The message is one sentence that says what was found, where, and what was expected, so that a
    command line or a panel can show it as it is.
    """


def found_instead(path: str | Path, found: str, expected: str) -> FrogError:
    """The sentence most readers need: ``PATH: found X, expected Y.``"""
    return FrogError(f"{path}: found {found}, expected {expected}.")
