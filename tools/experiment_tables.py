"""Make every table and image of docs/experiments from the results kept there: ``make experiment-tables``.

    python tools/experiment_tables.py [--check] [--tables-only] [--keep FILE.jsonl NAME]

A folder of docs/experiments with a ``runs.jsonl.gz`` is a data set, as ``frog chart`` and ``frog stability`` leave it.
Its ``tables.md`` has all figures. Pages show extracts between two comments, which this script fills:

    <!-- table NAME -->
    <!-- end of table -->

``--check`` writes nothing and fails where a table is not what the data say. ``--keep`` compresses new results to be the
data set NAME.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import re
import shutil
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "experiments"
sys.path.insert(0, str(ROOT / "benchmarks"))

import raster_report  # noqa: E402

from frog_blender.engine.registry import METHODS  # noqa: E402
from frog_blender.research import charts, stability  # noqa: E402
from frog_blender.research.grid import AUTO_LABEL  # noqa: E402
from frog_blender.research.report import Row, Section, differences, markdown, sections, table  # noqa: E402
from frog_blender.research.results import read  # noqa: E402

Record = dict[str, Any]
BLOCK = re.compile(r"(<!-- table ([\w-]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


def results(name: str) -> list[Record]:
    return read(FOLDER / name / "runs.jsonl")


def raster_results() -> list[Record]:
    """Lines of ``benchmarks/rasterizer.py``."""
    text = gzip.decompress((FOLDER / "rasterizer" / "results.jsonl.gz").read_bytes()).decode()
    return [json.loads(line) for line in text.splitlines()]


def comparable(name: str) -> list[Section]:
    """The draft's sections, those in which something moves before a static camera."""
    plain = (section for section in sections(results(name)) if section.recipe == "draft" and not section.protocol)
    found = [section for section in plain if "methods" in section.rows]
    return [section for section in found if section.rows["methods"][0].median("psnr_moving") is not None]


def overview(name: str, group: str = "methods") -> str:
    """PSNR over all and moving pixels of every method on every capture, with its costs."""
    found = comparable(name)
    labels = [row.label for row in found[0].rows[group]]
    if group == "time":
        labels.insert(0, METHODS["frog"].title)
    lines = []
    for label in labels:
        rows = [section.row(label, group) or section.row(label) for section in found]
        known = [row for row in rows if row is not None]
        seeds = min(len(row.records) for row in known)
        pairs = [(row.median("psnr") or 0.0, row.median("psnr_moving") or 0.0) for row in known]
        means = statistics.mean(psnr for psnr, _ in pairs), statistics.mean(moving for _, moving in pairs)
        cells = [f"{psnr:.2f} / {moving:.2f}" for psnr, moving in [*pairs, means]]
        if group == "time":
            costs = [", ".join(f"{row.median('steps'):,.0f}" for row in known)]
        else:
            seconds = statistics.mean(row.training_seconds or 0.0 for row in known)
            fps = [row.fps for row in known if row.fps]
            costs = [f"{seconds:.0f}", f"{statistics.mean(fps):.0f}" if fps else "-"]
        lines.append([f"{label} ({seeds} {'seed' if seeds == 1 else 'seeds'})", *cells, *costs])
    costs = ["steps"] if group == "time" else ["training, s", "FPS"]
    return table(["PSNR, all / moving pixels, dB", *(section.scene for section in found), "mean", *costs], lines)


def by_seed(values: Iterable[float], form: str) -> str:
    return ", ".join(format(value, form) for value in values)


def automatic(name: str) -> str:
    """Automatic against fixed capacity, by seed."""
    lines = []
    for section in sections(results(name)):
        auto, fixed = section.row(AUTO_LABEL), section.of_method("frog")
        if section.recipe != "draft" or auto is None or fixed is None:
            continue
        seeds = sorted(auto.records.keys() & fixed.records.keys())
        pairs = [(auto.records[seed], fixed.records[seed]) for seed in seeds]
        lines.append(
            [
                section.scene,
                by_seed(fixed.values("psnr"), ".2f"),
                by_seed(differences(auto, fixed, "psnr").values(), "+z.2f"),
                by_seed(differences(auto, fixed, "psnr_moving").values(), "+z.2f") or "-",
                by_seed((a["dynamic"] / a["gaussians"] for a, _ in pairs), ".0%"),
                by_seed((f["bytes"] / a["bytes"] for a, f in pairs), ".1f"),
                ", ".join(f"{a['train_seconds']:.0f} / {f['train_seconds']:.0f}" for a, f in pairs),
            ]
        )
    titles = ["", "PSNR of FRoG, dB", "FRoG auto less FRoG, dB", "in moving pixels, dB", "dynamic Gaussians"]
    return table([*titles, "file of FRoG over that of FRoG auto", "training, auto / fixed, s"], lines)


def sweep(name: str) -> str:
    """PSNR and packed size for fewer Gaussians and for fewer dynamic ones, means over the seeds."""
    found = [section for section in sections(results(name)) if "capacity" in section.rows]
    labels = list(dict.fromkeys(row.label for section in found for row in section.rows["capacity"]))
    labels.sort(key=lambda label: ("move" in label, float(re.sub(r"[^\d.]", "", label))))

    def cell(row: Row | None) -> str:
        if row is None:
            return "-"
        return f"{statistics.mean(row.values('psnr')):.2f}, {statistics.mean(row.values('packed_bytes')) / 1e3:.0f}"

    lines = []
    for section in found:
        swept = [section.row(label, "capacity") for label in labels]
        lines.append([section.scene, *map(cell, [section.of_method("frog"), section.row(AUTO_LABEL), *swept])])
    return table(["PSNR, dB, and packed file, kB", "FRoG", AUTO_LABEL, *labels], lines)


def under_conditions(name: str) -> str:
    """PSNR by seed under every condition of the stability suite."""
    found = stability.outcome(results(name))
    frog, base, static, curves = (METHODS[name].title for name in ("frog", "ed3dgs", "static", "curves"))

    lines = []
    for condition in found.conditions:
        own, loss = found.cell(condition.name, frog), found.loss(condition, frog)
        others = [found.lead(condition.name, frog, other) for other in (static, curves)]
        lines.append(
            [
                condition.name,
                by_seed(own.values("psnr"), ".2f"),
                "" if loss is None or condition.name == condition.against else f"{loss:+z.1f}",
                by_seed(found.lead(condition.name, frog, base), "+z.2f"),
                *(f"{statistics.mean(values):+z.1f}" if values else "-" for values in others),
            ]
        )
    titles = ["condition", f"PSNR of {frog}, dB", "off the clean case"]
    titles += [f"less {base}", f"less {static}", f"less {curves}"]
    return table(titles, lines)


def raster() -> str:
    """Times of the scenes that stand for captures, with the instruction sets of today's processors."""
    shown = [
        record
        for record in raster_results()
        if record["isa"] in ("avx512", "avx2")
        and record["threads"] == 2
        and not record["scene"].startswith(("tiny", "sweep"))
    ]
    return raster_report.table(shown)


def calibration(name: str) -> str:
    """What became of every rig of one of the benchmarks of calibration; clocks where films out of step were timed."""
    text = gzip.decompress((FOLDER / "calibration" / f"{name}.jsonl.gz").read_bytes()).decode()
    records = [json.loads(line) for line in text.splitlines()]
    is_timed = any("clocks" in record for record in records)
    lines = []
    for record in records:
        if "refusal" in record:
            figures = ["refused", "", "", "", ""]
        else:
            figures = [f"{record['centers']:.2f}", f"{record['rotations']:.2f}", f"{record['focals']:+z.2f}"]
            figures += [f"{record['k1']:+z.3f}", str(len(record["warnings"]))]
        clocks = [f"{record['clocks']:.2f}" if "clocks" in record else ""] if is_timed else []
        seen = f"{record['points']} points" if "points" in record else record["room"]
        lines.append([record["rig"], seen, str(record["cameras"]), *figures, *clocks, f"{record['cpu_seconds']:.0f}"])
    titles = ["centre, % of the rig", "rotation, degrees", "focal length, %", "k1", "warnings"]
    titles += ["clock, frames"] if is_timed else []
    return table(["rig", "sees", "cameras", *titles, "processor s"], lines)


TABLES: dict[str, Callable[[], str]] = {
    "accuracy": lambda: overview("grid"),
    "accuracy-at-equal-time": lambda: overview("grid", "time"),
    "accuracy-of-the-papers-forms": lambda: overview("papers"),
    "automatic-capacity": lambda: automatic("drafts"),
    "capacity-sweep": lambda: sweep("grid-earlier"),
    "stability": lambda: under_conditions("stability"),
    "rasterizer": raster,
    "calibration": lambda: calibration("results"),
    "calibration-of-rendered-films": lambda: calibration("rendered"),
}
"""What pages may show, by the name in their comments."""


def scene_chart(name: str, scene: str, chart: Callable[[Section], Any]) -> Any:
    return next(figure for section in sections(results(name)) if section.scene == scene and (figure := chart(section)))


FIGURES: dict[str, Callable[[], Any]] = {
    "accuracy-and-speed": lambda: scene_chart("grid", "fast", charts.speed_chart),
    "stability": lambda: stability.heat_map(stability.outcome(results("stability"))),
}
"""One a page, by the page's name."""


def texts() -> Iterator[tuple[Path, str]]:
    """Every file that holds tables, and what it should say.

    Raises:
        SystemExit: where a page asks for a table that does not exist.
    """
    for path in sorted(FOLDER.glob("*/runs.jsonl.gz")):
        records = read(path.with_suffix(""))
        suite = any(record.get("condition") for record in records)
        text = stability.stability_table(stability.outcome(records)) if suite else markdown(records)
        yield path.with_name("tables.md"), text.replace("](stability.svg)", "](../stability.svg)")

    def filled(block: re.Match[str]) -> str:
        if block[2] not in TABLES:
            raise SystemExit(f"{page.name}: found table {block[2]}, expected one of {', '.join(TABLES)}.")
        return f"{block[1]}{TABLES[block[2]]()}\n{block[3]}"

    for page in sorted(FOLDER.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        yield page, BLOCK.sub(filled, text)


def write_figures() -> list[Path]:
    """As SVG, which is the smaller form of all of them; the same bytes for the same results."""
    import matplotlib

    matplotlib.rcParams["svg.hashsalt"] = "frog"
    os.environ["SOURCE_DATE_EPOCH"] = "0"  # or an SVG has today's date
    written = [FOLDER / f"{name}.svg" for name in [*FIGURES, "rasterizer"]]
    with tempfile.TemporaryDirectory() as folder:
        for path in written[:-1]:
            charts.save_figure(FIGURES[path.stem](), Path(folder) / path.name)
        raster_report.chart(raster_results(), Path(folder) / "rasterizer.svg")
        for path in written:
            shutil.copyfile(Path(folder) / path.name, path)
    return written


def keep(source: Path, name: str) -> Path:
    """Results of new runs as the data set ``name``; the same bytes for the same results."""
    target = FOLDER / name / "runs.jsonl.gz"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(gzip.compress(source.read_bytes(), mtime=0))
    return target


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Make the tables and images of docs/experiments from their data.")
    parser.add_argument("--check", action="store_true", help="fail where a table is not what the data say")
    parser.add_argument("--keep", nargs=2, metavar=("FILE", "NAME"), help="make FILE the data set NAME first")
    parser.add_argument("--tables-only", action="store_true", help="draw no images")
    options = parser.parse_args(arguments)
    if options.keep:
        print(keep(Path(options.keep[0]), options.keep[1]))
    stale = [(path, text) for path, text in texts() if not path.is_file() or path.read_text(encoding="utf-8") != text]
    for path, text in stale:
        if options.check:
            print(f"{path.relative_to(ROOT)} is not what the data say; make experiment-tables mends it.")
        else:
            path.write_text(text, encoding="utf-8")
            print(path.relative_to(ROOT))
    if not (options.check or options.tables_only):
        for path in write_figures():
            print(path.relative_to(ROOT))
    return 1 if stale and options.check else 0


if __name__ == "__main__":
    sys.exit(main())
