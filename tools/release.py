"""Everything that a release hands out, in a folder: ``python tools/release.py [--output dist/release]``.

The sdist and the wheels (the package's and the native library's alone), the zips of both editions for this platform, a
repository's index that Blender reads, the documentation site, NOTES.md of CHANGELOG.md, and SHA256SUMS of all files.
Other platforms' wheels and zips come from .github/workflows/extension.yml and tools/cross_build.py.

The folder appears whole: what is built lies beside it until then.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import shutil
import subprocess
import sys
from pathlib import Path

from build_extension import ROOT, version

BUILD = [sys.executable, "-m", "build", "--no-isolation"]


def notes(changelog: str, of: str) -> str:
    """What a changelog says of a version, or of what is unreleased where it has no such heading; its links to docs lead
    to the site's pages.

    Raises:
        SystemExit: where it says nothing.
    """
    parts = re.split(r"^## \[([^\]]+)\].*$", changelog, flags=re.MULTILINE)
    said = dict(zip(parts[1::2], (text.strip() for text in parts[2::2]), strict=True))
    text = said.get(of) or said.get("Unreleased", "")
    if not text:
        raise SystemExit(f"CHANGELOG.md says nothing of {of}, expected a heading [{of}] or [Unreleased] with changes.")
    text = re.sub(r"\]\(docs/([\w/-]+)\.md", r"](site/\1.html", text)
    return f"# FRoG {of}\n\n{text}\n"


def checksums(folder: Path) -> str:
    """A line for each file of a folder, as ``sha256sum --check`` reads them."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return "".join(
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}\n" for path in files
    )


def run(*command: str | Path) -> None:
    if subprocess.run([str(part) for part in command], cwd=ROOT).returncode:
        raise SystemExit(f"Failed: {' '.join(map(str, command))}")


def release(folder: Path) -> None:
    """Builds all of it into an empty folder."""
    (folder / "NOTES.md").write_text(
        notes((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), version()), encoding="utf-8"
    )
    run(*BUILD, "--sdist", "--wheel", "--outdir", folder / "python", ROOT)
    run(*BUILD, "--wheel", "--outdir", folder / "python", ROOT / "packaging" / "native")
    extension = [sys.executable, ROOT / "tools" / "build_extension.py", "--output", folder / "blender"]
    run(*extension, "--index", folder / "blender" / "repository")
    run(*extension, "--edition", "player")
    run(sys.executable, "-m", "mkdocs", "build", "--quiet", "--strict", "--site-dir", folder / "site")
    (folder / "SHA256SUMS").write_text(checksums(folder), encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description="Everything that a release hands out.")
    parser.add_argument("--output", type=Path, default=ROOT / "dist" / "release", help="a folder that is made anew")
    output = parser.parse_args().output.resolve()
    if output.exists() and not (output / "SHA256SUMS").is_file():
        raise SystemExit(f"{output} is there and holds no release: nothing is deleted; name another folder.")
    work = output.with_name(f"{output.name}.unfinished")
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    release(work)
    shutil.rmtree(output, ignore_errors=True)
    work.rename(output)
    print(f"FRoG {version()}: {output}")


if __name__ == "__main__":
    main()
