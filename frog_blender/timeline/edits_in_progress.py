"""Whether an operator is changing several edits, after which it refreshes once instead of at each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from .. import addon_state


class EditsInProgress:
    """Whether there are any."""

    def __init__(self) -> None:
        self.are_any = False


def are_any() -> bool:
    """Whether edits are being changed by who refreshes afterwards."""
    return addon_state.get(EditsInProgress).are_any


@contextmanager
def several() -> Iterator[None]:
    """Around changes of edits. The caller refreshes afterwards."""
    progress = addon_state.get(EditsInProgress)
    before, progress.are_any = progress.are_any, True
    try:
        yield
    finally:
        progress.are_any = before
