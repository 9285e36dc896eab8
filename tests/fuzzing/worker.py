"""Uses mutated scenes one after the other, in a process whose end tells which file it did not survive.

    python worker.py FOLDER SEED FIRST COUNT [blender]

Prints a JSON object: how many were refused, how many used, the peak of memory in bytes above what undamaged files need,
and the longest computing time of a file in seconds. FOLDER keeps the file that a crash came of, as ``x.frog``.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from fuzzing.mutating import mutated
from fuzzing.scenes import kinds, whole_files

_MOST_SECONDS, _MOST_BYTES = 60, 4 << 30  # where the system ends the process; tests ask for less


def _use_of(kind: str) -> Callable[[Path, Path], bool]:
    if kind == "blender":
        from fuzzing.using_in_blender import use
    else:
        from fuzzing.using import use
    return use


def _peak() -> int:
    return (1 if sys.platform == "darwin" else 1024) * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    folder, seed, first, count = Path(sys.argv[1]), *(int(text) for text in sys.argv[2:5])
    folder.mkdir(parents=True, exist_ok=True)
    use = _use_of(sys.argv[5] if len(sys.argv) > 5 else "")
    warnings.simplefilter("ignore")
    path, whole = folder / "x.frog", whole_files(kinds())
    for content in whole:
        path.write_bytes(content)
        assert use(path, folder / "out")
    before, used, longest = _peak(), 0, 0.0
    if hasattr(resource, "RLIMIT_DATA") and "ASAN_OPTIONS" not in os.environ:  # a sanitizer's memory is not counted
        resource.setrlimit(resource.RLIMIT_DATA, (before + _MOST_BYTES, resource.RLIM_INFINITY))
    for number in range(first, first + count):
        how, content = mutated(whole, seed, number)
        path.write_bytes(content)
        (folder / "what").write_text(f"seed {seed}, file {number}, {how}")
        signal.setitimer(signal.ITIMER_PROF, _MOST_SECONDS)  # ends the process; computing time, not that of a clock
        signal.alarm(10 * _MOST_SECONDS)
        began = time.process_time()
        used += use(path, folder / "out")
        longest = max(longest, time.process_time() - began)
    signal.setitimer(signal.ITIMER_PROF, 0)
    signal.alarm(0)
    print(json.dumps({"refused": count - used, "used": used, "peak": _peak() - before, "longest": longest}))


if __name__ == "__main__":
    main()
