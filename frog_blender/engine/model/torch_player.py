"""A finished scene played and drawn by torch, on a GPU.

Blender plays without torch (engine/playback); this is for images by the hundred (``frog render --device cuda``).
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import torch

from ..arrays import Array, SceneArrays
from ..capture.camera import Camera
from ..capture.time import frame_to_time
from ..errors import FrogError
from ..field.names import FIELD_METHODS
from ..gaussians import TorchGaussians
from ..rasterizer import rasterize
from ..scene.scene_file import SceneFile
from .canonical import ATTRIBUTES, CanonicalField
from .deformation import FrogSettings
from .frog import Frog
from .interface import SceneModel, ScheduleState

Model = TypeVar("Model", bound=SceneModel)


class TorchScenePlayer:
    """Like ScenePlayer, with tensors on ``device``.

    Args:
        scene: what a ``.frog`` holds, of FRoG or E-D3DGS.
        device: of torch.

    Attributes:
        header: the scene's.
        model: what is played.

    Raises:
        FrogError: for a scene of another method, or one whose arrays are not what its settings say.
    """

    def __init__(self, scene: SceneFile, device: torch.device | str) -> None:
        if scene.header.method not in FIELD_METHODS:
            raise FrogError(f"Found a scene of the method {scene.header.method!r}, expected FRoG or E-D3DGS on a GPU.")
        self.header = scene.header
        self.model = model_of(scene).to(device)
        self.model.canonical.low_pass = scene.header.low_pass
        s = self.model.settings
        rows = s.temporal_rows - s.coarse_rows
        fine = ((s.fine_rows or s.temporal_rows) - s.coarse_rows) / rows if rows else 1.0
        self._schedule_state = ScheduleState(fine, s.opacity_share)

    @torch.inference_mode()
    def at_frame(self, frame: float) -> TorchGaussians:
        """As ScenePlayer.at_frame; quaternions of any length."""
        time = min(max(frame_to_time(frame, self.header.frame_count), 0.0), 1.0)
        temporal = self.model.temporal_embedding(time, self._schedule_state)
        return self.model.deform_reference(temporal, self._schedule_state)[0]

    @torch.inference_mode()
    def render_image(self, frame: float, camera: Camera) -> Array:
        """(H, W, 3) float32, display-referred, over the scene's background."""
        return rasterize(self.at_frame(frame), camera, self.header.background).rgb.cpu().numpy()


def model_of(scene: SceneFile) -> Frog:
    """The model as training had it; FrogError when the file does not hold one."""
    try:
        return restored(lambda canonical: Frog(canonical, FrogSettings(**scene.header.model)), scene.arrays)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise FrogError(f"The scene cannot be played by torch ({str(error).splitlines()[0]}); use the CPU.") from error


def restored(build: Callable[[CanonicalField], Model], arrays: SceneArrays) -> Model:
    """A finished scene's model, on the CPU and without gradients.

    Args:
        build: makes a model of its canonical Gaussians, with any parameters.
        arrays: the scene file's; what is not the model's is left out.

    Raises:
        KeyError, RuntimeError: an array is missing, or has another shape than the model's.
    """
    values = {name: torch.from_numpy(np.array(array, np.float32)) for name, array in arrays.items()}
    state = {
        f"canonical.{name}" if name in ATTRIBUTES else name.replace("network.", "deformation."): value
        for name, value in values.items()
    }
    model = build(CanonicalField(values))
    if missing := model.load_state_dict(state, strict=False, assign=True).missing_keys:
        raise KeyError(missing[0])
    return model.requires_grad_(False)
