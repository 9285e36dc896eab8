"""What splats by the graphics card cost the processor: the add-on's own work for a frame, and sorting in its thread.

    blender -b --factory-startup --python benchmarks/viewport.py        (5.2 and later)

Random scenes of which 15 % move, at times that nothing remembers, from another side each frame. A JSON line
for each number of splats has milliseconds, medians:
``deformation`` in the playback's thread, ahead of the frame; ``order`` in the sorter's thread from AT_ONCE splats on;
``upload`` what changes with time, and ``order's upload``, by Blender's gpu module; ``draw`` gives the card its work,
which software OpenGL partly does in the same call. Bytes are of the textures that a frame makes.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import gpu
import numpy as np
from support.builders import scene_file

from frog_blender.cameras import pose_of, view_camera
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.timeline.playback_cache import SceneTime
from frog_blender.viewport.card import Canvas, GraphicsCard, Layer
from frog_blender.viewport.clouds import Cloud, moving_textures, texels_of
from frog_blender.viewport.order import AT_ONCE, OrderRequest, Part
from frog_blender.viewport.projection import view_of

FRAMES = 15
MOVING = 0.15
WIDTH, HEIGHT = 960, 540


class Stopwatch:
    """Milliseconds by what they were spent on."""

    def __init__(self) -> None:
        self.spent: dict[str, list[float]] = defaultdict(list)
        self.since = time.perf_counter()

    def note(self, name: str) -> None:
        now = time.perf_counter()
        self.spent[name].append(1000.0 * (now - self.since))
        self.since = time.perf_counter()

    def medians(self) -> dict[str, float]:
        return {name: round(statistics.median(spent), 2) for name, spent in self.spent.items()}


def frames(count: int, card: GraphicsCard) -> dict[str, Any]:
    """What a frame of a scene of so many Gaussians costs."""
    scene = scene_file(count, moving=round(MOVING * count))
    scene.arrays["log_scales"] = scene.arrays["log_scales"] - np.float32(4.0)  # or software OpenGL draws for minutes
    player = ScenePlayer(scene)
    camera = scene.header.cameras[0].resized(WIDTH, HEIGHT)
    k, window = camera.intrinsics, np.zeros((4, 4))
    window[0, 0], window[1, 1] = 2 * k[0, 0] / WIDTH, 2 * k[1, 1] / HEIGHT
    window[2, 2], window[2, 3], window[3, 2] = -1.001, -0.1, -1
    cloud, canvas, watch, sent = Cloud(player, card), Canvas((WIDTH, HEIGHT)), Stopwatch(), 0
    for number in range(-2, FRAMES):  # two to warm up
        if number == 0:
            watch = Stopwatch()
        shown = SceneTime(player, 0.6180339887498949 * (number + 3) % 1.0)
        turned = np.linalg.inv(pose_of(camera)).copy()
        turned[:3, :3] = turned[:3, :3] @ np.diag([1.0, 1.0, 1.0 + 1e-3 * number])
        watch.since = time.perf_counter()
        part = shown.part()
        watch.note("deformation")
        view = view_of(view_camera(turned, window, WIDTH, HEIGHT), np.eye(4), turned, window)
        means = player.column("means", part)
        watch.note("view and places")
        order = OrderRequest("benchmark", number, (Part(means, view.plane, 0),)).sort()
        watch.note("order")
        textures = cloud.at(shown)
        watch.note("upload")
        order_texture = card.texture(texels_of(order.numbers, 1))
        watch.note("order's upload")
        card.draw(
            canvas, [Layer(textures, view, player.count, 0, player.header.low_pass)], order_texture, len(order.numbers)
        )
        watch.note("draw")
        canvas.textures[0].read()  # until the card has done it
        sent = order.numbers.nbytes + sum(each.values.nbytes for each in moving_textures(player, part).values())
    found = watch.medians()
    main = ["view and places", "upload", "order's upload", *(["order"] if count <= AT_ONCE else [])]
    return found | {"main thread but for drawing": round(sum(found[name] for name in main), 2), "bytes": sent}


def main() -> None:
    gpu.init()
    card = GraphicsCard()
    for count in (40_000, 200_000, 1_000_000):
        print(json.dumps({"splats": count, **frames(count, card)}))


main()
