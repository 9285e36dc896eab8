"""What the commands print: nothing that a file says commands the terminal."""

from __future__ import annotations

import sys

from ..engine.errors import printable


def say(text: object) -> None:
    """A line of a command's result."""
    print(printable(text))


def complain(text: object) -> None:
    """A line about what went wrong, which is no result."""
    print(f"frog: {printable(text)}", file=sys.stderr)
