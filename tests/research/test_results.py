"""Results on disk survive being killed while they are written."""

import gzip
import json
from pathlib import Path

import pytest

from frog_blender.engine.errors import FrogError
from frog_blender.research.results import append, finished, read


def test_lines_come_back_in_order(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "runs.jsonl"
    assert read(path) == []
    for key in range(3):
        append(path, {"kind": "run", "key": str(key), "text": 'Zeile "ä"\n'})
    assert [record["key"] for record in read(path)] == ["0", "1", "2"]
    assert path.read_text(encoding="utf-8").count("\n") == 3


@pytest.mark.parametrize("kept", [1, 10, 35])
def test_a_half_written_line_spoils_only_itself(tmp_path: Path, kept: int) -> None:
    path = tmp_path / "runs.jsonl"
    append(path, {"kind": "run", "key": "a"})
    with path.open("a") as file:
        file.write(json.dumps({"kind": "run", "key": "cut off", "psnr": 30.0})[:kept])
    assert [record["key"] for record in read(path)] == ["a"]
    append(path, {"kind": "run", "key": "b"})
    assert [record["key"] for record in read(path)] == ["a", "b"]


def test_lines_that_are_no_records_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    path.write_bytes(b'[1]\n"text"\n\n{"key": "of no kind"}\n\xff\xfe\n{"kind": "run", "key": "good"}\n')
    assert [record["key"] for record in read(path)] == ["good"]


def test_compressed_results_come_before_later_ones(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    compressed = gzip.compress(b'{"kind": "run", "key": "kept"}\n')
    (tmp_path / "runs.jsonl.gz").write_bytes(compressed)
    assert [record["key"] for record in read(path)] == ["kept"]
    append(path, {"kind": "run", "key": "later"})
    assert [record["key"] for record in read(path)] == ["kept", "later"]


@pytest.mark.parametrize("kept", [3, 25])
def test_compressed_results_that_are_cut_off_are_refused(tmp_path: Path, kept: int) -> None:
    compressed = gzip.compress(b'{"kind": "run", "key": "kept"}\n')
    (tmp_path / "runs.jsonl.gz").write_bytes(compressed[:kept])
    with pytest.raises(FrogError, match=r"runs\.jsonl\.gz: the results could not be read"):
        read(tmp_path / "runs.jsonl")


def test_numbers_that_json_does_not_know_become_none(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    append(path, {"kind": "run", "key": "a", "lpips": float("nan"), "curve": [[1.0, float("inf")]]})
    assert read(path) == [{"kind": "run", "key": "a", "lpips": None, "curve": [[1.0, None]]}]


def test_the_last_one_counts() -> None:
    runs = [{"kind": "run", "key": "a", "psnr": psnr} for psnr in (1, 2)]
    assert finished([runs[0], {"kind": "failed", "key": "b"}, runs[1]]) == {"a": runs[1]}


def test_a_folder_that_takes_nothing_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FrogError, match="could not be written"):
        append(tmp_path / "file" / "runs.jsonl", {"kind": "run", "key": "a"})
