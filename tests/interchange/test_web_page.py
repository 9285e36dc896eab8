"""The web page of a scene: what is in it, unpacked here and by its own script, and what it must not hold."""

import json
import re
import shutil
import subprocess
import zlib
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import refused, scene_file
from support.clicks import clicks, times_of_clicks

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.media import read_sound_file
from frog_blender.engine.interchange import web_page
from frog_blender.engine.interchange.take import Sound, scene_take
from frog_blender.engine.interchange.web_page import page as web_pages
from frog_blender.engine.interchange.web_page.page import write_page
from frog_blender.engine.playback.frame_delta import column_of
from frog_blender.engine.playback.player import ScenePlayer, select_gaussians
from frog_blender.engine.source_media.sound import RATE, Samples, wav_of

FOLDER = Path(web_page.__file__).parent
FRAMES = range(7)
MOVING = 25
# Of the numbers' extent: half a step of what is stored, and a little for the curve of positions.
TOLERANCES = {"means": 1e-3, "quaternions": 0.025, "scales": 0.02, "base": 0.01}


@pytest.fixture
def scene() -> ScenePlayer:
    """Seven frames of forty Gaussians, of which some move."""
    return ScenePlayer(scene_file(sh_count=16, moving=MOVING))


def export(
    scene: ScenePlayer, path: Path, frames: range = FRAMES, name: str = "x", sound: Sound | None = None
) -> list[int]:
    """What it yielded."""
    return list(write_page(path, replace(scene_take(scene, name, frames), sound=sound)))


def parts(page: Path) -> tuple[dict[str, Any], bytes]:
    """The page's description and its packed numbers."""
    text = page.read_text(encoding="utf-16")
    (described,) = re.findall(r'id="description">(.*?)</script>', text)
    data = re.findall(r'"text/plain">(.*?)</script><script>arrived\(\)', text)
    numbers = np.frombuffer("".join(data).encode("utf-16-be"), ">u2") - 256
    bits = np.unpackbits(numbers.astype(">u2").view(np.uint8)).reshape(-1, 16)[:, 1:]
    description = json.loads(described)
    return description, np.packbits(bits).tobytes()[: description["bytes"]]


def unpacked(described: dict[str, Any], content: np.ndarray) -> np.ndarray:
    """(frames, rows, width) of one array of (frames, bytes), by the description alone."""
    wide = described["steps"] > 255
    planes = content.reshape(len(content), 2 if wide else 1, described["width"], described["rows"])
    values = planes[:, 0] + 256 * planes[:, 1].astype(np.uint16) if wide else planes[:, 0]
    values = np.cumsum(values, axis=0, dtype=values.dtype).transpose(1, 0, 2)
    low, high = (np.array(described[name])[:, None, None] for name in ("low", "high"))
    numbers = low + values * (high - low) / described["steps"]
    if described["curve"] == "exp":
        numbers = np.exp(numbers)
    if described["curve"] == "sinh":
        center, spread = (np.array(described[name])[:, None, None] for name in ("center", "spread"))
        numbers = center + spread * np.sinh(numbers)
    return numbers.transpose(1, 2, 0)


def arrays(page: Path) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
    """What is said of each array, and its numbers; there is nothing else."""
    description, data = parts(page)
    assert description["bytes"] == len(data)
    content = np.frombuffer(zlib.decompress(data), np.uint8)
    sizes = [a["rows"] * a["width"] * (2 if a["steps"] > 255 else 1) for a in description["arrays"]]
    firsts = np.split(content, np.cumsum(sizes))
    moving = [size if array["film"] else 0 for array, size in zip(description["arrays"], sizes, strict=True)]
    later = np.split(firsts.pop().reshape(description["frames"] - 1, sum(moving)), np.cumsum(moving)[:-1], axis=1)
    for described, first, others in zip(description["arrays"], firsts, later, strict=True):
        yield described, unpacked(described, np.vstack([first, others]) if described["film"] else first[None])


def expected(scene: ScenePlayer, name: str, frame: int) -> np.ndarray:
    column = column_of(scene.at_frame(frame), name)
    return np.where(column[:, :1] < 0, -column, column) if name == "quaternions" else column


def test_every_number_is_within_two_steps_of_playback(scene: ScenePlayer, tmp_path: Path) -> None:
    export(scene, tmp_path / "x.html", FRAMES[::2])
    fewer, _ = parts(tmp_path / "x.html")
    assert (fewer["frames"], fewer["frames_per_second"]) == (4, scene.header.frames_per_second / 2), "as slowly"
    assert export(scene, tmp_path / "x.html") == [0] * 7 + [1, 2, 3, 4, 5, 6, 7]
    assert parts(tmp_path / "x.html")[0]["dynamic"] == MOVING < scene.count
    seen = set()
    for described, numbers in arrays(tmp_path / "x.html"):
        name, rows = described["name"], described["rows"]
        seen.add((name, described["film"]))
        for frame in FRAMES if described["film"] else FRAMES[:1]:
            whole = expected(scene, name, frame)
            stored = whole[:rows] if described["film"] else whole[scene.count - rows :]
            actual = numbers[frame]
            if name == "quaternions":  # either sign is the same rotation
                actual = np.where((actual * stored).sum(1, keepdims=True) < 0, -actual, actual)
            if name == "scales":
                actual, stored = np.log(actual), np.log(stored)
            extent = np.ptp(np.log(whole) if name == "scales" else whole)
            inside = (stored > np.quantile(stored, 0.01)) & (stored < np.quantile(stored, 0.99))  # others are clamped
            assert np.abs(actual - stored)[inside].max() <= TOLERANCES.get(name, 0.005) * extent, (name, frame)
    assert ("means", True) in seen and ("means", False) in seen


def test_its_own_script_unpacks_the_same(scene: ScenePlayer, tmp_path: Path) -> None:
    """scene.js under Node, if there is one: a frame, one between two, and back again."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("there is no Node")
    export(scene, tmp_path / "x.html")
    description, data = parts(tmp_path / "x.html")
    (tmp_path / "description.json").write_text(json.dumps(description))
    (tmp_path / "data").write_bytes(zlib.decompress(data))
    script = (FOLDER / "scene.js").read_text(encoding="utf-8")
    script += """
    const files = require("fs");
    const scene = new Scene(JSON.parse(files.readFileSync("description.json")));
    const data = files.readFileSync("data"), arrived = [];
    for (let begin = 0; begin < data.length; begin += 100) {
      scene.add(data.subarray(begin, begin + 100));
      arrived.push(scene.arrived);
    }
    const shown = [3, 3.5, 6, 0].map((frame) => { scene.show(frame); return Array.from(scene.numbers); });
    console.log(JSON.stringify({ texels: scene.texels, shown, again: scene.show(0), arrived }));"""
    said = subprocess.run([node, "-e", script], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    actual = json.loads(said)
    assert actual["again"] == 0  # nothing to do for the frame that is shown
    assert actual["arrived"][0] == 0 and actual["arrived"] == sorted(actual["arrived"])
    assert {*actual["arrived"]} == {*range(8)}  # frame by frame
    of_frames = [np.array(values[: 4 * 19 * scene.count]).reshape(scene.count, -1, 4) for values in actual["shown"]]
    shown = dict(zip((3, 3.5, 6, 0), of_frames, strict=True))
    assert actual["texels"] == 3 + 16
    for frame in (3, 6, 0):
        means, opacities = shown[frame][:, 0, :3], shown[frame][:, 0, 3]
        gaussians = scene.at_frame(frame)
        np.testing.assert_allclose(means, gaussians.means, atol=2e-3 * np.ptp(gaussians.means))
        np.testing.assert_allclose(opacities, gaussians.opacities, atol=6e-3)
        sizes = np.log(shown[frame][:, 2, :3]) - np.log(gaussians.scales)
        assert np.quantile(np.abs(sizes), 0.9) < 0.05
    between = (shown[3][:, 0, :3] + scene.at_frame(4).means) / 2
    np.testing.assert_allclose(shown[3.5][:, 0, :3], between, atol=5e-3 * np.ptp(between))


def test_a_page_asks_for_nothing_and_names_nothing(scene: ScenePlayer, tmp_path: Path) -> None:
    header = scene.header
    wicked = replace(header.cameras[0], name="</script><b>")
    named = ScenePlayer(replace(scene_file(), header=replace(header, cameras=(wicked, *header.cameras[1:]))))
    export(named, tmp_path / "x.html", name="<i>& </title>")
    text = (tmp_path / "x.html").read_text(encoding="utf-16")
    assert "default-src 'none'" in text and "<b>" not in text and "<i>" not in text
    assert not re.search(r"https?://|src=\"(?!data:)|href=", text)
    assert header.capture_path not in text
    assert "{{" not in text.replace("${{", "")
    description, _ = parts(tmp_path / "x.html")
    assert description["cameras"][0]["name"] == wicked.name
    assert [path.name for path in tmp_path.iterdir()] == ["x.html"]


def test_what_brightens_later_is_as_bright_then(tmp_path: Path) -> None:
    """The steps are those of all frames: the first may be black."""
    file = scene_file(count=4000, sh_count=1)
    file.arrays["network.output_weight"][11:] = 0
    file.arrays["network.output_weight"][11:, 0] = 40.0  # colours follow one hidden unit
    scene = ScenePlayer(file)
    seen = [scene.at_frame(frame).opacities > 0.01 for frame in FRAMES]
    brightness = [scene.at_frame(frame).sh[seen[frame]].mean() for frame in FRAMES]
    assert np.ptp(brightness) > 1
    export(scene, tmp_path / "x.html")
    (numbers,) = (numbers for described, numbers in arrays(tmp_path / "x.html") if described["name"] == "base")
    actual = [numbers[frame][seen[frame], :3].mean() for frame in FRAMES]
    np.testing.assert_allclose(actual, brightness, atol=0.02 * np.ptp(brightness))


def test_what_does_not_move_is_there_once(scene: ScenePlayer, tmp_path: Path) -> None:
    still = ScenePlayer(select_gaussians(scene_file(moving=MOVING), np.arange(scene.num_dynamic, scene.count)))
    for played, frames in ((still, FRAMES), (scene, FRAMES[2:3])):
        export(played, tmp_path / "x.html", frames)
        description, _ = parts(tmp_path / "x.html")
        assert description["dynamic"] == 0
        assert not any(array["film"] for array in description["arrays"])


def test_splats_without_cameras_are_seen_from_afar(scene: ScenePlayer, tmp_path: Path) -> None:
    header = replace(scene.header, cameras=(), camera_shots=(), test_cameras=())
    export(ScenePlayer(replace(scene_file(), header=header)), tmp_path / "x.html")
    description, _ = parts(tmp_path / "x.html")
    assert description["cameras"] == []
    view = description["view"]
    pixels, depths = Camera.from_json(view["camera"]).project(scene.at_frame(0).means.astype(float))
    assert (depths > 0).mean() > 0.8 and ((pixels > 0) & (pixels < 1000)).all(1).mean() > 0.6
    assert np.isfinite(view["target"]).all()


def test_sound_is_part_of_the_page(scene: ScenePlayer, tmp_path: Path) -> None:
    """Of as much of it as the frames last."""
    (tmp_path / "x.wav").write_bytes(wav_of(clicks([0.6], 2.0)))
    export(scene, tmp_path / "x.html", sound=Sound(tmp_path / "x.wav", 0.5))
    text = (tmp_path / "x.html").read_text(encoding="utf-16")
    (actual,) = re.findall(r'id="sound">data:audio/ogg;base64,([^<]+)<', text)
    heard = Samples(read_sound_file(b64decode(actual), RATE, 2), RATE)
    assert len(heard.values) / RATE == pytest.approx(7 / scene.header.frames_per_second, abs=0.05)
    np.testing.assert_allclose(times_of_clicks(heard), [0.1], atol=0.01)


def test_what_a_browser_cannot_hold_is_refused(
    scene: ScenePlayer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_pages, "MOST_BYTES", 1000)
    refused(r"would unpack to .* export fewer frames", export, scene, tmp_path / "x.html")
    refused(r"found the ending '\.zip', expected \.html", export, scene, tmp_path / "x.zip")
    assert not list(tmp_path.iterdir())
