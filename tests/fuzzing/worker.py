"""Uses damaged and hostile files of one kind after the other, in a process whose end tells which it did not survive.

    python worker.py KIND FOLDER COUNT SEED [FIRST]

Prints a JSON object: how many were refused in a sentence, how many used, the peak of memory in bytes above what
undamaged files need, and the longest computing time of a file in seconds. Ends badly at the first other error, warning
of numpy, crash, or file that computes for too long; FOLDER then says which that was (``what``), and keeps it.
"""

import json
import os
import random
import resource
import signal
import sys
import time
import warnings
from abc import ABC, abstractmethod
from importlib import import_module
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from frog_blender.engine.errors import FrogError, printable
from fuzzing.mutating import mutations_of

_MOST_BYTES = 4 << 30  # where the system ends the process; tests ask for less
_MODULES = ("of_scenes", "of_files", "of_captures", "of_calibration", "of_imports")


class Kind(ABC):
    """Files of one kind.

    Attributes:
        path: where the only file lies that is damaged.
        whole: contents of undamaged ones, by where one is put.
        seconds: that using one may take.
        warnings: what a warning of numpy is: "error" where numbers are only read.
    """

    path: Path
    whole: dict[Path, list[bytes]]
    seconds = 10
    warnings = "error"

    @abstractmethod
    def __init__(self, folder: Path) -> None: ...

    @abstractmethod
    def use(self) -> bool:
        """True where the file was taken for what it says; FrogError, or False, where it was not."""

    def keep(self, path: Path, *contents: bytes) -> None:
        """Contents of undamaged files, of which the only one lies at ``path``; by default what lies there."""
        self.path = path
        self.whole = {path: list(contents) or [path.read_bytes()]}


def limit_time(seconds: int) -> None:
    """A file that hangs ends the process: by computing time, for the machine may be busy, and in the end by a clock."""
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.alarm(60 * seconds)


def used(kind: Kind) -> bool:
    try:
        return kind.use()
    except FrogError as error:
        sentence = str(error)
        assert sentence == printable(sentence) and len(sentence) < 1500, sentence
        return False


def peak() -> int:
    return (1 if sys.platform == "darwin" else 1024) * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def kind_of(name: str) -> type[Kind]:
    """By its name in the table ``KINDS`` of one of the modules."""
    modules = ("of_scenes_in_blender",) if name == "blender" else _MODULES
    tables = (import_module(f"fuzzing.{module}").KINDS for module in modules)
    return next(table[name] for table in tables if name in table)


def main() -> None:
    name, folder, count, seed, first = sys.argv[1], Path(sys.argv[2]), *(int(text) for text in [*sys.argv[3:], "0"][:3])
    folder.mkdir(parents=True, exist_ok=True)
    kind = kind_of(name)(folder)
    warnings.simplefilter(kind.warnings)
    for path, contents in kind.whole.items():
        for content in contents:
            path.write_bytes(content)
            assert used(kind), f"{path} is undamaged"
    before, taken, longest = peak(), 0, 0.0
    if "ASAN_OPTIONS" not in os.environ:  # a sanitizer's memory is not counted
        resource.setrlimit(resource.RLIMIT_DATA, (before + _MOST_BYTES, resource.RLIM_INFINITY))
    for number in range(first, first + count):
        chance = random.Random(f"{seed}/{number}")
        path = chance.choice(list(kind.whole))
        mutation = chance.choice(mutations_of(path))
        path.write_bytes(mutation(chance.choice(kind.whole[path]), chance))
        (folder / "what").write_text(f"{name}, seed {seed}, file {number}, {path}, {mutation.__name__}")
        limit_time(kind.seconds)
        began = time.process_time()
        taken += used(kind)
        longest = max(longest, time.process_time() - began)
        signal.setitimer(signal.ITIMER_PROF, 0)
        path.write_bytes(kind.whole[path][0])
    signal.alarm(0)
    print(json.dumps({"refused": count - taken, "used": taken, "peak": peak() - before, "longest": longest}))


if __name__ == "__main__":
    main()
