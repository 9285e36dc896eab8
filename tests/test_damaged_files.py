"""Thousands of damaged and hostile files of every kind: no crash, no hang, no memory, only sentences that name a path.

Which kinds there are, and what each of their files looks like, say the scripts in ``support/mutated_*.py``.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from support.damaged_inputs import counted
from support.mutated_captures import LAYOUTS

pytest.importorskip("resource")
pytestmark = pytest.mark.slow

NEEDS = {**dict.fromkeys(("usdc", "usda", "usdz", "foreign usd"), "pxr"), "spz": "zstandard"}
IMPORTS = (*NEEDS, "sog", "plys", "glb", "gltf", "splat", "ksplat", "ply", "edits")
CALIBRATION = {"boards": 2000, "plain boards": 1000, "clicked points": 2000, "reports": 2000, "clocks": 400}
CALIBRATION |= {"stages": 3000, "films": 400, "stills": 1000}
FILES = {"bakes": 5000, "poses": 5000, "points": 5000, "masks": 5000, "seeds": 5000, "checkpoints": 1000}
CASES = [
    *(("imports", kind, 5000, 64e6) for kind in IMPORTS),  # bytes that drawing one takes above what a whole one does
    *(("calibration", kind, count, 500e6) for kind, count in CALIBRATION.items()),
    *(("files", kind, count, 500e6) for kind, count in FILES.items()),
]


@pytest.mark.parametrize(("script", "kind", "count", "most"), CASES, ids=[kind for _, kind, _, _ in CASES])
def test_damaged_files_are_refused_or_used(script: str, kind: str, count: int, most: float, tmp_path: Path) -> None:
    pytest.importorskip(NEEDS.get(kind, "numpy"))
    answer = counted(f"mutated_{script}.py", kind, tmp_path, count, 2)
    assert answer["refused"] > 0 and answer["used"] > 0, "some damage is harmless, some is not"
    assert answer["peak"] < most


@pytest.mark.parametrize("start", range(3))
def test_damaged_captures_are_refused_or_used(start: int, tmp_path: Path) -> None:
    answers = counted("mutated_captures.py", ",".join(list(LAYOUTS)[start::3]), tmp_path, 1250, 2).values()
    refused, used = (sum(answer[what] for answer in answers) for what in ("refused", "used"))
    assert refused > used > 0, "some damage is harmless, most is not"
    assert max(answer["peak"] for answer in answers) < 500e6
