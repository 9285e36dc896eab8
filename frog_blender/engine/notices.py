"""What a user is told without anything being wrong. Python's warnings carry it: each sentence is said once."""

import warnings
from typing import Any

_USUAL = warnings.formatwarning


class Notice(UserWarning):
    """A sentence for the user."""


def say(sentence: str) -> None:
    """Tells the user, once; "" is nothing to tell."""
    if sentence:
        warnings.warn(sentence, Notice, stacklevel=3)  # the caller's caller


def as_sentences() -> None:
    """From now on notices are printed to standard error as plain sentences, without file and line."""
    warnings.formatwarning = _formatted


def _formatted(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> str:
    """A notice on a line of its own, even if a progress bar has this one."""
    return f"\nwarning: {message}\n" if issubclass(category, Notice) else _USUAL(message, category, *where, **more)
