"""What people see of a training: previews, snapshots of its scene, and the image of its capacity."""

import time
from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.capture import Capture
from ...gaussians import TorchGaussians
from ...playback.player import ScenePlayer
from ...playback.render import to_uint8
from ...rasterizer import GaussianArrays, rasterize
from ...scene.scene_file import SceneFile
from ...spherical_harmonics import SH_DC
from ..compression.context import Compression
from . import events
from .events import Event
from .export import scene_as_it_stands
from .session import Session


def preview_shot(capture: Capture, camera: str | None = None) -> int | None:
    """The shot that previews show: the named camera's middle frame; by default the first held-out one.

    None for a name that no camera of the capture has.
    """
    if camera:
        shots = [i for i, shot in enumerate(capture.shots) if capture.cameras[shot.camera].name == camera]
        return shots[len(shots) // 2] if shots else None
    return next((i for i, shot in enumerate(capture.shots) if capture.is_test(shot)), 0)


class Previews:
    """Says when a preview is due, and renders it: at once, every ``job.preview_seconds``, and when another camera is
    asked for."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._last, self._camera = float("-inf"), self._wanted
        self._unknown: set[str] = set()

    @property
    def _wanted(self) -> str | None:
        chosen = self._session.cancel.preview_camera
        return self._session.job.preview_camera if chosen is None else chosen

    @property
    def due(self) -> bool:
        """True when one is to be rendered after this step."""
        waited = time.monotonic() - self._last
        return self._wanted != self._camera or waited >= self._session.job.preview_seconds

    def render(self) -> Iterator[Event]:
        """The preview; before it a warning, once, where the capture has no camera of the name that was asked for."""
        self._camera = self._wanted
        capture, trainer = self._session.capture, self._session.trainer
        shot = preview_shot(capture, self._camera)
        if shot is None:
            name = self._camera or ""
            if name not in self._unknown:
                self._unknown.add(name)
                yield events.WarningEvent(f"The capture has no camera {name!r}: previews show another one.")
            shot = preview_shot(capture) or 0
        yield events.Preview(trainer.step_count, to_uint8(trainer.render_image(shot, self._session.job.preview_size)))
        self._last = time.monotonic()


def snapshot(session: Session) -> ScenePlayer:
    """The scene as training stands, to be played by any thread while the training goes on."""
    scene = scene_as_it_stands(session)
    # On the CPU these are the parameters themselves, which the next step changes: the only copy is made here.
    own = session.trainer.device.type == "cpu"
    return ScenePlayer(SceneFile(scene.header, {k: v.copy() if own else v for k, v in scene.arrays.items()}))


# Apart for the colour-blind as well.
STATIC, DYNAMIC, REMOVED = (0.35, 0.60, 0.85), (1.00, 0.60, 0.05), (0.85, 0.10, 0.35)


@torch.no_grad()
def draw_report_image(context: Compression, shot_index: int) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 what a shot shows: blue is static, orange dynamic, red dots are pruned Gaussians.

    Brightness is the scene's own, so that things can be told.
    """
    capture = context.training.capture
    shot = capture.shots[shot_index]
    gaussians = context.gaussians_at(capture.time_of(shot))
    brightness = (gaussians.sh[:, 0].mean(1) * SH_DC + 0.5).clamp(0, 1)
    tints = torch.tensor(STATIC, device=brightness.device).repeat(len(brightness), 1)
    tints[: context.num_dynamic] = torch.tensor(DYNAMIC, device=brightness.device)
    colors = tints * (0.25 + 0.75 * brightness[:, None])
    everything = _with_removed(context.removed, gaussians, colors)
    image = rasterize(everything, capture.cameras[shot.camera], (0.0, 0.0, 0.0))
    return to_uint8(image.rgb.cpu().numpy())


def _with_removed(places: NDArray[np.float32], gaussians: TorchGaussians, colors: torch.Tensor) -> TorchGaussians:
    """The Gaussians in ``colors`` (N, 3), and small balls at ``places`` (n, 3)."""
    removed = torch.from_numpy(places).to(gaussians.means)
    count, size = len(removed), 0.3 * float(gaussians.scales.median())
    upright = torch.tensor([1.0, 0, 0, 0], device=removed.device).repeat(count, 1)
    colors = torch.cat([colors, torch.tensor(REMOVED, device=removed.device).repeat(count, 1)])
    return GaussianArrays(
        torch.cat([gaussians.means, removed]),
        torch.cat([gaussians.quaternions, upright]),
        torch.cat([gaussians.scales, torch.full((count, 3), size, device=removed.device)]),
        torch.cat([gaussians.opacities, torch.full((count,), 0.8, device=removed.device)]),
        ((colors - 0.5) / SH_DC)[:, None].contiguous(),
        low_pass=gaussians.low_pass,
    )
