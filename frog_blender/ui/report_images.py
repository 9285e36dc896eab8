"""The images of a calibration's report, for the panel."""

from __future__ import annotations

import base64
import binascii
import tempfile
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from ..engine.capture.video import read_image
from ..engine.errors import FrogError
from . import preview_image

RIG, CURVES = "calibration rig", "calibration curves"
"""Names of the images in ``preview_image``."""
_WORDS = {RIG: ("rig", "above"), CURVES: ("synchron", "offset", "clock")}
_MOST_BYTES = 2**26


class _Images(HTMLParser):
    """Collects the images of a page: what they show, and where they are."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "img":
            known = dict(attrs)
            self.found.append(((known.get("alt") or "").lower(), known.get("src") or ""))


def show(page: Path | None) -> None:
    """Shows the rig and the synchronisation curves of a report's page, those that it has; None shows none."""
    images = _images(page) if page is not None else []
    for name, words in _WORDS.items():
        source = next((source for text, source in images if any(word in text for word in words)), None)
        preview_image.show(_image(page, source) if page is not None and source else None, name)


def _images(page: Path) -> list[tuple[str, str]]:
    try:
        if page.stat().st_size > _MOST_BYTES:
            return []
        parser = _Images()
        parser.feed(page.read_text(encoding="utf-8", errors="replace"))
    except OSError:
        return []
    return parser.found


def _image(page: Path, source: str) -> np.ndarray | None:
    """An image that lies in the page, or in a file of its folder; None if there is none that can be read."""
    try:
        if not source.startswith("data:"):
            return read_image(page.parent / Path(source).name)
        head, _, content = source.partition(",")
        if not head.endswith(";base64"):
            return None
        with tempfile.TemporaryDirectory(prefix="frog-report-", ignore_cleanup_errors=True) as folder:
            path = Path(folder) / "image"
            path.write_bytes(base64.b64decode(content))
            return read_image(path)
    except (FrogError, OSError, binascii.Error, ValueError):
        return None
