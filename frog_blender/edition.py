"""Which edition of the add-on this is: one that trains, or the player, from which the rooms that train are left out."""

from __future__ import annotations

from importlib.util import find_spec

TRAINS = find_spec(f"{__package__}.training_task") is not None
"""Whether captures can be trained, and cameras be calibrated, with this build."""
