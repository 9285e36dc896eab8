"""Damaged and hostile files: no crash, no hang, no memory, only sentences, whatever is done with them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

pytest.importorskip("resource")

Answer = dict[str, float]


def used(folder: Path, seed: int, count: int, *kind: str, first: int = 0) -> Answer:
    """What a process of its own made of so many files; its end names the file that it did not survive."""
    folder.mkdir(parents=True, exist_ok=True)
    script = Path(__file__).parents[1] / "fuzzing" / "worker.py"
    command = [sys.executable, str(script), str(folder), *map(str, (seed, first, count)), *kind]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3000, check=False)
    what = (folder / "what").read_text() if (folder / "what").exists() else "an undamaged file"
    assert done.returncode == 0, f"{what}, kept in {folder}: status {done.returncode}\n{done.stderr[-2000:]}"
    return json.loads(done.stdout.splitlines()[-1])


def used_by_all_cores(folder: Path, seed: int, count: int, *kind: str, batch: int) -> list[Answer]:
    """The same by a process for every ``batch`` files, as many at a time as there are cores."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        started = [
            pool.submit(used, folder / str(first), seed, min(batch, count - first), *kind, first=first)
            for first in range(0, count, batch)
        ]
        return [each.result() for each in started]


def check(answers: list[Answer], count: int) -> None:
    refused, played = (sum(answer[key] for answer in answers) for key in ("refused", "used"))
    assert refused + played == count and refused > count / 4 and played > count / 10, "damage is harmless or is not"
    assert max(answer["peak"] for answer in answers) < 500e6


def test_hundreds_of_damaged_files(tmp_path: Path) -> None:
    check([used(tmp_path, 1, 200)], 200)


@pytest.mark.slow
def test_fifty_thousand_damaged_files(tmp_path: Path) -> None:
    check(used_by_all_cores(tmp_path, 2, 50_000, batch=1000), 50_000)


@pytest.mark.slow
def test_two_thousand_damaged_files_in_blender(tmp_path: Path) -> None:
    pytest.importorskip("bpy")
    check(used_by_all_cores(tmp_path, 3, 2000, "blender", batch=250), 2000)
