"""Each camera's first image on its frustum in the viewport, decoded in the background."""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from .. import addon_state, redrawing
from ..engine.capture.contact_sheet import first_shots, marked_image
from ..engine.io.child_process import Stopped
from ..tasks.background_task import BackgroundTask

if TYPE_CHECKING:
    from ..engine.capture.capture import Capture

LONGEST_SIDE = 128  # pixels
MOST = 48  # images; of more cameras, evenly spread ones
KEPT = 4
"""Captures whose images and drawn rigs are kept: windows may show several scenes at a time."""
OPACITY = 0.85
_CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))  # of an image, from its upper left one
_TRIANGLES = ((0, 1, 2), (0, 2, 3))


class RigImages(BackgroundTask):
    """The images of one capture's cameras. Those that cannot be decoded are left out: a training says why.

    Attributes:
        drawn: a batch and a texture by camera; of the graphics card.
        waiting: camera and pixels of images that are not drawn yet.
    """

    what = "decoding of the rig's images"
    quit_seconds = 2.0

    def __init__(self, capture: Capture) -> None:
        super().__init__()
        self.capture, self.slot = capture, str(id(self))
        self.drawn: dict[int, tuple[Any, Any]] = {}
        self.waiting: list[tuple[int, np.ndarray]] = []

    def work(self) -> None:
        for shot in first_shots(self.capture, MOST):
            if self.stopped.is_set():
                raise Stopped
            try:
                image = marked_image(self.capture, shot, LONGEST_SIDE)
            except Exception:
                continue
            self.put((self.capture.shots[shot].camera, image))

    def take(self, message: tuple[int, np.ndarray]) -> None:
        self.waiting.append(message)

    def redraw(self) -> None:
        redrawing.viewports()


class KeptImages:
    """The images of the captures that were drawn last, the last one at the end."""

    def __init__(self) -> None:
        self.of: OrderedDict[Capture, RigImages] = OrderedDict()


def images_of(capture: Capture) -> RigImages:
    """The images of a capture's cameras, which are decoded from the first call on."""
    kept = addon_state.get(KeptImages).of
    if capture not in kept:
        kept[capture] = RigImages(capture).start().show()
    kept.move_to_end(capture)
    while len(kept) > KEPT:
        _, unseen = kept.popitem(last=False)
        unseen.cancel()
        unseen.forget(unseen.slot)
    return kept[capture]


def draw(images: RigImages, corners: np.ndarray) -> None:
    """Draws the images that there are.

    Args:
        images: see ``images_of``.
        corners: (N, 4, 3) of the image planes of the capture's cameras, from the upper left one.
    """
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("IMAGE_COLOR")
    if images.waiting:  # while textures are made, what else is drawn into the viewport may be lost
        bpy.app.timers.register(redrawing.viewports, first_interval=0.0)
    for camera, pixels in images.waiting:
        shape = {"pos": corners[camera].astype(np.float32), "texCoord": np.array(_CORNERS, np.float32)}
        images.drawn[camera] = batch_for_shader(shader, "TRIS", shape, indices=_TRIANGLES), _texture(pixels)
    images.waiting.clear()
    shader.bind()
    shader.uniform_float("color", (1.0, 1.0, 1.0, OPACITY))
    for batch, texture in images.drawn.values():
        shader.uniform_sampler("image", texture)
        batch.draw(shader)


def _texture(pixels: np.ndarray) -> Any:
    """(H, W, 3) uint8, display-referred, as a texture: Blender's own shaders expect such colours."""
    import gpu

    height, width = pixels.shape[:2]
    values = np.ones((height, width, 4), np.float32)
    values[..., :3] = pixels.astype(np.float32) / 255
    buffer = gpu.types.Buffer("FLOAT", values.size, values.ravel())
    return gpu.types.GPUTexture((width, height), format="RGBA8", data=buffer)
