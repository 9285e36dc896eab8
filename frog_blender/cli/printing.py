"""Output of the commands, without control characters: text from files must not control the terminal."""

from __future__ import annotations

import sys

from ..engine.errors import printable


def say(text: object) -> None:
    """Prints a line of a command's result."""
    print(printable(text))


def complain(text: object) -> None:
    """Prints a line about an error to standard error."""
    print(f"frog: {printable(text)}", file=sys.stderr)
