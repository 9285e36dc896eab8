#!/usr/bin/env python3
"""Writes the table of a training's options into docs/cli.md, between its two comments.

usage: option_table.py [--check]   --check writes nothing: the exit status is 1 where the page says something else
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from frog_blender.engine.options import OPTIONS, Option
from frog_blender.engine.setting import Choice, text_of

PAGE = Path(__file__).resolve().parents[1] / "docs" / "cli.md"
_BEGIN, _END = "<!-- options: tools/option_table.py -->\n", "<!-- /options -->\n"


def table() -> str:
    """Rows of flag, meaning and default, as Markdown."""
    rows = [f"| {_flag(option)} | {_meaning(option)} | {_default(option)} |\n" for option in OPTIONS.values()]
    return "| option | meaning | default |\n|---|---|---|\n" + "".join(rows)


def _flag(option: Option) -> str:
    kind = option.plain_kind
    if option.is_switch:
        return f"`{option.flag}`"
    values = r"\|".join(map(str, kind.values)) if isinstance(kind, Choice) else option.placeholder
    return f"`{option.flag} {values}`"


def _meaning(option: Option) -> str:
    return re.sub(r"\|", r"\\|", option.help)


def _default(option: Option) -> str:
    return option.unset or ("" if option.is_switch else f"`{text_of(option.default)}`")


def with_table(page: str) -> str:
    """A page whose table is that of today."""
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not (begin and end):
        raise SystemExit(f"{PAGE}: expected the lines {_BEGIN.strip()} and {_END.strip()}.")
    return f"{before}{begin}\n{table()}\n{end}{after}"


def main() -> None:
    """Writes the page, or compares it."""
    page = PAGE.read_text(encoding="utf-8")
    made = with_table(page)
    if "--check" in sys.argv[1:]:
        raise SystemExit(0 if made == page else f"{PAGE}: its table is old; tools/option_table.py writes it anew.")
    PAGE.write_text(made, encoding="utf-8")


if __name__ == "__main__":
    main()
