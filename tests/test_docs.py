"""The pages under docs/: what they link to and quote is there, and they stay short."""

import re
from pathlib import Path

import pytest
from support.builders import REPOSITORY

from frog_blender.cli.main import main

DOCS = REPOSITORY / "docs"
PACKAGE = REPOSITORY / "frog_blender"
PAGES = [REPOSITORY / "README.md", *sorted(DOCS.glob("*.md"))]
EXPERIMENTS = sorted((DOCS / "experiments").glob("*.md"))


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def words(text: str) -> int:
    """Code, rules of tables and list marks are none."""
    return sum(1 for word in re.sub(r"^```.*?^```", "", text, flags=re.S | re.M).split() if re.search(r"\w", word))


def anchors(page: Path) -> set[str]:
    """Of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", text_of(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", [*PAGES, *EXPERIMENTS], ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!http)([^)]+)\)", re.sub(r"^```.*?^```", "", text_of(page), flags=re.S | re.M)):
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        assert file.exists(), target
        assert not anchor or anchor in anchors(file), target


def test_every_page_is_in_the_index() -> None:
    index = text_of(DOCS / "index.md")
    for page in [*PAGES[1:], *EXPERIMENTS]:
        assert page.name == "index.md" or f"({page.relative_to(DOCS)})" in index.replace("\\", "/"), page.name


def test_pages_that_the_code_names_are_there() -> None:
    sources = [
        path for path in (REPOSITORY / "frog_blender").rglob("*.*") if path.suffix in (".py", ".inl", ".cpp", ".h")
    ]
    named = {name for path in sources for name in re.findall(r"docs/[\w/-]+\.md", text_of(path))}
    assert named and [name for name in sorted(named) if not (REPOSITORY / name).is_file()] == []


def test_every_image_is_shown() -> None:
    shown = "".join(text_of(page) for page in [*PAGES, *EXPERIMENTS])
    assert [image.name for image in DOCS.glob("images/**/*.*") if f"{image.name})" not in shown] == []


def test_the_picture_of_the_rooms_shows_those_that_there_are() -> None:
    folders = {path.parent.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py")}
    rooms = {room for room in folders if room.count("/") == room.startswith("engine/") and room not in (".", "engine")}
    shown = set(re.findall(r">([a-z_/]+)</text>", text_of(DOCS / "images/rooms.svg")))
    assert len(rooms) > 20 and rooms == shown, "draw it again: python tools/room_map.py"


def test_pages_are_short() -> None:
    assert sum(words(text_of(page)) for page in PAGES if page.parent == DOCS) <= 10_000
    assert words(text_of(DOCS / "concepts.md")) <= 1_500
    assert sum(words(text_of(page)) for page in EXPERIMENTS) <= 15_000


def test_what_troubleshooting_quotes_is_said() -> None:
    sources = "".join(text_of(path) for path in sorted((REPOSITORY / "frog_blender").rglob("*.py")))
    said = re.sub(r'"\s+f?"', "", sources)  # a literal in several pieces
    quotes = re.findall(r'"([^"]+)"', text_of(DOCS / "troubleshooting.md"))
    pieces = [piece.strip() for quote in quotes for piece in quote.split("...") if piece.strip()]
    assert pieces and [piece for piece in pieces if piece not in said] == []


def options_of(command: str, capsys: pytest.CaptureFixture[str]) -> set[str]:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    return set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out)) - {"--help"}


def test_options_of_commands(capsys: pytest.CaptureFixture[str]) -> None:
    page = text_of(DOCS / "cli.md")
    sections = dict(re.findall(r"^## frog ([a-z]+)$(.+?)(?=^## )", page, re.M | re.S))
    assert sections.keys() >= {"train", "info", "eval", "chart", "stability"}
    for command, body in sections.items():
        assert set(re.findall(r"--[a-z][a-z-]+", body)) <= options_of(command, capsys), command
    assert options_of("train", capsys) <= set(re.findall(r"--[a-z][a-z-]+", sections["train"]))
