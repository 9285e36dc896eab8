"""What ``make release`` hands out besides builds, which its own run tries."""

import subprocess
from pathlib import Path

import pytest
from support.builders import REPOSITORY

from frog_blender import engine

CHANGES = "# Changelog\n\n## [Unreleased]\n\n- new ([how](docs/a-b.md#c))\n\n## [0.1.0] - 2026-01-01\n\n- first\n"


@pytest.fixture(autouse=True)
def tools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(REPOSITORY / "tools")


def test_notes_are_of_the_version_or_of_what_is_unreleased() -> None:
    from release import notes

    assert notes(CHANGES, "0.1.0") == "# FRoG 0.1.0\n\n- first\n"
    assert notes(CHANGES, "0.2.0") == "# FRoG 0.2.0\n\n- new ([how](site/a-b.html#c))\n"
    with pytest.raises(SystemExit, match=r"nothing of 0\.2\.0"):
        notes("# Changelog\n", "0.2.0")


def test_checksums_are_those_that_others_check(tmp_path: Path) -> None:
    from release import checksums

    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "a b.zip").write_bytes(b"frog")
    (tmp_path / "SHA256SUMS").write_text(checksums(tmp_path))
    assert subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=tmp_path).returncode == 0


def test_the_site_has_every_page_and_every_public_name(monkeypatch: pytest.MonkeyPatch) -> None:
    yaml = pytest.importorskip("yaml")
    site = yaml.safe_load((REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8"))

    def pages(entries: list[object]) -> list[str]:
        inside = [pages(next(iter(entry.values()))) if isinstance(entry, dict) else [entry] for entry in entries]
        return [page for part in inside for page in part]

    docs = REPOSITORY / "docs"
    there = {path.relative_to(docs).as_posix() for path in [*docs.glob("*.md"), *docs.glob("experiments/*.md")]}
    assert set(pages(site["nav"])) == there | {"reference.md"}
    pytest.importorskip("mkdocs")
    from site_pages import reference

    assert [line.rsplit(".", 1)[1] for line in reference().splitlines() if line.startswith(":::")] == engine.__all__


def test_the_site_has_no_link_out_of_it() -> None:
    pytest.importorskip("mkdocs")
    from site_pages import in_table_code, without_links_out

    assert without_links_out("[a](../x.py) [b](../c.md) `d`", "sub/page.md") == "[a](../x.py) [b](../c.md) `d`"
    assert without_links_out("[a](../x.py) [b](c.md)", "page.md") == "a [b](c.md)"
    assert in_table_code(r"| `a\|b` | c \| d |") == r"| `a|b` | c \| d |"
