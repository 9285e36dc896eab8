"""How the parts of ``gpu.py`` end, and how they are told."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any


class LeftOut(Exception):
    """Why a part, or some of it, cannot be done here: no failure."""


class Failed(Exception):
    """What went wrong in a part; ``result`` is what it found before."""

    def __init__(self, reason: str, result: dict[str, Any] | None = None) -> None:
        super().__init__(reason)
        self.result = result or {}


def attempt(part: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The part's figures, with its time; "failed" or "left out" say why it is not whole."""
    started = time.monotonic()
    try:
        result = part()
    except LeftOut as error:
        result = {"left out": str(error)}
    except Failed as error:
        result = {**error.result, "failed": str(error)}
    except Exception as error:
        result = {"failed": f"{type(error).__name__}: {error}"}
    return {**result, "seconds": round(time.monotonic() - started, 1)}


def report(results: dict[str, dict[str, Any]]) -> str:
    """Markdown: a heading a part, its plain figures as a list, its runs as a table."""
    lines = []
    for name, result in results.items():
        lines += [f"## {name}", ""]
        lines += [f"- {key}: {_text(value)}" for key, value in result.items() if key not in ("runs", "cameras")]
        runs = result.get("runs") or []
        keys = list(dict.fromkeys(key for run in runs for key in run))
        if runs:
            lines += ["", f"| {' | '.join(keys)} |", f"|{'---|' * len(keys)}"]
            lines += [f"| {' | '.join(_text(run.get(key)) for key in keys)} |" for run in runs]
        lines.append("")
    return "\n".join(lines)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    return "" if value is None else " ".join(str(value).split())
