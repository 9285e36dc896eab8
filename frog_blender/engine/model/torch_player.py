"""A finished scene played and drawn by torch, on a GPU: the network in half precision where that is harmless.

Blender plays without torch (engine/playback); this is for images by the hundred (``frog render --device cuda``).
"""

from __future__ import annotations

import copy
import math

import numpy as np
import torch

from ..arrays import Array
from ..capture.camera import Camera
from ..capture.time import frame_to_time
from ..errors import FrogError
from ..field.names import FIELD_METHODS
from ..gaussians import TorchGaussians
from ..rasterizer import rasterize
from ..scene.scene_file import VISIBILITY, SceneFile
from .canonical import ATTRIBUTES, CanonicalField
from .frog import Frog, FrogSettings
from .interface import ScheduleState

HALF_TOLERANCE = 1e-3
"""What half precision may change: of means in motion units, of logarithms of scales, of opacities and colours."""
_TRIAL_TIMES = (0.0, 0.31, 0.69, 1.0)


class TorchScenePlayer:
    """Like ScenePlayer, with tensors on ``device``.

    Args:
        scene: what a ``.frog`` holds, of FRoG or E-D3DGS.
        device: of torch.
        half: None for half precision on a GPU, where it changes nothing beyond HALF_TOLERANCE.

    Attributes:
        header: the scene's.
        model: what is played, in half precision if ``half``.
        half: whether the network runs in half precision.

    Raises:
        FrogError: for a scene of another method, or one whose arrays are not what its settings say.
    """

    def __init__(self, scene: SceneFile, device: torch.device | str, half: bool | None = None) -> None:
        if scene.header.method not in FIELD_METHODS:
            raise FrogError(f"Found a scene of the method {scene.header.method!r}, expected FRoG or E-D3DGS on a GPU.")
        self.header = scene.header
        self.model = model_of(scene).to(device)
        if half is None and torch.device(device).type != "cpu":
            half = half_error(self.model) <= HALF_TOLERANCE
        self.half = bool(half)
        if self.half:
            self.model = _halved(self.model)

    def at_frame(self, frame: float) -> TorchGaussians:
        """As ScenePlayer.at_frame; quaternions of any length."""
        return self.at(frame_to_time(frame, self.header.frame_count))

    @torch.inference_mode()
    def at(self, time: float) -> TorchGaussians:
        """Gaussians at a time in [0, 1] (clamped), activated; quaternions of any length."""
        time = min(max(float(time), 0.0), 1.0)
        return _gaussians(self.model, time)

    @torch.inference_mode()
    def render_image(self, frame: float, camera: Camera) -> Array:
        """(H, W, 3) float32, display-referred, over the scene's background."""
        return rasterize(self.at_frame(frame), camera, self.header.background).rgb.cpu().numpy()


def half_error(model: Frog) -> float:
    """The largest change that half precision makes at a few times, see HALF_TOLERANCE; infinite when it overflows."""
    halved, unit, worst = _halved(model), model.settings.motion_unit, 0.0
    for time in _TRIAL_TIMES:
        one, other = _gaussians(model, time), _gaussians(halved, time)
        differences = [(one.means - other.means) / unit, one.scales.log() - other.scales.log()]
        differences += [one.opacities - other.opacities, one.sh - other.sh]
        worst = max(worst, *(float(difference.abs().nan_to_num(nan=math.inf).max()) for difference in differences))
    return worst


@torch.inference_mode()
def _gaussians(model: Frog, time: float) -> TorchGaussians:
    s = model.settings
    rows = s.temporal_rows - s.coarse_rows
    fine = ((s.fine_rows or s.temporal_rows) - s.coarse_rows) / rows if rows else 1.0
    schedule_state = ScheduleState(fine, s.opacity_share)
    temporal = model.temporal_embedding(time, schedule_state)
    return model.deform_reference(temporal, schedule_state, model.canonical.sh.shape[1])[0]


def model_of(scene: SceneFile) -> Frog:
    """The model as training had it, on the CPU and without gradients; FrogError when the file does not hold one."""
    learned = {name: array for name, array in scene.arrays.items() if name != VISIBILITY}
    values = {name: torch.from_numpy(np.array(array, np.float32)) for name, array in learned.items()}
    state = {
        f"canonical.{name}" if name in ATTRIBUTES else name.replace("network.", "deformation."): value
        for name, value in values.items()
    }
    try:
        model = Frog(CanonicalField(values), FrogSettings(**scene.header.model))
        model.load_state_dict(state)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise FrogError(f"The scene cannot be played by torch ({str(error).splitlines()[0]}); use the CPU.") from error
    return model.requires_grad_(False)


def _halved(model: Frog) -> Frog:
    """A copy whose network and embeddings are in half precision."""
    halved = copy.deepcopy(model)
    halved.deformation.half()
    halved.canonical.embeddings.data = halved.canonical.embeddings.data.half()
    return halved
