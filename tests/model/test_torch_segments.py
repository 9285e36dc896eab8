"""A scene of segments drawn by torch is the one that is drawn without it."""

from __future__ import annotations

import numpy as np
import pytest
from support import segmented

from frog_blender.engine.errors import FrogError
from frog_blender.engine.model.torch_segments import SegmentedTorchPlayer, torch_player
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import SceneFile


def test_every_segment_is_drawn_as_without_torch() -> None:
    scene = segmented.joined()
    on_device, played = torch_player(scene, "cpu"), ScenePlayer(scene)
    assert isinstance(on_device, SegmentedTorchPlayer)
    camera = scene.header.cameras[0]
    for frame in (0, 4.4, 4.6, 5, 9, 10.7, 11, 14, 20):
        expected = draw(played.at_frame(frame), camera, scene.header.background).rgb
        np.testing.assert_allclose(on_device.render_image(frame, camera), expected, atol=1e-5)
        assert len(on_device.at_frame(frame)) < played.count


def test_other_scenes_are_played_as_before() -> None:
    assert not isinstance(torch_player(segmented.trained_segment(1, 20, 7, 7), "cpu"), SegmentedTorchPlayer)


def test_a_segment_that_cannot_be_played_is_refused() -> None:
    scene = segmented.joined()
    arrays = {name: array for name, array in scene.arrays.items() if name != "network.1.bias"}
    player = torch_player(SceneFile(scene.header, arrays), "cpu")
    with pytest.raises(FrogError, match="use the CPU"):
        player.at_frame(7)
