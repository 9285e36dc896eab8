"""What a user is told without anything being wrong. Python's warnings carry it: each sentence is said once."""

from __future__ import annotations

import sys
import warnings
from typing import TextIO

_USUAL = warnings.showwarning


class Notice(UserWarning):
    """A sentence for the user."""


def say(sentence: str) -> None:
    """Tells the user, once; "" is nothing to tell."""
    if sentence:
        warnings.warn(sentence, Notice, stacklevel=3)  # the caller's caller


def as_sentences() -> None:
    """From now on notices are printed to standard error as plain sentences, without file and line."""
    warnings.showwarning = _show


def _show(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    if issubclass(category, Notice):
        print(f"\nwarning: {message}", file=sys.stderr)  # on a line of its own, even if a progress bar has this one
    else:
        _USUAL(message, category, filename, lineno, file, line)
