"""Films of a drawn room with a person walking in it, calibrated from nothing but themselves."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.builders import REPOSITORY

pytest.importorskip("pycolmap")
pytest.importorskip("imageio_ffmpeg")


@pytest.mark.slow
def test_a_drawn_rig_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(REPOSITORY / "benchmarks"), *sys.path])
    import calibration
    import rig_cases

    eyes = rig_cases.eyes(rig_cases.shaken(rig_cases.arc(4, 12.0), 1), size=(320, 240), focal=0.8)
    case = rig_cases.Case("four", "attic", eyes)
    monkeypatch.setattr(calibration, "FRAMES", 8)

    def filmed_and_measured(rig: rig_cases.Case) -> dict[str, Any]:
        films = tmp_path / "films" / rig.folder
        films.mkdir(parents=True)
        calibration.film(rig, films)
        return calibration.measure(rig, tmp_path)

    record = filmed_and_measured(case)
    assert "refusal" not in record
    assert record["centers"] < 0.5 and record["rotations"] < 0.2 and abs(record["focals"]) < 1 and record["k1"] == 0

    bent = replace(case, name="bent", eyes=tuple(replace(eye, k1=-0.15) for eye in eyes))
    record = filmed_and_measured(bent)
    assert "refusal" not in record
    assert record["centers"] < 0.5 and abs(record["k1"]) < 0.03
