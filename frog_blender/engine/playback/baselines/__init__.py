"""Finished scenes of FRoG's rivals, played: a class for each method, ``(arrays, model)`` with ``at(time)``."""

from __future__ import annotations

from .curves import PlayableCurves
from .d3dgs import PlayableD3dgs
from .hexplane import PlayableHexPlane

BASELINES = {"d3dgs": PlayableD3dgs, "hexplane": PlayableHexPlane, "curves": PlayableCurves}
"""By the method's name in the scene file's header."""
