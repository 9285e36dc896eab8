"""Trainings by a command: what is started, and what becomes of what it says, whatever that is."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import threading
import time
from pathlib import Path

import bpy
import pytest
from support.builders import REPOSITORY
from support.option_examples import EXAMPLES

from frog_blender.cli.main import _parser
from frog_blender.cli.train_command import _options_of
from frog_blender.engine.errors import FrogError
from frog_blender.engine.options import OPTIONS, Door, TrainingOptions
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.cancel_token import CancelToken
from frog_blender.engine.training.session.events import line_of
from frog_blender.tasks.remote_training import RemoteCommand, RemoteTraining, options_of
from frog_blender.tasks.training_request import TrainingRequest

WHOLE = "train {capture} --out {output} --events {options}"
ODD = "/cap tures/it's; $(touch x) {output}"
posix = pytest.mark.skipif(os.name != "posix", reason="needs a POSIX shell")


def request(capture="/captures/room", output="/out/room.frog", **options):
    return TrainingRequest(Path(capture), Path(output), TrainingOptions(recipe="draft", **options))


def test_placeholders_become_arguments_as_they_are():
    asked = request(ODD, steps=12)
    found = RemoteCommand("frog train {capture} --out={output} 'a b' --events {options}").arguments(asked)
    assert found == ["frog", "train", ODD, "--out=/out/room.frog", "a b", "--events", *options_of(asked)]


@posix
@pytest.mark.parametrize("over", ["ssh", "/usr/bin/ssh", "nice ssh -p 22"])
def test_the_shell_behind_ssh_reads_what_was_meant(over):
    asked = request(ODD, key="#00b140,0.40")
    for words in ("printf %s, {capture} {output} {options}", '"printf %s, {capture} {output} {options}"'):
        found = RemoteCommand(f"{over} gpu {words}").arguments(asked)
        joined = " ".join(found[found.index("gpu") + 1 :])  # as ssh does
        said = subprocess.run(["sh", "-c", joined], capture_output=True, text=True, check=True).stdout
        assert said == "".join(f"{each}," for each in (ODD, "/out/room.frog", *options_of(asked)))


@posix
def test_words_within_an_argument_are_quoted_for_the_shell_that_reads_them():
    asked = request(ODD)
    found = RemoteCommand("sh -c 'printf %s, {capture} {output} {options}'").arguments(asked)
    said = subprocess.run(found, capture_output=True, text=True, check=True).stdout
    assert said == "".join(f"{each}," for each in (ODD, "/out/room.frog", *options_of(asked)))


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (RemoteCommand(" "), "needs a Remote Command"),
        (RemoteCommand("frog 'train"), "cannot be read"),
        (RemoteCommand("{capture} {output} {options}"), "lacks {capture}"),
        (RemoteCommand("frog train {capture}"), r"lacks \{output\} and \{options\}"),
        (RemoteCommand(f"frog {WHOLE}", "/here"), "both a Local Folder and a Remote Folder"),
    ],
)
def test_what_is_no_command_is_a_sentence(command, sentence):
    with pytest.raises(FrogError, match=sentence.replace("{capture}", r"\{capture\}")):
        command.arguments(request())


@pytest.mark.parametrize("there", ["/data", "/data/", "D:\\data"])
def test_a_folder_has_two_names(there):
    command = RemoteCommand(f"frog {WHOLE}", "/mnt/shared", there)
    plain = there.rstrip("/")
    assert command.there(Path("/mnt/shared/a b/room")) == f"{plain}/a b/room"
    assert command.there(Path("/mnt/sharedness/room")) == "/mnt/sharedness/room"
    assert command.here(f"{plain}/out/x.frog") == Path("/mnt/shared/out/x.frog")
    assert command.here("D:\\data\\x.frog" if "D" in there else "/data/x.frog") == Path("/mnt/shared/x.frog")
    assert command.here("/elsewhere/x.frog") == Path("/elsewhere/x.frog")
    assert command.is_there(f"{plain}/x.frog", Path("/mnt/shared/x.frog"))


def test_the_command_is_told_every_option():
    for name, (value, _) in EXAMPLES.items():
        asked = TrainingOptions(**{name: value})
        words = options_of(TrainingRequest(Path("x"), Path("x.frog"), asked))
        found, _ = _options_of(_parser().parse_args(["train", "x", "--out", "x.frog", *words]))
        assert found == (TrainingOptions() if Door.REMOTE in OPTIONS[name].without else asked), name
    assert options_of(request(steps=20, scale=0.5, resume=True)) == ["--steps=20", "--resume"]


def by_script(tmp_path, code, patience=20.0, **job):
    """A training by a program that does this, with ``tell(event)`` for lines."""
    script = tmp_path / "train.py"
    tell = f"import sys, time\nsys.path.insert(0, {str(REPOSITORY)!r})\nout = sys.argv[2]\n"
    script.write_text(tell + code)
    text = f"{shlex.quote(sys.executable)} {shlex.quote(str(script))} {{capture}} {{output}} {{options}}"
    return RemoteTraining(RemoteCommand(text), request(tmp_path, tmp_path / "x.frog", **job), patience)


def prints(*said):
    return "".join(f"print({line_of(event)!r}, flush=True)\n" for event in said)


def finished(tmp_path):
    return events.Finished(str(tmp_path / "x.frog"), 5, 1.0, 30.0, 40)


def test_a_scene_that_is_copied_after_the_training(tmp_path):
    """The last event waits for the command, which may have more to do."""
    done = prints(events.Progress(5, 5, 1.0, 0.0, 0.1, 40), finished(tmp_path))
    training = by_script(tmp_path, f"{done}time.sleep(0.3)\nopen(out, 'w').close()\n")
    said = list(training.events(CancelToken()))
    assert said[-1] == finished(tmp_path) and isinstance(said[0], events.Progress)


def test_a_scene_that_stays_there_is_said(tmp_path):
    training = by_script(tmp_path, f"{prints(finished(tmp_path))}sys.exit('scp: no route to host')")
    said = []
    with pytest.raises(FrogError, match=r"x\.frog: the scene is trained, but .* status 1 \(scp: no route to host\)"):
        said.extend(training.events(CancelToken()))
    training = by_script(tmp_path, prints(events.Cancelled(3, "/gone.frog")))
    assert list(training.events(CancelToken()))[1:] == [events.Cancelled(3, None)]


def test_a_command_that_does_not_exist(tmp_path):
    training = RemoteTraining(RemoteCommand("no-such-program {capture} {output} {options}"), request())
    with pytest.raises(FrogError, match=r"no-such-program: could not be started \(No such file"):
        list(training.events(CancelToken()))


@pytest.mark.parametrize(
    ("code", "sentence"),
    [
        ("sys.exit('frog: x: found nothing, expected videos.')", r"status 1 \(x: found nothing, expected videos\)\.$"),
        ("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)", r"signal 9 \(it said nothing\)"),
        ("print('Welcome!')", "did not tell how the training ended .* has to run frog train with --events"),
        ("sys.stderr.write('x' * 10**6 + '\\nlast')\nsys.exit(3)", r"status 3 \(last\)"),
        ("sys.stderr.buffer.write(b'\\xff\\x1b[2J')\nsys.exit(3)", r"status 3 \(.*x1b\[2J\)"),
    ],
)
def test_a_command_that_fails_is_a_sentence(tmp_path, code, sentence):
    with pytest.raises(FrogError, match=sentence) as caught:
        list(by_script(tmp_path, code).events(CancelToken()))
    assert "\n" not in str(caught.value)


def test_a_command_that_prints_anything(tmp_path):
    code = f"""
import random
random.seed(4)
write = sys.stdout.buffer.write
for _ in range(200):
    write(random.randbytes(random.randrange(300)) + b"\\n")
write(b"x" * (3 * 2**23) + b"\\n")
write(b"[" * 100000 + b"\\n" + b'{{"event": "preview", "step": 1, "image": {{}}}}\\n')
sys.stdout.flush()
open(out, "w").close()
{prints(finished(tmp_path))}
write(b"no end")
"""
    assert list(by_script(tmp_path, code).events(CancelToken())) == [finished(tmp_path)]


def test_only_so_many_sentences_are_kept(tmp_path):
    code = f"""
for _ in range(1200):
    print({line_of(events.WarningEvent("Beware."))!r})
{prints(events.Progress(5, 5, 1.0, 0.0, 0.1, 40), events.Cancelled(5, None))}
"""
    said = list(by_script(tmp_path, code).events(CancelToken()))
    assert len(said) == 1002 and said[-2:] == [events.Progress(5, 5, 1.0, 0.0, 0.1, 40), events.Cancelled(5, None)]


def test_wishes_are_lines_and_the_end_is_that_of_the_input(tmp_path):
    code = f"""
with open(out, "w") as kept:
    for line in sys.stdin:
        kept.write(line)
        kept.flush()
{prints(events.Cancelled(7, str(tmp_path / "x.frog")))}
sys.exit(1)
"""
    training, control, said = by_script(tmp_path, code, preview_camera="cam02"), CancelToken(), []
    follower = threading.Thread(target=lambda: said.extend(training.events(control)))
    follower.start()

    def heard(lines):
        deadline = time.monotonic() + 20
        while not ((tmp_path / "x.frog").is_file() and (tmp_path / "x.frog").read_text() == lines):
            assert time.monotonic() < deadline
            time.sleep(0.01)

    heard("preview cam02\n")
    control.pause()
    heard("preview cam02\npause\n")
    control.resume()
    heard("preview cam02\npause\nresume\n")
    control.preview_camera = "a\nresume"
    heard("preview cam02\npause\nresume\npreview a resume\n")
    control.pause()
    control.cancel()
    follower.join(20)
    assert said == [events.Cancelled(7, str(tmp_path / "x.frog"))]


@pytest.mark.parametrize("way", ["cancelled", "killed"])
def test_a_command_that_does_not_end_is_killed_with_all_it_started(tmp_path, way):
    code = f"""
import subprocess
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(100)"])
{prints(events.Progress(3, 9, 1.0, 1.0, 0.1, 40))}
with open(out, "w") as kept:
    kept.write(str(child.pid))
time.sleep(100)
"""
    training, control, said = by_script(tmp_path, code, patience=0.2), CancelToken(), []
    follower = threading.Thread(target=lambda: said.extend(training.events(control)))
    follower.start()
    deadline = time.monotonic() + 20
    while not ((tmp_path / "x.frog").is_file() and (tmp_path / "x.frog").read_text()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    control.cancel()
    if way == "killed":
        training.kill()
    follower.join(20)
    assert not follower.is_alive() and said[-1] == events.Cancelled(3, None)
    assert any("did not end within 0 seconds" in str(event) for event in said) == (way == "cancelled")
    if os.name == "posix":
        child = Path(f"/proc/{(tmp_path / 'x.frog').read_text()}/stat")
        while child.is_file() and child.read_text().split()[2] != "Z":
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_cancelled_before_it_began(tmp_path):
    control = CancelToken()
    control.cancel()
    assert list(by_script(tmp_path, "open(out, 'w')").events(control)) == [events.Cancelled(0, None)]
    assert not (tmp_path / "x.frog").exists()


@pytest.fixture
def real(tmp_path, filmed, own_cache, monkeypatch):
    """A training of the filmed scene by this Python, with the output's folder under another name."""
    pytest.importorskip("torch")
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY))
    (tmp_path / "here").mkdir()
    (tmp_path / "there").symlink_to(tmp_path / "here")
    text = f"{shlex.quote(sys.executable)} -m frog_blender.cli {WHOLE} --device cpu"
    command = RemoteCommand(text, str(tmp_path / "here"), str(tmp_path / "there"))

    def create(steps):
        return RemoteTraining(command, request(filmed, tmp_path / "here" / "x.frog", steps=steps, max_gaussians=250))

    return create


def test_a_real_training(real, tmp_path):
    said = list(real(30).events(CancelToken()))
    kinds = {type(event) for event in said}
    assert {events.Started, events.Progress, events.Evaluated, events.Preview, events.Saved} <= kinds
    assert isinstance(said[-1], events.Finished) and said[-1].path == str(tmp_path / "here" / "x.frog")
    assert Path(said[-1].path).is_file() and said[-1].steps == 30


def test_a_real_training_is_cancelled(real, tmp_path):
    control, said = CancelToken(), []
    for event in real(100_000).events(control):
        said.append(event)
        if isinstance(event, events.Progress) and event.step > 20:
            control.cancel()
    assert isinstance(said[-1], events.Cancelled) and said[-1].path == str(tmp_path / "here" / "x.frog")
    assert said[-1].step > 20 and (tmp_path / "here" / "x.frog.checkpoint").is_file()


PARENT = """
import sys
from pathlib import Path
from frog_blender.engine.options import TrainingOptions
from frog_blender.engine.training.session.cancel_token import CancelToken
from frog_blender.tasks.remote_training import RemoteTraining
from frog_blender.tasks.remote_training import RemoteCommand
from frog_blender.tasks.training_request import TrainingRequest
options = TrainingOptions(recipe="draft", max_gaussians=250, steps=1000000)
request = TrainingRequest(Path(sys.argv[2]), Path(sys.argv[3]), options)
for event in RemoteTraining(RemoteCommand(sys.argv[1]), request).events(CancelToken()):
    print(type(event).__name__, flush=True)
"""


def test_a_blender_that_is_killed_leaves_no_training(tmp_path, filmed, own_cache, monkeypatch):
    """The command's input ends with it: the training saves what it has, and ends."""
    pytest.importorskip("torch")
    if bpy.app.binary_path:
        pytest.skip("a real Blender runs no second interpreter with bpy")
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY))
    text = f"{shlex.quote(sys.executable)} -m frog_blender.cli {WHOLE} --device cpu"
    command = [sys.executable, "-c", PARENT, text, str(filmed), str(tmp_path / "x.frog")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        patience = threading.Timer(60.0, parent.kill)
        patience.start()
        while parent.stdout.readline() not in ("Progress\n", ""):
            pass
        patience.cancel()
        parent.kill()
    deadline = time.monotonic() + 60
    while not (tmp_path / "x.frog").is_file():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert (tmp_path / "x.frog.checkpoint").is_file()
