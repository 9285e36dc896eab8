"""Requests to end, and output that nobody takes: what a command does about them."""

import importlib
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.builders import REPOSITORY, run_python

from frog_blender.cli.terminal import leaving_cleanly, printing_may_fail, stopping

REQUESTS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]


@pytest.mark.parametrize("first", REQUESTS, ids=str)
def test_the_first_request_is_an_answer_then_ctrl_c_alone_leaves_at_once(first: int) -> None:
    before = [signal.getsignal(request) for request in REQUESTS]
    with pytest.raises(KeyboardInterrupt), stopping() as asked:
        assert not asked()
        for request in (first, *REQUESTS[1:]):
            signal.raise_signal(request)
        assert asked()
        signal.raise_signal(signal.SIGINT)
    assert [signal.getsignal(request) for request in REQUESTS] == before


def test_an_import_ends_first_as_libraries_forget_what_is_raised_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = "import signal\ntry:\n    signal.raise_signal(signal.SIGINT)\nexcept BaseException:\n    pass\nloaded = True"
    (tmp_path / "forgetful.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt), leaving_cleanly():
        assert importlib.import_module("forgetful").loaded
        began = time.monotonic()
        time.sleep(60)
    assert time.monotonic() - began < 30, "what it waited for was ended"


STARTING = """
import signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "frog_blender.cli.commands":
            signal.raise_signal(REQUEST)
sys.meta_path.insert(0, Finder())
from frog_blender.cli.main import main
sys.argv = ["frog", "recipes"]
sys.exit(main())
"""


@pytest.mark.parametrize("request_to_end", REQUESTS, ids=str)
def test_a_request_before_the_command_begins_is_a_sentence(request_to_end: int) -> None:
    ended = run_python(STARTING.replace("REQUEST", str(int(request_to_end))))
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "", "frog: interrupted.\n")


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="this system has no terminals that hang up")
def test_nohup_stays_nohup() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with leaving_cleanly(), stopping() as asked:
            signal.raise_signal(signal.SIGHUP)
            assert not asked()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_thread_that_may_set_no_signals_is_served_too() -> None:
    code = """
import threading
from frog_blender.cli.terminal import leaving_cleanly, stopping
def work():
    with leaving_cleanly(), stopping() as asked:
        print(asked())
thread = threading.Thread(target=work); thread.start(); thread.join()
"""
    assert run_python(code).stdout == "False\n"


PRINTING = """
import sys
from frog_blender.cli.terminal import printing_may_fail
with printing_may_fail():
    for number in range(20000):
        print("to nobody", number)
        print("to nobody", number, file=sys.stderr)
open(sys.argv[1], "w").write("worked on")
"""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no disk that is always full")
def test_output_that_nobody_takes_ends_nothing(tmp_path: Path) -> None:
    """A log on a full disk, and a pipe whose reader goes."""
    command = [sys.executable, "-c", PRINTING, str(tmp_path / "x")]
    with open("/dev/full", "w") as full:
        process = subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, stderr=full)
    process.stdout.readline()
    process.stdout.close()
    assert process.wait() == 0 and (tmp_path / "x").read_text() == "worked on"


def test_streams_are_as_they_were(capsys: pytest.CaptureFixture[str]) -> None:
    before = sys.stdout, sys.stderr
    with printing_may_fail():
        print("said")
        assert sys.stdout.encoding == before[0].encoding
    assert (sys.stdout, sys.stderr) == before and capsys.readouterr().out == "said\n"
