"""Scene files that lie in the repository play as when they were written, so that the format changes only on purpose."""

from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import read_scene, write_scene

FOLDER = Path(__file__).parents[1] / "fixtures" / "scenes"
SCENES = sorted(path.stem for path in FOLDER.glob("*.frog"))
TIMES = (0.0, 0.3, 1.0)
EVERY = 10
"""Of the Gaussians that a scene plays, one of so many is kept."""


def played(scene: ScenePlayer, name: str) -> dict[str, np.ndarray]:
    """What is kept of a scene, by name."""
    kept = {
        f"{name}/{time}/{attribute}": values[::EVERY]
        for time in TIMES
        for attribute, values in scene.at(time).arrays.items()
    }
    rgb = draw(scene.at(0.3), scene.header.cameras[0], scene.header.background).rgb
    return kept | {f"{name}/brightness": rgb.mean()}


def assert_plays_as_then(scene: ScenePlayer, name: str, tolerance: float) -> None:
    """Rounding of processors is allowed for."""
    with np.load(FOLDER / "expected.npz") as then:
        for key, values in played(scene, name).items():
            np.testing.assert_allclose(values, then[key], rtol=tolerance, atol=tolerance, err_msg=key)


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_plays_as_it_did(name: str) -> None:
    assert_plays_as_then(ScenePlayer.load(FOLDER / f"{name}.frog"), name, 1e-5)


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_written_again(tmp_path: Path, name: str) -> None:
    scene = read_scene(FOLDER / f"{name}.frog")
    write_scene(tmp_path / "whole.frog", scene)
    whole = read_scene(tmp_path / "whole.frog")
    assert whole.header.to_json() == scene.header.to_json() and whole.arrays.keys() == scene.arrays.keys()
    for array in scene.arrays:
        np.testing.assert_array_equal(whole.arrays[array], scene.arrays[array])
    write_scene(tmp_path / "packed.frog", scene, compact=True)
    assert (tmp_path / "packed.frog").stat().st_size < (tmp_path / "whole.frog").stat().st_size
    assert_plays_as_then(ScenePlayer.load(tmp_path / "packed.frog"), name, 0.02)


if __name__ == "__main__":
    actual = [played(ScenePlayer.load(FOLDER / f"{name}.frog"), name) for name in SCENES]
    np.savez_compressed(FOLDER / "expected.npz", **{key: values for kept in actual for key, values in kept.items()})
