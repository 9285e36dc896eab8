"""Scenes: everything that is done with a ``.frog`` outside of Blender: told, played, drawn, exported, rendered."""

import contextlib
import io
import shutil
from pathlib import Path

import numpy as np

from frog_blender.cameras import lens_of, pose_of
from frog_blender.cli.main import main
from frog_blender.engine.errors import printable
from frog_blender.engine.interchange.frame_files import export_frames
from frog_blender.engine.playback.importance import most_important, ranking
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.playback.render_files import camera_at, render_views
from frog_blender.engine.playback.views import View
from frog_blender.engine.source_media.clips import camera_path, capture_folders, find_clips
from fuzzing.scenes import kinds, whole_files
from fuzzing.worker import Kind

_LARGEST = 2**20  # pixels of images that are drawn with all that there is to know; `frog render` draws larger ones


class Scenes(Kind):
    """Scenes of every kind, lossless and packed."""

    seconds = 60
    warnings = "ignore"

    def __init__(self, folder: Path) -> None:
        self._out = folder / "out"
        self.keep(folder / "x.frog", *whole_files(kinds()))

    def use(self) -> bool:
        told = _tell(self.path)
        try:
            scene = ScenePlayer.load(self.path)
            _play(scene)
            _draw(scene)
            _look_for_clips(scene, self.path)
            list(export_frames(scene, [0, scene.header.frame_count - 1], self._out / "x.ply"))
            _render(self.path, scene, self._out)
        finally:
            shutil.rmtree(self._out, ignore_errors=True)
        assert told, "what plays can be told"
        return True


def _tell(path: Path) -> bool:
    """``frog info``; True if it did."""
    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(io.StringIO()) as complaint:
        status = main(["info", str(path)])
    for line in [*said.getvalue().split("\n"), *complaint.getvalue().split("\n")]:
        assert line == printable(line), line
    assert status == 0 or complaint.getvalue().count("\n") == 1, complaint.getvalue()
    return status == 0


def _play(scene: ScenePlayer) -> None:
    for time in (0.0, 0.3, 1.0):
        scene.at(time, scene.delta_at(time))
    scene.at(0.7)
    order = ranking(scene)
    some = scene.subset(most_important(order, scene.count // 2))
    some.at(0.5, some.delta_at(0.5))
    assert sorted(order.tolist()) == list(range(scene.count))


def _draw(scene: ScenePlayer) -> None:
    for camera in scene.header.cameras[:2]:
        lens_of(camera), pose_of(camera)
        if camera.width * camera.height <= _LARGEST:
            drawing = draw(scene.at_frame(1.5), camera, scene.header.background)
            assert drawing.rgb.shape == (camera.height, camera.width, 3)
            assert not np.isnan(drawing.alpha).any()


def _look_for_clips(scene: ScenePlayer, path: Path) -> None:
    for folder in capture_folders(scene.header, path):
        find_clips(scene.header, folder)
    if scene.header.cameras and scene.header.is_moving:
        camera_path(scene.header)


def _render(path: Path, scene: ScenePlayer, out: Path) -> None:
    header = scene.header
    if header.cameras:
        name = "moving" if header.is_moving else header.cameras[0].name
        last = header.frame_count - 1
        list(render_views(scene, [View(last, last, camera_at(header, name)(last))], out))


KINDS: dict[str, type[Kind]] = {"scenes": Scenes}
