"""Scenes of segments played and drawn by torch: each segment as a scene of its own."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch

from ..arrays import Array
from ..capture.camera import Camera
from ..capture.time import time_to_frame
from ..gaussians import GaussianArrays, TorchGaussians
from ..rasterizer import rasterize
from ..scene.scene_file import SceneFile
from ..scene.segment_parts import part_of
from ..scene.segments import seen_at, segments_of, share_of
from .canonical import ATTRIBUTES, CanonicalField
from .torch_player import TorchScenePlayer

_PARTS_KEPT = 4


class _StillPlayer:
    """A segment in which nothing moves."""

    def __init__(self, scene: SceneFile, device: torch.device | str) -> None:
        values = {name: torch.from_numpy(np.array(scene.arrays[name])) for name in ATTRIBUTES if name in scene.arrays}
        field = CanonicalField(values | {"embeddings": torch.empty(0, 1)}).to(device).requires_grad_(False)
        self._gaussians = field.gaussians()

    def at(self, time: float) -> TorchGaussians:
        return self._gaussians


class SegmentedTorchPlayer:
    """Like TorchScenePlayer, of a scene of segments; a frame has the Gaussians that are there in its segment alone.

    Args:
        scene: what a ``.frog`` holds.
        device: of torch.
        half: see TorchScenePlayer.

    Attributes:
        header: the scene's.

    Raises:
        FrogError: a segment's arrays are not what its settings say.
    """

    def __init__(self, scene: SceneFile, device: torch.device | str, half: bool | None = None) -> None:
        self.header, self._segments = scene.header, segments_of(scene.header.model)

        def part(number: int) -> TorchScenePlayer | _StillPlayer:
            taken = part_of(scene, number)
            return TorchScenePlayer(taken, device, half) if taken.header.model else _StillPlayer(taken, device)

        self._part = lru_cache(_PARTS_KEPT)(part)

    @torch.inference_mode()
    def at_frame(self, frame: float) -> TorchGaussians:
        """As ScenePlayer.at_frame, without those that are unseen; quaternions of any length."""
        shared, found = None, list[TorchGaussians]()
        for number, share in seen_at(self._segments, frame).items():
            segment = self._segments[number]
            drawn, own = self._part(number).at(segment.time_of(frame)), segment.deformed + segment.still
            shared = shared or GaussianArrays(*(values[own:] for values in vars(drawn).values()))
            part = GaussianArrays(*(values[:own] for values in vars(drawn).values()))
            found.append(replace(part, opacities=share_of(part.opacities, share)))
        assert shared is not None
        parts = [vars(part).values() for part in (*found, shared)]
        return GaussianArrays(*(torch.cat(values) for values in zip(*parts, strict=True)))

    def at(self, time: float) -> TorchGaussians:
        """Gaussians at a time in [0, 1] (clamped), activated; quaternions of any length."""
        return self.at_frame(time_to_frame(min(max(float(time), 0.0), 1.0), self.header.frame_count))

    @torch.inference_mode()
    def render_image(self, frame: float, camera: Camera) -> Array:
        """(H, W, 3) float32, display-referred, over the scene's background."""
        return rasterize(self.at_frame(frame), camera, self.header.background).rgb.cpu().numpy()


def torch_player(scene: SceneFile, device: torch.device | str) -> TorchScenePlayer | SegmentedTorchPlayer:
    """What plays a scene by torch; FrogError where it cannot be played so."""
    is_whole = not segments_of(scene.header.model)
    return TorchScenePlayer(scene, device) if is_whole else SegmentedTorchPlayer(scene, device)
