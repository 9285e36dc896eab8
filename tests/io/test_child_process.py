"""A program beside this one that crashes, is killed, stopped or talks without end leaves this one as it was."""

import io
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.builders import refused

from frog_blender.engine.io import child_process
from frog_blender.engine.io.child_process import ChildProcess, Progress, Stopped, bounded_lines, run_in_child
from frog_blender.engine.io.paths import is_network_path

COMMAND = [sys.executable, "-m", "frog_blender.engine.io.child_process"]
posix = pytest.mark.skipif(os.name != "posix", reason="starts scripts and sends signals")
Stand = Callable[[str], None]


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stand:
    """Puts Python code in the place of the child of a task; its last argument is the task's folder."""

    def put(code: str) -> None:
        program = tmp_path / "program"
        program.write_text(f"#!{sys.executable}\nimport os, pathlib, sys, time\nfolder = sys.argv[-1]\n{code}\n")
        program.chmod(0o755)
        monkeypatch.setattr(child_process.sys, "executable", str(program))

    return put


def asked(folder: Path, path: object = "//evil/share", tell: Progress = lambda *_: None, **more: Any) -> bool:
    """What the child says of a path."""
    return run_in_child(is_network_path, path, folder=folder, progress=tell, failure=lambda end: f"it {end}.", **more)


def is_gone(process: int) -> bool:
    """Waits until a process has ended."""
    stat, deadline = Path(f"/proc/{process}/stat"), time.monotonic() + 20
    while stat.is_file() and stat.read_text().split()[2] != "Z":
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def test_the_child_answers_or_its_error_is_one_sentence(tmp_path: Path) -> None:
    assert asked(tmp_path) is True and asked(tmp_path, "mine") is False
    refused(r"it ended with status 1 .*path = 5, expected a text", asked, tmp_path, 5)


@posix
@pytest.mark.parametrize(
    ("code", "sentence"),
    [
        ("os.kill(os.getpid(), 11)", r"ended by signal 11 \(it said nothing\)"),
        ("", "said nothing"),  # a result of an earlier one is not taken for its own
        ("pathlib.Path(folder, 'result.json').write_text('[')", "a result that cannot be read"),
        ("pathlib.Path(folder, 'result.json').write_text('{\"error\": \"No video.\"}')", r"^No video\.$"),
    ],
)
def test_an_end_of_the_child_is_one_sentence(tmp_path: Path, stand_in: Stand, code: str, sentence: str) -> None:
    (tmp_path / "result.json").write_text("{}")
    stand_in(code)
    refused(sentence, asked, tmp_path)


@posix
def test_a_child_that_is_stopped_has_ended(tmp_path: Path, stand_in: Stand) -> None:
    stand_in(
        "pathlib.Path(folder, 'pid').write_text(str(os.getpid()))\n"
        'print(\'no JSON\\n{"stage": "poses", "done": 1, "total": 2}\', flush=True)\ntime.sleep(600)'
    )
    told: list[tuple[str, int, int]] = []
    with pytest.raises(Stopped):
        asked(tmp_path, tell=lambda *step: told.append(step), stopped=lambda: bool(told))
    assert told == [("poses", 1, 2)]
    assert is_gone(int((tmp_path / "pid").read_text()))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names")
def test_the_child_ends_with_its_parent(tmp_path: Path) -> None:
    """Its standard input closes when the parent is gone, however that ended."""
    os.mkfifo(tmp_path / "request.json")  # reading it waits for ever
    child = subprocess.Popen([*COMMAND, str(tmp_path)], stdin=subprocess.PIPE)
    assert child.stdin is not None
    time.sleep(0.5)
    child.stdin.close()
    assert child.wait(60) == 1


@posix
def test_it_is_killed_with_all_it_started() -> None:
    code = "import subprocess as s; print(s.Popen(['sleep', '600']).pid, flush=True); input()"
    with ChildProcess([sys.executable, "-c", code]) as child:
        started = int(next(child.lines()))
    assert child.code == -9 and is_gone(started)


@posix
def test_of_one_that_only_talks_nothing_is_left() -> None:
    """Its own child, which no signal to its group reaches, goes on with its output."""
    code = """
import os, time
if os.fork():
    time.sleep(100)
os.setsid()
end = time.monotonic() + 2
while time.monotonic() < end:
    print("and on" * 1000, flush=True)
"""
    before = set(threading.enumerate())
    with ChildProcess([sys.executable, "-c", code]) as child:
        next(child.lines())
    for thread in set(threading.enumerate()) - before:
        thread.join(20.0)
        assert not thread.is_alive()


def test_its_lines_and_its_last_words() -> None:
    code = "import sys; sys.stderr.write('x' * 10**6 + '\\nsad'); print('hello'); sys.exit(3)"
    with ChildProcess([sys.executable, "-c", code]) as child:
        assert list(child.lines()) == [f"hello{os.linesep}".encode()]
    assert child.end == "ended with status 3 (sad)"
    refused(r"no-such-program: could not be started \(", ChildProcess, ["no-such-program"])


def test_a_line_of_any_length_takes_no_more_memory_than_the_longest() -> None:
    stream = io.BytesIO(b"a\n" + b"x" * 1000 + b"\nb\n" + b"y" * 99 + b"\n" + b"z" * 100 + b"\nend")
    assert list(bounded_lines(stream, 100)) == [b"a\n", b"b\n", b"y" * 99 + b"\n", b"end"]
