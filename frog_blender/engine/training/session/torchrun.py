"""What ``torchrun`` tells a process of its place among the others, read without torch."""

import os

from ...errors import FrogError


def started_by_torchrun() -> bool:
    """Whether this process is one of several; FrogError for an environment that makes no sense."""
    return bool(os.environ.get("RANK")) and number("WORLD_SIZE", 1) > 1


def number(name: str, usual: int) -> int:
    """A whole number of the environment, or ``usual`` where it has none; FrogError for anything else."""
    text = os.environ.get(name, "")
    if not text:
        return usual
    if not (text.isascii() and text.isdecimal() and len(text) <= 6):
        raise FrogError(f"The environment's {name} is {text[:40]!r}, expected a whole number as torchrun sets it.")
    return int(text)
