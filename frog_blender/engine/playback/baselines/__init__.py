"""Playback of the baseline methods: one class a method, made of ``(arrays, model)``, with ``at(time)``."""

from __future__ import annotations

from .curves import PlayableCurves
from .d3dgs import PlayableD3dgs
from .hexplane import PlayableHexPlane

BASELINES: dict[str, type[PlayableD3dgs] | type[PlayableHexPlane] | type[PlayableCurves]] = {
    "d3dgs": PlayableD3dgs,
    "hexplane": PlayableHexPlane,
    "curves": PlayableCurves,
}
"""By the method's name in the scene file's header."""
