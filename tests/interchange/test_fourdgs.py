"""``.4dgs``: what the format's own package reads is what playback plays, and anybody's file becomes a scene."""

from __future__ import annotations

import struct
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.foreign_takes import partly_static, sorted_like

from frog_blender.cli.main import main
from frog_blender.engine.capture.ffmpeg import program
from frog_blender.engine.errors import FrogError
from frog_blender.engine.interchange.fourdgs_export import write_fourdgs
from frog_blender.engine.interchange.fourdgs_source import open_fourdgs
from frog_blender.engine.interchange.imports import import_scene
from frog_blender.engine.interchange.take import SceneTake, Sound
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.source_media.film_sound import find_sound
from frog_blender.engine.source_media.sound import read_sound

fourdgs = pytest.importorskip("fourdgs", reason="needs the package fourdgs")
from fourdgs.keyframe_delta_file import decode_indexed, decode_streamed, render_at, write_sequence  # noqa: E402
from fourdgs.keyframe_delta_writer import Sample  # noqa: E402
from fourdgs.model import GaussianSet  # noqa: E402
from fourdgs.validate import validate  # noqa: E402


@pytest.fixture
def scene(tmp_path: Path) -> ScenePlayer:
    """Colours within what the format holds, so that what is lost is lost to quantization."""
    partly_static(tmp_path, sh_count=16)
    from frog_blender.engine.scene.scene_file import read_scene, write_scene

    found = read_scene(tmp_path / "x.frog")
    write_scene(tmp_path / "x.frog", replace(found, arrays=found.arrays | {"sh": found.arrays["sh"] * 0.3}))
    return ScenePlayer.load(tmp_path / "x.frog")


def written(scene: ScenePlayer, path: Path) -> bytes:
    assert list(write_fourdgs(path, SceneTake(scene, "x", range(7)))) == [*[0] * 7, *range(1, 8)]
    return path.read_bytes()


def test_its_own_validator_finds_nothing(scene: ScenePlayer, tmp_path: Path) -> None:
    report = validate(written(scene, tmp_path / "x.4dgs"))
    assert report.ok and not report.findings


def test_both_ways_of_reading_find_what_plays(scene: ScenePlayer, tmp_path: Path) -> None:
    content = written(scene, tmp_path / "x.4dgs")
    for decoded in (decode_streamed(content), decode_indexed(content)[0]):
        assert decoded.header.sh_degree == 3 and decoded.header.attributes["color_space"] == "srgb-rec709-display"
        for frame in range(7):
            found, expected = render_at(decoded, frame / 24 + 0.01), scene.at_frame(frame)
            np.testing.assert_array_equal(found["ids"], np.arange(40))
            size = np.median(expected.scales)
            np.testing.assert_allclose(found["centers"], expected.means, atol=0.05 * size)
            np.testing.assert_allclose(found["scales"], expected.scales, rtol=0.01)
            np.testing.assert_allclose(found["opacity"], expected.opacities, atol=1 / 255)


def test_resting_gaussians_cost_nothing(scene: ScenePlayer, tmp_path: Path) -> None:
    written(scene, tmp_path / "x.4dgs")
    chunks = decode_streamed((tmp_path / "x.4dgs").read_bytes()).chunks
    assert [chunk.kind for chunk in chunks] == [0, *[1] * 6]
    assert all(chunk.update_count <= 25 for chunk in chunks[1:])


def test_there_and_back_by_the_commands(scene: ScenePlayer, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.4dgs"
    assert main(["export", str(tmp_path / "x.frog"), "--4dgs", "--out", str(out)]) == 0
    assert main(["import", str(out), "--out", str(tmp_path / "back.frog")]) == 0
    assert "40 Gaussians, 7 frames" in capsys.readouterr().out
    back = ScenePlayer.load(tmp_path / "back.frog")
    assert (back.count, back.num_dynamic, back.header.frames_per_second) == (40, 25, 24)
    errors = []
    for frame in range(7):
        for camera in scene.header.cameras:
            images = [draw(each.at_frame(frame), camera, (0.1, 0.2, 0.3)).rgb for each in (scene, back)]
            errors.append(float(np.square(images[0] - images[1]).mean()))
    assert -10 * np.log10(np.mean(errors)) >= 40
    found = sorted_like(back.at_frame(3), scene.at_frame(0), back.at_frame(0))
    np.testing.assert_allclose(found.sh[:, 1:], scene.at_frame(3).sh[:, 1:], atol=0.02)
    for found_camera, camera in zip(back.header.cameras, scene.header.cameras, strict=True):
        assert found_camera.name.startswith(camera.name) and found_camera.width == camera.width
        np.testing.assert_allclose(found_camera.intrinsics, camera.intrinsics, atol=1e-9)
        np.testing.assert_allclose(found_camera.world_to_camera, camera.world_to_camera, atol=1e-9)


@pytest.fixture
def tone(tmp_path: Path) -> Path:
    """Two seconds of 440 Hz."""
    if program() is None:
        pytest.skip("needs ffmpeg")
    path = tmp_path / "tone.wav"
    command = [program(), "-v", "error", "-f", "lavfi", "-i", "sine=frequency=440:duration=2", str(path)]
    subprocess.run(command, check=True)
    return path


def test_sound_is_in_the_file(scene: ScenePlayer, tone: Path, tmp_path: Path) -> None:
    list(write_fourdgs(tmp_path / "x.4dgs", SceneTake(scene, "x", range(7), Sound(tone, 0.5))))
    content = (tmp_path / "x.4dgs").read_bytes()
    assert validate(content).ok and content.count(b"OpusHead") == 1
    with pytest.raises(FrogError, match="its sound could not be read"):
        list(write_fourdgs(tmp_path / "y.4dgs", SceneTake(scene, "x", range(7), Sound(tmp_path / "x.frog"))))
    assert not (tmp_path / "y.4dgs").exists()


@pytest.fixture
def ringing(scene: ScenePlayer, tone: Path, tmp_path: Path) -> Path:
    """A file with that tone."""
    list(write_fourdgs(tmp_path / "ringing.4dgs", SceneTake(scene, "x", range(7), Sound(tone, 0.0))))
    return tmp_path / "ringing.4dgs"


def test_sound_is_heard_after_an_import(ringing: Path, tmp_path: Path) -> None:
    target = tmp_path / "back.frog"
    assert "sound" not in import_scene(ringing, target).warning
    header = ScenePlayer.load(target).header
    found = find_sound(header, target)
    assert found is not None and found.path == tmp_path / "back.ogg" and found.start == 0
    heard = read_sound(found.path, 0.0, 0.2).values[:, 0].astype(np.float64)
    spectrum = np.abs(np.fft.rfft(heard * np.hanning(len(heard))))
    assert abs(np.argmax(spectrum) / 0.2 - 440) <= 5
    import_scene(ringing, target)  # once more: the same sound is no other one
    assert sorted(path.name for path in tmp_path.glob("back*")) == ["back.frog", "back.ogg"]


def test_a_file_that_is_there_stays(ringing: Path, tmp_path: Path) -> None:
    (tmp_path / "back.wav").write_bytes(b"somebody's")
    assert "back.wav is there already" in import_scene(ringing, tmp_path / "back.frog").warning
    assert (tmp_path / "back.wav").read_bytes() == b"somebody's" and not (tmp_path / "back.ogg").exists()


def of_unknown_form(content: bytes) -> bytes:
    return content.replace(b"OggS", b"Oops", 1)


def begun_later(content: bytes) -> bytes:
    place = content.index(b"stereo") + len(b"stereo") + 8  # after the length of what is heard
    return content[:place] + struct.pack("<d", 0.5) + content[place + 8 :]


@pytest.mark.parametrize(("changed", "said"), [(of_unknown_form, "is not known"), (begun_later, "begins 0.5 seconds")])
def test_sound_that_cannot_be_kept_is_told(ringing, tmp_path, changed, said) -> None:
    ringing.write_bytes(changed(ringing.read_bytes()))
    assert said in import_scene(ringing, tmp_path / "back.frog").warning
    assert not list(tmp_path.glob("back.[!f]*"))


def born(folder: Path) -> Path:
    """Another program's: two Gaussians, one born late and moving, one that lives in a window, with y up."""
    gaussians = GaussianSet(
        positions=np.array([[0, 1, 0], [3, 0, 0]], np.float32),
        scales=np.full((2, 3), 0.1, np.float32),
        rotations=np.tile(np.array([0, 0, 0, 1], np.float32), (2, 1)),
        colors=np.array([[1, 0, 0, 0.9], [0, 1, 0, 0.8]], np.float32),
        motions=np.array([[1, 0, 0], [0, 0, 0]], np.float32),
        mu_t=np.array([0.5, 0], np.float32),
        sigma_t=np.array([0.2, np.inf], np.float32),
        win_lo=np.array([0, 0], np.float64),
        win_hi=np.array([1, 0.5], np.float64),
    )
    options = fourdgs.WriteOptions(metadata={"coordinate_system": "y-up-right-handed"})
    fourdgs.write(str(folder / "born.4dgs"), gaussians, 1.0, options=options)
    return folder / "born.4dgs"


def test_gaussians_that_are_born_play(tmp_path: Path) -> None:
    imported = import_scene(born(tmp_path), tmp_path / "x.frog")
    assert (imported.gaussians, imported.frames, imported.keeps_identity) == (2, 30, True)
    back = ScenePlayer.load(imported.path)
    for frame, opacities in ((15, (0.9, 0)), (3, (0.9 * np.exp(-0.5 * 4), 0.8))):
        found = back.at_frame(frame)
        order = np.argsort(found.means[:, 0])
        np.testing.assert_allclose(found.opacities[order], opacities, atol=0.02)
        np.testing.assert_allclose(found.means[order[0]], [frame / 30 - 0.5, 0, 1], atol=0.02)  # z is up


def states_at(path: Path, times: list[float], duration: float, windows: list[float] | None = None) -> Path:
    """Two Gaussians at each of some times; where they are says which of them it is."""
    samples = []
    for number, time in enumerate(times):
        gaussians = GaussianSet(
            positions=np.array([[number, 0, 0], [number, 5, 0]], np.float32),
            scales=np.full((2, 3), 0.1, np.float32),
            rotations=np.tile(np.array([0, 0, 0, 1], np.float32), (2, 1)),
            colors=np.full((2, 4), 0.5, np.float32),
            motions=np.zeros((2, 3), np.float32),
            mu_t=np.full(2, time, np.float32),
            sigma_t=np.full(2, 1e6, np.float32),
            win_lo=np.zeros(2),
            win_hi=np.array(windows or [duration, duration], np.float64),
        )
        samples.append(Sample(time, np.arange(2), gaussians))
    path.write_bytes(write_sequence(samples, duration))
    return path


def numbers_of(path: Path) -> tuple[float, list[int]]:
    """Frames a second, and which state each frame shows."""
    source = open_fourdgs(path)
    return source.rate, [round(float(source.at(frame).means[0, 0])) for frame in range(source.frame_count)]


def test_rounded_times_are_a_frame_each(tmp_path: Path) -> None:
    times = [round(number / 30, 3) for number in range(60)]
    rate, shown = numbers_of(states_at(tmp_path / "x.4dgs", times, 2.0))
    assert rate == pytest.approx(30, rel=1e-3) and shown == list(range(60))
    left_out = [*range(20), *range(23, 50), *range(51, 60)]
    rate, shown = numbers_of(states_at(tmp_path / "x.4dgs", [times[each] for each in left_out], 2.0))
    assert rate == pytest.approx(30, rel=1e-3) and len(shown) == 60
    assert shown[18:26] == [18, 19, 19, 19, 19, 20, 21, 22]


def test_two_states_that_lie_close_are_no_rate(tmp_path: Path) -> None:
    times = sorted([*(number / 30 for number in range(30)), 0.501])
    rate, shown = numbers_of(states_at(tmp_path / "x.4dgs", times, 1.0))
    assert rate == 30 and shown == [*range(16), *range(17, 31)]  # what lies between two frames is in none


def test_states_far_apart_are_refused_rather_than_cut(tmp_path: Path) -> None:
    with pytest.raises(FrogError, match="for each of its 3 states"):
        open_fourdgs(states_at(tmp_path / "x.4dgs", [0.0, 0.01, 900.0], 901.0))
    path = states_at(tmp_path / "x.4dgs", [0.0, 10.0], 20.0)
    assert numbers_of(path) == (1, [*[0] * 10, *[1] * 10])
    long = fourdgs.WriteOptions()
    gaussians = fourdgs.read(born(tmp_path).read_bytes()).gaussians
    fourdgs.write(str(tmp_path / "long.4dgs"), gaussians, 50_000.0, options=long)
    with pytest.raises(FrogError, match="1,500,000 frames, expected at most"):
        open_fourdgs(tmp_path / "long.4dgs")


def test_windows_that_end_are_no_identity(tmp_path: Path) -> None:
    times = [0.0, 0.25, 0.5, 0.75]
    assert open_fourdgs(states_at(tmp_path / "x.4dgs", times, 1.0)).keeps_identity
    source = open_fourdgs(states_at(tmp_path / "x.4dgs", times, 1.0, [0.5, 1.0]))
    assert [len(source.at(frame)) for frame in range(4)] == [2, 2, 1, 1] and not source.keeps_identity


def test_files_that_cannot_be_used_are_one_sentence(scene: ScenePlayer, tmp_path: Path) -> None:
    content = written(scene, tmp_path / "x.4dgs")
    (tmp_path / "cut.4dgs").write_bytes(content[: len(content) // 2])
    (tmp_path / "none.4dgs").write_bytes(b"nothing of the kind")
    for name in ("cut", "none", "missing"):
        with pytest.raises(FrogError, match=rf"{name}\.4dgs: found"):
            import_scene(tmp_path / f"{name}.4dgs", tmp_path / "y.frog")
    assert not (tmp_path / "y.frog").exists()
    with pytest.raises(FrogError, match=r"expected \.4dgs"):
        list(write_fourdgs(tmp_path / "x.obj", SceneTake(scene, "x", range(7))))
