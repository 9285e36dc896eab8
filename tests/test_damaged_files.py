"""Thousands of damaged and hostile files of every kind: no crash, no hang, no memory, only sentences.

Which kinds there are, and what each of their files looks like, say the modules ``fuzzing/of_*.py``.
"""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from support.builders import REPOSITORY

pytest.importorskip("resource")

Answer = dict[str, float]
NEEDS = {**dict.fromkeys(("usdc", "usda", "usdz", "foreign usd"), "pxr"), "spz": "zstandard", "blender": "bpy"}
IMPORTS = ("usdc", "usda", "usdz", "foreign usd", "spz", "sog", "plys", "glb", "gltf", "splat", "ply")
IMPORTS += ("splatv", "curves", "edits")
CASES = {"scenes": 50_000, **dict.fromkeys(IMPORTS, 5000), "blender": 2000}
CASES |= {"boards": 3000, "reports": 2000, "clocks": 400}
CASES |= {"stages": 3000, "films": 400, "stills": 1000}
CASES |= {**dict.fromkeys(("masks", "seeds"), 5000), "checkpoints": 1000}
LAYOUTS = ("colmap_binary", "colmap_text", "colmap_moving", "multipleview", "multipleview_rows", "n3dv_frames")
LAYOUTS += ("panoptic_sports", "easyvolcap", "easymocap", "caliscope", "fisheye_toml", "immersive", "opencv_frames")
LAYOUTS += ("timed_films", "qualisys", "technicolor", "hypernerf")
LAYOUTS += ("nerfstudio_fisheye",)
BATCH = 1000


def used(kind: str, folder: Path, count: int, seed: int, first: int = 0) -> Answer:
    """What a process of its own made of so many files; its end names the file that it did not survive."""
    script = Path(__file__).parent / "fuzzing" / "worker.py"
    command = [sys.executable, str(script), kind, str(folder), *map(str, (count, seed, first))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3000, check=False, cwd=REPOSITORY)
    what = (folder / "what").read_text() if (folder / "what").exists() else "an undamaged file"
    assert done.returncode == 0, f"{what}, kept in {folder}: status {done.returncode}\n{done.stderr[-2000:]}"
    return dict(json.loads(done.stdout.splitlines()[-1]))


def check(kind: str, folder: Path, count: int, seed: int, batch: int = BATCH) -> None:
    """Some are refused and some used, by a process for every ``batch``, as many at a time as there are cores."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        starts = range(0, count, batch)
        started = [pool.submit(used, kind, folder / str(i), min(batch, count - i), seed, i) for i in starts]
        answers = [answer.result() for answer in started]
    assert all(sum(answer[what] for answer in answers) > 0 for what in ("refused", "used")), "damage is harmless or not"
    assert sum(answer[what] for answer in answers for what in ("refused", "used")) == count
    assert max(answer["peak"] for answer in answers) < (64e6 if kind in IMPORTS else 500e6)


@pytest.mark.parametrize("kind", ["scenes", "edits"])
def test_hundreds_of_damaged_files(kind: str, tmp_path: Path) -> None:
    check(kind, tmp_path, 300, 1, batch=150)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*CASES, *LAYOUTS])
def test_damaged_files_are_refused_or_used(kind: str, tmp_path: Path) -> None:
    pytest.importorskip(NEEDS.get(kind, "numpy"))
    check(kind, tmp_path, CASES.get(kind, 1250), 2)
