"""The report of a chart's results: a page of tables, and the charts beside it."""

from __future__ import annotations

from pathlib import Path

from ..engine import FrogError, write_atomically
from .charts import write_charts
from .results import read
from .summary import sections
from .tables import markdown


def write_report(folder: Path, published: str = "") -> list[Path]:
    """Writes ``tables.md`` and the charts of the results in ``folder``; returns their paths.

    Args:
        published: a table of a paper's own figures, shown beside ours.

    Raises:
        FrogError: if there is no finished run yet.
    """
    records = read(folder / "runs.jsonl")
    found = sections(records)
    if not found:
        raise FrogError(f"{folder}: found no finished run, expected at least one in runs.jsonl.")
    charts = write_charts(found, folder)
    text = markdown(records, published)
    images = [path.name for path in charts if path.suffix == ".png"]
    text += "\n## Charts\n\n" + "\n\n".join(f"![{Path(name).stem}]({name})" for name in images) if images else ""
    write_atomically(folder / "tables.md", (text.rstrip() + "\n").encode())
    return [folder / "tables.md", *charts]
