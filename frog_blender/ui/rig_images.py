"""Each camera's first image on its frustum in the viewport, decoded in the background."""

from __future__ import annotations

import queue
import threading
from collections import OrderedDict
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from .. import addon_state, redrawing
from ..engine.capture.contact_sheet import first_shots, marked_image

if TYPE_CHECKING:
    from ..engine.capture.capture import Capture

LONGEST_SIDE = 128  # pixels
MOST = 48  # images; of more cameras, evenly spread ones
KEPT = 4
"""Captures whose images and drawn rigs are kept: windows may show several scenes at a time."""
OPACITY = 0.85
_TICK_SECONDS = 0.25
_CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))  # of an image, from its upper left one
_TRIANGLES = ((0, 1, 2), (0, 2, 3))


class RigImages:
    """The images of one capture's cameras.

    Attributes:
        drawn: a batch and a texture by camera; of the graphics card.
        found: camera and pixels of images that are not drawn yet.
        is_given_up: nobody shows them any more.
    """

    def __init__(self, capture: Capture) -> None:
        self.drawn: dict[int, tuple[Any, Any]] = {}
        self.found: queue.SimpleQueue[tuple[int, np.ndarray]] = queue.SimpleQueue()
        self.is_given_up = threading.Event()
        # A daemon, because Python joins other threads before it runs atexit.
        self.thread = threading.Thread(target=_decode, args=(self, capture), name="FRoG rig images", daemon=True)


class KeptImages:
    """The images of the captures that were drawn last, the last one at the end."""

    def __init__(self) -> None:
        self.of: OrderedDict[Capture, RigImages] = OrderedDict()


def images_of(capture: Capture) -> RigImages:
    """The images of a capture's cameras, which are decoded from the first call on."""
    kept = addon_state.get(KeptImages).of
    if capture not in kept:
        kept[capture] = RigImages(capture)
        kept[capture].thread.start()
        if not bpy.app.timers.is_registered(tick):
            bpy.app.timers.register(tick, first_interval=_TICK_SECONDS, persistent=True)
    kept.move_to_end(capture)
    _keep(KEPT)
    return kept[capture]


def forget() -> None:
    """Gives all images up."""
    _keep(0)


def _keep(most: int) -> None:
    kept = addon_state.get(KeptImages).of
    while len(kept) > most:
        kept.popitem(last=False)[1].is_given_up.set()


def tick() -> float | None:
    """What Blender's timer calls: shows what has been decoded. Returns the seconds until the next call."""
    every = addon_state.get(KeptImages).of.values()
    is_decoding = any(images.thread.is_alive() for images in every)
    if not all(images.found.empty() for images in every):
        redrawing.viewports()
    return _TICK_SECONDS if is_decoding else None


def draw(images: RigImages, corners: np.ndarray) -> None:
    """Draws the images that there are.

    Args:
        images: see ``images_of``.
        corners: (N, 4, 3) of the image planes of the capture's cameras, from the upper left one.
    """
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("IMAGE_COLOR")
    if not images.found.empty():  # while textures are made, what else is drawn into the viewport may be lost
        bpy.app.timers.register(redrawing.viewports, first_interval=0.0)
    while not images.found.empty():
        camera, pixels = images.found.get()
        shape = {"pos": corners[camera].astype(np.float32), "texCoord": np.array(_CORNERS, np.float32)}
        images.drawn[camera] = batch_for_shader(shader, "TRIS", shape, indices=_TRIANGLES), _texture(pixels)
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


def _decode(images: RigImages, capture: Capture) -> None:
    """Runs in the thread: the images, until they are given up; those that cannot be decoded are left out."""
    for shot in first_shots(capture, MOST):
        if images.is_given_up.is_set():
            return
        try:
            images.found.put((capture.shots[shot].camera, marked_image(capture, shot, LONGEST_SIDE)))
        except Exception:  # a training of it says why; the frustum is drawn without
            continue


def register() -> None:
    """There is nothing to register."""


def unregister() -> None:
    forget()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
