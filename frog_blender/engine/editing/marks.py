"""A mark on some of a scene's Gaussians, and which scene it was made for: one mark serves every time."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..io.unpacking import inflated
from ..playback.player import ScenePlayer

MOST = 1 << 28
"""Gaussians at most in a mark: 32 MB."""


@dataclass(frozen=True)
class Marks:
    """Some of the Gaussians of a scene file, whatever part of them is played.

    Attributes:
        count: Gaussians of that file.
        scene: ``ScenePlayer.identity`` of that file.
        bits: one for each Gaussian as ``numpy.packbits`` packs them.
    """

    count: int
    scene: str
    bits: bytes

    @classmethod
    def of(cls, scene: ScenePlayer, chosen: Array) -> Marks:
        """Marks of the Gaussians of a scene's file for which (N,) bool ``chosen`` holds."""
        if chosen.shape != (scene.file_count,):
            raise ValueError(f"chosen: shape {chosen.shape}, expected ({scene.file_count},)")
        return cls(scene.file_count, scene.identity, np.packbits(chosen.astype(bool)).tobytes())

    def fits(self, scene: ScenePlayer) -> bool:
        """Whether they were made for the file of this scene, of which any part may be played."""
        return self.count == scene.file_count and self.scene == scene.identity

    def chosen(self) -> Array:
        """(count,) bool."""
        return np.unpackbits(np.frombuffer(self.bits, np.uint8), count=self.count).astype(bool)

    def number(self) -> int:
        """How many Gaussians are marked."""
        return int(np.count_nonzero(self.chosen()))

    def to_text(self) -> str:
        """The bits as text: zlib and base64."""
        return base64.b64encode(zlib.compress(self.bits, 6)).decode("ascii")

    @classmethod
    def from_text(cls, count: int, scene: str, text: str) -> Marks:
        """What ``to_text`` gave. ValueError for anything else; no more memory is taken than ``count`` bits."""
        if not 0 < count <= MOST:
            raise ValueError(f"marks of {count} Gaussians")
        try:
            packed = base64.b64decode(text, validate=True)
        except ValueError as error:
            raise ValueError("marks that are damaged") from error
        return cls(count, scene, inflated(packed, -(-count // 8), f"a mark of {count:,} Gaussians"))
