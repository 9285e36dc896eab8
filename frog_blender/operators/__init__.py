"""What a user can do: one operator family per file."""

from __future__ import annotations

from . import cameras, compose, import_frog, install_torch, train

_FAMILIES = (import_frog, cameras, compose, train, install_torch)


def register() -> None:
    for family in _FAMILIES:
        family.register()


def unregister() -> None:
    for family in reversed(_FAMILIES):
        family.unregister()
