"""The one exception type for input that cannot be used."""

from __future__ import annotations

from pathlib import Path

_LONGEST = 700  # characters of a sentence; a damaged file may hold names of any length


class FrogError(Exception):
    """Something the user gave cannot be used, or something the user asked for cannot be done.

    The message is one sentence that says what was found, where, and what was expected, so that a
    command line or a panel can show it as it is. What goes on and on is cut in the middle.
    """

    def __init__(self, sentence: str) -> None:
        sentence = " ".join(sentence.splitlines())
        if len(sentence) > _LONGEST:
            half = _LONGEST // 2
            sentence = f"{sentence[:half]} ... {sentence[-half:]}"
        super().__init__(sentence)


def found_instead(path: str | Path, found: str, expected: str) -> FrogError:
    """The sentence most readers need: ``PATH: found X, expected Y.``"""
    return FrogError(f"{path}: found {found}, expected {expected}.")
