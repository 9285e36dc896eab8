"""A finished scene played by torch, as training sees it: what the native library's playback is held to."""

import torch

from frog_blender.engine.capture.time import frame_to_time
from frog_blender.engine.gaussians import TorchGaussians
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.frog import Frog
from frog_blender.engine.model.interface import ScheduleState, restored
from frog_blender.engine.scene.scene_file import SceneFile


class TorchScenePlayer:
    """Like ScenePlayer, of FRoG or E-D3DGS, with tensors."""

    def __init__(self, scene: SceneFile) -> None:
        self._frames = scene.header.frame_count
        self.model = restored(lambda canonical: Frog(canonical, FrogSettings(**scene.header.model)), scene.arrays)
        self.model.canonical.low_pass = scene.header.low_pass
        s = self.model.settings
        rows = s.temporal_rows - s.coarse_rows
        fine = ((s.fine_rows or s.temporal_rows) - s.coarse_rows) / rows if rows else 1.0
        self._schedule_state = ScheduleState(fine, s.opacity_share)

    @torch.inference_mode()
    def at_frame(self, frame: float) -> TorchGaussians:
        """As ScenePlayer.at_frame; quaternions of any length."""
        time = min(max(frame_to_time(frame, self._frames), 0.0), 1.0)
        temporal = self.model.temporal_embedding(time, self._schedule_state)
        return self.model.deform_reference(temporal, self._schedule_state)[0]
