"""``frog cache``: decoded frames on this computer, how large they are and may be, and a way to delete them."""

from __future__ import annotations

import argparse
import json
import time
from datetime import datetime
from typing import Any

from ..engine.frames.limit import (
    StoredFrames,
    clear,
    limit_of,
    make_room,
    set_limit,
    stored_frames,
)
from ..engine.io.cache_folder import default_cache_folder
from .printing import say


def add_cache_parser(commands: Any) -> None:
    """Adds the command."""
    cache = commands.add_parser("cache", help="show or delete decoded frames")
    cache.add_argument("--clear", action="store_true", help="delete all that no running program has open")
    cache.add_argument(
        "--limit",
        metavar="SIZE",
        help="how large they may be from now on: 40GB, 25%% of the disk, or default",
    )
    cache.add_argument("--json", action="store_true")
    cache.set_defaults(run=_cache)


def _cache(options: argparse.Namespace) -> int:
    folder, done = default_cache_folder(), dict[str, int]()
    if options.limit is not None:
        set_limit(folder, options.limit)
        make_room(folder)
    if options.clear:
        done["freed"], done["in_use"] = clear(folder)
    entries, (limit, said) = stored_frames(folder), limit_of(folder)
    total = sum(entry.size for entry in entries)
    if options.json:
        shown = [{"capture": e.capture, "folder": str(e.folder), "bytes": e.size, "used": e.used} for e in entries]
        print(json.dumps({"folder": str(folder), "bytes": total, "limit": limit, **done, "frames": shown}, indent=1))
        return 0
    if done:
        kept = f"; {done['in_use']} in use stay" if done["in_use"] else ""
        say(f"{_size(done['freed'])} freed{kept}")
    say(f"{folder}: {_size(total)} of decoded frames, at most {_size(limit)} ({said})")
    now = time.time()
    for entry in reversed(entries):
        say(f"{_size(entry.size):>10}  {_age(entry, now):>18}  {entry.capture or entry.folder.name}")
    return 0


def _size(size: int) -> str:
    return f"{size / 1e9:.2f} GB" if size >= 1e8 else f"{size / 1e6:.1f} MB"


def _age(entry: StoredFrames, now: float) -> str:
    """When frames were used last; a number of days says more than a date of long ago."""
    days = (now - entry.used) / 86400
    if days >= 1:
        return f"{days:.0f} day{'s' if days >= 1.5 else ''} ago"
    return f"today {datetime.fromtimestamp(entry.used):%H:%M}"
