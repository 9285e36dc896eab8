"""Which edition of the add-on this is: one that trains, or the player, from which the rooms that train are left out."""

from importlib.util import find_spec

TRAINS = find_spec(f"{__package__}.tasks.training") is not None
"""Whether captures can be trained, and cameras be calibrated, with this build."""


def has(module: str) -> bool:
    """Whether this edition has a module of the add-on, such as "ui.train_panel"; the one that trains has them all."""
    if TRAINS:
        return True
    try:
        return find_spec(f"{__package__}.{module}") is not None
    except ModuleNotFoundError:  # not even the package that it would lie in
        return False
