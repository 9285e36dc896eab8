"""What a user is told without anything being wrong. Python's warnings carry it: each sentence is said once."""

from __future__ import annotations

import sys
import warnings
from typing import TextIO

_USUAL = warnings.showwarning
_left_to_blender = False


class Notice(UserWarning):
    """A sentence for the user."""


def say(sentence: str) -> None:
    """Tells the user, once, unless Blender does."""
    if not _left_to_blender:
        warnings.warn(sentence, Notice, stacklevel=3)  # the caller's caller


def leave_to_blender(left: bool) -> None:
    """While the add-on is enabled its renders report to Blender what they find, which would be said twice."""
    global _left_to_blender
    _left_to_blender = left


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
