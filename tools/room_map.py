"""Draws the rooms of the code, who imports whom, and how much there is to read: docs/images/rooms.svg.

    python tools/room_map.py [--out FILE.svg]

The floors are the layers of ``pyproject.toml``, which import-linter checks. Lines go from a room to those that it
imports, the wider the more files do. A room's number is of its code lines: no blanks, comments and docstrings.
"""

from __future__ import annotations

import argparse
import ast
import io
import tokenize
import tomllib
from collections import Counter
from html import escape
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "frog_blender"
PICTURE = ROOT / "docs" / "images" / "rooms.svg"
NATIVE = {".cpp", ".h", ".inl", ".cu", ".cuh", ".js", ".glsl", ".html"}
NO_CODE = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
WIDTH, HEIGHT, GAP, FLOOR = 134, 34, 12, 66  # pixels of a box, between boxes, and from floor to floor
LEFT = 20


def layers(container: str) -> list[list[str]]:
    """The rooms of a package by floors, the highest first; single files only where they stand among rooms."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    floors = next(entry["layers"] for entry in contracts if entry.get("containers") == [container])
    names = [[name.strip() for name in floor.replace("|", ":").split(":")] for floor in floors]
    folder = ROOT / container.replace(".", "/")
    rooms = [[name for name in floor if (folder / name).is_dir()] for floor in names]
    return [floor for floor in rooms if floor]


def code_lines(path: Path) -> int:
    """Lines with code on them."""
    text = path.read_text(encoding="utf-8")
    if path.suffix in NATIVE:
        lines = (line.strip() for line in text.splitlines())
        return sum(1 for line in lines if line and not line.startswith(("//", "/*", "*")))
    rows: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in NO_CODE:
            rows.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        is_text = (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        )
        if is_text and node.end_lineno is not None:
            rows.difference_update(range(node.lineno, node.end_lineno + 1))
    return len(rows)


def room_of(path: Path) -> str:
    """Such as ``ui`` or ``engine/scene``; the folder itself for a file beside the rooms."""
    parts = path.relative_to(PACKAGE).parts[:-1]
    return "/".join(parts[:2] if parts[:1] == ("engine",) else parts[:1])


def imported_rooms(path: Path) -> set[str]:
    """The rooms that a file imports from, its own left out."""
    package, rooms = path.relative_to(ROOT).parts[:-1], set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or not node.level:
            continue
        base = [*package[: len(package) - node.level + 1], *(node.module or "").split(".")]
        targets = [Path(ROOT, *base, *alias.name.split("."), "x") for alias in node.names]
        rooms |= {room_of(target) for target in targets if target.is_relative_to(PACKAGE)}
    return rooms - {room_of(path)}


def measured() -> tuple[Counter[str], Counter[tuple[str, str]]]:
    """Code lines by room, and by pair of rooms the files of the first that import the second."""
    lines: Counter[str] = Counter()
    imports: Counter[tuple[str, str]] = Counter()
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix == ".py" or path.suffix in NATIVE:
            lines[room_of(path)] += code_lines(path)
        if path.suffix == ".py":
            imports.update((room_of(path), room) for room in imported_rooms(path))
    return lines, imports


def places() -> tuple[dict[str, tuple[float, float]], float, float]:
    """The upper left corner of each room's box, and the picture's size: Blender's side beside the engine, on which it
    stands. Floors of one room step aside in turn, so that lines pass between boxes."""
    upper = [floor for floor in layers("frog_blender") if floor != ["engine"]]
    lower = [[f"engine/{name}" for name in floor] for floor in layers("frog_blender.engine")]
    corners: dict[str, tuple[float, float]] = {}
    left = LEFT
    for column in (upper, lower):
        width = max(max(len(floor) for floor in column), 3) * (WIDTH + GAP)
        for row, floor in enumerate(column):
            aside = (row % 3 - 1) * (WIDTH + GAP) / 1.5 if len(floor) == 1 else 0.0
            begin = left + (width - len(floor) * (WIDTH + GAP)) / 2 + aside
            corners |= {name: (begin + index * (WIDTH + GAP), LEFT + row * FLOOR) for index, name in enumerate(floor)}
        left += width + 2 * LEFT
    return corners, left, max(len(upper), len(lower)) * FLOOR + LEFT


def drawn() -> str:
    """The picture."""
    lines, imports = measured()
    corners, width, height = places()
    size = f'width="{width:.0f}" height="{height:.0f}" viewBox="0 0 {width:.0f} {height:.0f}"'
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" font-size="12">']
    parts.append(f'<rect width="{width:.0f}" height="{height:.0f}" fill="#fff"/>')
    for (upper, lower), files in sorted(imports.items()):
        if upper in corners and lower in corners:
            (x, y), (across, down) = corners[upper], corners[lower]
            x, across, y = x + WIDTH / 2, across + WIDTH / 2, y + HEIGHT
            bend = max((down - y) / 2, FLOOR / 2)
            curve = f"M{x:.0f} {y:.0f} C{x:.0f} {y + bend:.0f} {across:.0f} {down - bend:.0f} {across:.0f} {down:.0f}"
            width_of_line = min(0.5 + files / 8, 4)
            stroke = f'stroke="#456" stroke-opacity="0.25" stroke-width="{width_of_line:.1f}"'
            parts.append(f'<path d="{curve}" fill="none" {stroke}/>')
    for name, (x, y) in corners.items():
        color = "#dcebdc" if name.startswith("engine/") else "#dde6f2"
        box = f'<rect x="{x:.0f}" y="{y}" width="{WIDTH}" height="{HEIGHT}" rx="4" fill="{color}" stroke="#456"/>'
        middle = f'x="{x + WIDTH / 2:.0f}" text-anchor="middle"'
        parts += [box, f'<text {middle} y="{y + 14}">{escape(name)}</text>']
        parts.append(f'<text {middle} y="{y + 28}" fill="#456" font-size="10">{lines[name]:,}</text>')
    return "\n".join([*parts, "</svg>\n"])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=PICTURE)
    parser.parse_args().out.write_text(drawn(), encoding="utf-8")


if __name__ == "__main__":
    main()
