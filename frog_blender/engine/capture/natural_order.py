"""The order of names that people mean: ``cam2`` before ``cam10``."""

import re

_DIGITS = re.compile(r"(\d+)")


def natural(name: str) -> tuple[tuple[int, str], ...]:
    """A key that sorts names by the numbers in them."""
    parts = _DIGITS.split(name)
    return tuple((int(part[:300]), "") if index % 2 else (0, part) for index, part in enumerate(parts))
