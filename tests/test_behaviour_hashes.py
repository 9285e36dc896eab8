"""The record of what the program computes: every difference between two of them is found, and nothing else is one."""

import importlib
import json
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
import pytest
from support.builders import REPOSITORY, scene_file

from frog_blender.engine.scene.scene_file import write_scene


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(REPOSITORY / "tools")
    return importlib.import_module("behaviour_hashes")


def write_record(path: Path, hashes: dict[str, str]) -> str:
    path.write_text(json.dumps({"about": {"machine": "this one"}, "hashes": hashes}))
    return str(path)


def test_what_differs_is_named(tool: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of both records, or where asked of the runs that both have."""
    before = write_record(tmp_path / "a.json", {"run/scene/means": "1", "run/scene/sh": "2", "run/scene/old": "3"})
    after = write_record(tmp_path / "b.json", {"run/scene/means": "1", "run/scene/sh": "9", "run/scene/new": "3"})
    assert tool.main(["compare", before, before]) == 0
    assert "0 of 3 hashes differ" in capsys.readouterr().out
    assert tool.main(["compare", before, after]) == 1
    said = capsys.readouterr().out
    assert "run/scene/sh: 2 -> 9" in said
    assert "run/scene/old: 3 -> missing" in said and "run/scene/new: missing -> 3" in said
    assert "run/scene/means" not in said
    assert tool.main(["compare", before, after, "--ignore", "*/sh", "*/old", "*/new"]) == 0
    more = write_record(
        tmp_path / "c.json", {"run/scene/means": "1", "run/scene/sh": "2", "run/scene/old": "3", "two/x": "1"}
    )
    assert tool.main(["compare", before, more]) == 1 and tool.main(["compare", before, more, "--common"]) == 0
    assert tool.main(["compare", more, after, "--common"]) == 1


def test_one_number_of_a_scene_changes_one_hash(tool: ModuleType, tmp_path: Path) -> None:
    scene = scene_file()
    write_scene(tmp_path / "scene.frog", scene)
    before = tool.hash_folder(tmp_path)
    scene.arrays["means"] = scene.arrays["means"].copy()
    scene.arrays["means"][0, 0] = np.nextafter(scene.arrays["means"][0, 0], np.float32(9))
    write_scene(tmp_path / "scene.frog", scene)
    assert [line.split(":")[0] for line in tool.differences(before, tool.hash_folder(tmp_path))] == ["scene.frog/means"]


def test_one_pixel_of_an_image_changes_its_hash(tool: ModuleType, tmp_path: Path) -> None:
    image = np.zeros((4, 6, 3), np.uint8)
    cv2.imwrite(str(tmp_path / "0000.png"), image)
    before = tool.hash_folder(tmp_path)
    image[1, 2, 0] = 1
    cv2.imwrite(str(tmp_path / "0000.png"), image)
    assert len(list(tool.differences(before, tool.hash_folder(tmp_path)))) == 1


def test_what_no_two_runs_share_is_left_out(tool: ModuleType) -> None:
    runs = [
        {"psnr": 30.5, "train_seconds": seconds, "rounds": [{"loss": 0.1, "milliseconds": seconds}], "bytes": seconds}
        for seconds in (1, 2)
    ]
    first, second = (tool.hash_values(values) for values in runs)
    assert first == second and first["psnr"] == "30.5"
    assert tool.hash_values(runs[0] | {"psnr": 30.6}) != first
    assert tool.hash_values(runs[0] | {"rounds": [{"loss": 0.2}]}) != first
