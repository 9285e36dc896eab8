"""Results on disk survive being killed while they are written; their report says where a figure is missing."""

import csv
import gzip
import json
import re
from pathlib import Path

import pytest
from support.builders import refused
from support.chart_records import run_record, timing_record, whole_chart

from frog_blender.research.report import cell, differences, duration, markdown, sections, table
from frog_blender.research.results import append, finished, made_on, read, write_csv


def lines_of(text: str, heading: str) -> list[list[str]]:
    """The cells of the first table under a heading."""
    rest = text.split(heading, 1)[1]
    rows = []
    for line in rest.splitlines()[1:]:
        if line.startswith("|"):
            rows.append([part.strip() for part in line.strip("|").split("|")])
        elif rows:
            break
    return rows


def test_rows_and_sections() -> None:
    room, dim = sections(whole_chart())
    assert (room.scene, dim.scene) == ("room", "dim")
    methods = [row.method for row in room.rows["methods"]]
    assert methods == ["frog", "frog", "ed3dgs", "static", "d3dgs", "hexplane", "curves"]
    assert [row.label for row in room.rows["methods"]][:2] == ["FRoG", "FRoG auto"]
    assert list(room.rows) == ["methods", "time", "fusion", "modulation", "sampling", "opacity", "k", "capacity"]
    assert room.of_method("frog").values("psnr") == pytest.approx([30.1, 30.15, 30.2])
    assert room.title == "room (draft, 4000 steps)"


def test_other_recipes_and_sizes_are_not_mixed() -> None:
    records = [run_record(key="a"), run_record(key="b", scale=0.5), run_record(key="c", recipe_name="standard")]
    titles = [section.title for section in sections(records)]
    assert titles == ["room (draft, 4000 steps)", "room (draft, 4000 steps, scale 0.5)", "room (standard, 4000 steps)"]
    assert len({section.file_name for section in sections(records)}) == 3


def test_an_average_over_some_scenes_of_a_protocol_says_so() -> None:
    """A protocol that nobody knows says nothing of which scenes an average is over."""
    scenes = ("Train", "Fabien")
    records = [run_record(scene=scene, key=scene, protocol="technicolor", psnr=30.0) for scene in scenes]
    text = markdown(records)
    assert "2 of the 5 captures of technicolor, without Birthday, Painter, Theater: means are" in text
    assert lines_of(text, "## Average over the scenes (technicolor, draft)")[2][1] == "30.00"
    refused("no protocol 'mine'; there are n3dv", markdown, [run_record(protocol="mine")])


def test_times_belong_to_the_size_that_was_timed() -> None:
    records = [run_record(key="a"), run_record(key="b", scale=0.5), timing_record(fps=44.0, scale=0.5)]
    assert [section.of_method("frog").fps for section in sections(records)] == [None, 44.0]


def test_differences_are_taken_seed_by_seed() -> None:
    frog = [run_record("frog", seed, psnr=30.0 + seed) for seed in range(3)]
    base = [run_record("ed3dgs", seed, psnr=29.5 + 2 * seed) for seed in (0, 2, 5)]
    section = sections([*frog, *base])[0]
    by_seed = differences(section.of_method("frog"), section.of_method("ed3dgs"), "psnr")
    assert by_seed == {0: pytest.approx(0.5), 2: pytest.approx(-1.5)}
    assert differences(section.of_method("frog"), None, "psnr") == {}


def test_a_cell_is_a_median_and_its_spread() -> None:
    records = [run_record(seed=seed, psnr=psnr) for seed, psnr in enumerate((29.0, 31.0, 30.5))]
    row = sections(records)[0].of_method("frog")
    assert cell(row, "psnr") == "30.50 ± 1.04 (29.00 to 31.00)"
    assert cell(row, "lpips") == "not installed"
    assert cell(sections(records[:1])[0].of_method("frog"), "psnr") == "29.00"
    bare = run_record(missing={}, psnr_moving=None)
    assert cell(sections([bare])[0].of_method("frog"), "psnr_moving") == "-"


def test_a_row_never_mixes_runs_with_and_without_a_figure() -> None:
    """A median over the seeds that happen to have it is of other runs than its neighbours in the row."""
    lacking = run_record(seed=2, flip=None, missing={"flip": "not installed"})
    row = sections([run_record(seed=0), run_record(seed=1), lacking])[0].of_method("frog")
    assert row is not None and cell(row, "flip") == "2 of 3 seeds, not installed"
    assert row.median("flip") is None and row.median("psnr") == 30.0


def test_the_page() -> None:
    text = markdown(whole_chart(), published="| a paper's | figures |")
    rows = {line[0]: line for line in lines_of(text, "## room (draft, 4000 steps)")}
    assert (rows["E-D3DGS"][-1], rows["SpacetimeGaussians"][-1]) == ("3", "1")
    assert rows["FRoG"][1] == "30.15 ± 0.05 (30.10 to 30.20)"
    assert rows["FRoG"][5] == "not installed" and rows["FRoG"][9:11] == ["68 s", "52.0"]
    unlike = {line[0]: line[1:] for line in lines_of(text, "# Comparison")}
    assert unlike["FRoG"] == ["2026-01-01", "01234567+", "yes", "0.2"] and unlike["E-D3DGS"][2:] == ["no", "0.2"]
    averages = {line[0]: line for line in lines_of(text, "## Average over the scenes (draft)")}
    assert averages["FRoG"][1] == "29.15" and averages["FRoG"][-1] == "2"
    paired = lines_of(text, "## FRoG minus E-D3DGS, by seed")
    assert [line[1] for line in paired[2:]] == ["-0.05 ± 0.00 (-0.05 to -0.05)"] * 2 + ["-0.05"]
    assert lines_of(text, "### Canonical sampling")[-1][0] == "sampling: off"
    assert "-0.12 ± 0.02 (-0.14 to -0.10)" in text, "an ablation's difference and its range"
    assert "### As long as FRoG took" in text and "a paper's" in text and "Abacus" in text


def test_views_off_the_rig_have_a_table_of_their_own() -> None:
    runs = [run_record("frog", seed, fly=25.0 + seed, near=24.0, zoom=26.0) for seed in (0, 1)]
    text = markdown([*runs, run_record("static")])
    figures = ["25.50 ± 0.71 (25.00 to 26.00)", "24.00 ± 0.00 (24.00 to 24.00)", "26.00 ± 0.00 (26.00 to 26.00)"]
    assert lines_of(text, "off the rig:")[::2] == [["", "fly", "near", "zoom", "beside"], ["FRoG", *figures, "-"]]
    assert "off the rig" not in markdown([run_record("frog")])


def test_times_of_a_busy_grid_are_marked() -> None:
    text = markdown([run_record(dedicated=False)])
    assert "70 s *" in text
    assert "70 s *" not in markdown([run_record()])


def test_failures_are_told_until_they_are_mended() -> None:
    failed = {**run_record("d3dgs"), "kind": "failed", "error": "room: found no file."}
    assert "- room, Deformable-3DGS, seed 0: room: found no file." in markdown([run_record(), failed])
    assert "Failed" not in markdown([run_record("d3dgs"), failed])


@pytest.mark.parametrize("count", [1, 2])
def test_little_is_enough(count: int) -> None:
    figures = {"psnr_moving": None, "ssim": None, "flip": None, "missing": {}}
    records = [run_record("static", seed, **figures) for seed in range(count)]
    text = markdown(records)
    assert "3DGS (static)" in text and "None" not in text and "nan" not in text


def test_durations_and_tables() -> None:
    for seconds, said in ((None, "-"), (71.4, "71 s"), (119.6, "120 s"), (121, "2 min"), (6700, "1 h 52 min")):
        assert duration(seconds) == said
    assert table(["a", "b"], [["1", "2"]]) == "| a | b |\n|---|---:|\n| 1 | 2 |"


def test_a_spreadsheet_has_a_line_a_run_and_a_column_a_value(tmp_path: Path) -> None:
    failed = {**run_record("d3dgs"), "kind": "failed", "error": "room: found no file."}
    odd = run_record(seed=1, scene='a "room", large', warnings=["one", "two"])
    with write_csv(tmp_path, [run_record(), odd, failed]).open(encoding="utf-8", newline="") as file:
        first, second = csv.DictReader(file)
    told = {"scene": "room", "psnr": "30.0", "recipe.size_limit": "0.2", "machine.cpu": "Abacus", "lpips": ""}
    assert told.items() <= first.items(), "what is None is empty"
    assert (second["scene"], json.loads(second["warnings"]), first["warnings"]) == (odd["scene"], ["one", "two"], "")


def test_a_record_says_which_code_made_it() -> None:
    made = made_on()["code"]
    assert re.fullmatch("[0-9a-f]{16}", made["hash"])
    assert made["commit"] is None or re.fullmatch("[0-9a-f]{40}[+]?", made["commit"])


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
    refused(r"runs\.jsonl\.gz: the results could not be read", read, tmp_path / "runs.jsonl")


def test_numbers_that_json_does_not_know_become_none(tmp_path: Path) -> None:
    path = tmp_path / "runs.jsonl"
    append(path, {"kind": "run", "key": "a", "lpips": float("nan"), "curve": [[1.0, float("inf")]]})
    assert read(path) == [{"kind": "run", "key": "a", "lpips": None, "curve": [[1.0, None]]}]


def test_the_last_one_counts() -> None:
    runs = [{"kind": "run", "key": "a", "psnr": psnr} for psnr in (1, 2)]
    assert finished([runs[0], {"kind": "failed", "key": "b"}, runs[1]]) == {"a": runs[1]}


def test_a_folder_that_takes_nothing_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    refused("could not be written", append, tmp_path / "file" / "runs.jsonl", {"kind": "run", "key": "a"})
