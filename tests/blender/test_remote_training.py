"""Trainings by a command: what is started, what becomes of what it says, and the device Remote in the panel."""

import os
import shlex
import subprocess
import sys
import threading
from pathlib import Path

import bpy
import pytest
from support.builders import REPOSITORY, refused, refuses, until
from support.option_examples import EXAMPLES
from support.training_panel import finish, panel_says

from frog_blender.cli.commands import _parser
from frog_blender.cli.train_command import _options_of
from frog_blender.engine.errors import FrogError
from frog_blender.engine.options import OPTIONS, Door, TrainingOptions
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.cancel_token import CancelToken
from frog_blender.engine.training.session.events import line_of
from frog_blender.tasks import background_task
from frog_blender.tasks.remote_training import RemoteCommand, RemoteTraining, options_of
from frog_blender.tasks.training import TrainingTask
from frog_blender.tasks.training_request import TrainingRequest, steps_done
from frog_blender.timeline import playback
from frog_blender.ui import torch_environment, train_panel

WHOLE = "train {capture} --out {output} --events {options}"
PYTHON = shlex.quote(sys.executable)
REAL = f"{PYTHON} -m frog_blender.cli {WHOLE} --device cpu"
ODD = "/cap tures/it's; $(touch x) {output}"
posix = pytest.mark.skipif(os.name != "posix", reason="needs a POSIX shell")


def request(capture="/captures/room", output="/out/room.frog", **options):
    return TrainingRequest(Path(capture), Path(output), TrainingOptions(recipe="draft", **options))


@posix
@pytest.mark.parametrize(
    "start", ["ssh gpu", "autossh -M 0 -tt me@gpu", "/opt/ssh -p22 -i key gpu", "plink -batch gpu"]
)
def test_the_other_computers_shell_reads_what_was_meant(start):
    asked = request(ODD, preview_camera="$(touch x) 'a'")
    words = RemoteCommand(f"{start} frog {{capture}} --out={{output}} {{options}}").arguments(asked)
    far = " ".join(words[words.index("frog") :])  # ssh joins its words for the shell there
    said = subprocess.run(["sh", "-c", f'frog() {{ printf "%s," "$@"; }}; {far}'], capture_output=True, text=True)
    assert said.stdout == "".join(f"{word}," for word in (ODD, "--out=/out/room.frog", *options_of(asked)))


def test_words_without_a_shell_are_as_they_are():
    asked, behind = request(ODD), ["--out=/out/room.frog", "--end-with-input", "--recipe=draft"]
    for start in ("frog train", "/opt/my\\ env/python3.11 -m frog_blender.cli train"):
        words = RemoteCommand(f"{start} {{capture}} --out={{output}} {{options}}").arguments(asked)
        assert words[-4:] == [ODD, *behind]
    opaque = ("mosh gpu -- frog", "ssh gpu ssh inner frog", "ssh gpu eval frog", "ssh -? gpu frog", "sh -c 'a $1' a")
    for start in opaque:
        command = RemoteCommand(f"{start} {{capture}} --out={{output}} {{options}}")
        assert command.arguments(request())[-4:] == ["/captures/room", *behind]
        for path in ("/a b", "/a;b", "/a$b", "/a\nb", "/\udcff", ODD):
            refused("may hand this to a shell", command.arguments, request(path))
    with pytest.raises(FrogError, match="may hand this to a shell"):  # of a system that quotes otherwise
        RemoteCommand(f"ssh gpu frog {WHOLE}", "/a", "C:\\a").arguments(request("/a/b & calc"))
    assert "C:/a/b" in RemoteCommand(f"ssh gpu frog {WHOLE}", "/a", "C:\\a").arguments(request("/a/b"))


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (RemoteCommand(" "), "needs a Remote Command"),
        (RemoteCommand("frog 'train"), "cannot be read"),
        (RemoteCommand("{capture} {output} {options}"), "lacks {capture}"),
        (RemoteCommand("frog train {capture}"), r"lacks \{output\} and \{options\}"),
        (RemoteCommand(f"frog {WHOLE}", "/here"), "both a Local Folder and a Remote Folder"),
        (RemoteCommand(f"{{capture}}/x {WHOLE}"), "not within quotes"),
        (RemoteCommand(f"sh -c '{WHOLE}'"), "not within quotes"),
        (RemoteCommand("frog `{capture}` {output} {options}"), "not within quotes"),
        (RemoteCommand("frog {capture} {output} x{options}"), "not within quotes"),
    ],
)
def test_what_is_no_command_is_a_sentence(command, sentence):
    refused(sentence.replace("{capture}", r"\{capture\}"), command.arguments, request())


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
        options, _ = _options_of(_parser().parse_args(["train", "x", "--out", "x.frog", *words]))
        assert options == (TrainingOptions() if Door.REMOTE in OPTIONS[name].without else asked), name
    assert options_of(request(steps=20, scale=0.5, resume=True)) == ["--end-with-input", "--steps=20", "--resume"]


def by_script(tmp_path, code, patience=20.0, **job):
    """A training by a program that does this, with ``tell(event)`` for lines."""
    script = tmp_path / "train.py"
    tell = f"import sys, time\nsys.path.insert(0, {str(REPOSITORY)!r})\nout = sys.argv[2]\n"
    script.write_text(tell + code)
    text = f"{PYTHON} {shlex.quote(str(script))} {{capture}} {{output}} {{options}}"
    return RemoteTraining(RemoteCommand(text), request(tmp_path, tmp_path / "x.frog", **job), patience)


def prints(*said):
    return "".join(f"print({line_of(event)!r}, flush=True)\n" for event in said)


def finished(tmp_path):
    return events.Finished(str(tmp_path / "x.frog"), 5, 1.0, 30.0, 40)


def followed(training, control):
    """A thread that follows a training, and the events that it hears."""
    said = []
    follower = threading.Thread(target=lambda: said.extend(training.events(control)))
    follower.start()
    return follower, said


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
    for path in ("/gone.frog", "x" * 3000, "a\0b"):
        training = by_script(tmp_path, prints(events.Cancelled(3, path)))
        assert list(training.events(CancelToken()))[1:] == [events.Cancelled(3, None)]
        with pytest.raises(FrogError, match="its file is not on this computer") as caught:
            list(by_script(tmp_path, prints(events.Finished(path, 5, 1.0, 30.0, 40))).events(CancelToken()))
        assert len(str(caught.value)) < 400


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
    refused(sentence, list, by_script(tmp_path, code).events(CancelToken()))


def test_a_command_that_prints_anything(tmp_path):
    code = f"""
import os
open(out, "w").close()
os.write(1, os.urandom(10_000) + b"\\n" + b"[" * 100_000 + b"\\n")
{prints(finished(tmp_path))}
os.write(1, b"no end")
"""
    assert list(by_script(tmp_path, code).events(CancelToken())) == [finished(tmp_path)]


def test_wishes_are_lines_and_the_end_is_that_of_the_input(tmp_path):
    code = f"""
with open(out, "w") as kept:
    for line in sys.stdin:
        kept.write(line)
        kept.flush()
{prints(events.Cancelled(7, str(tmp_path / "x.frog")))}
sys.exit(1)
"""
    control = CancelToken()
    follower, said = followed(by_script(tmp_path, code, preview_camera="cam02"), control)

    def heard(lines):
        until(lambda: (tmp_path / "x.frog").is_file() and (tmp_path / "x.frog").read_text() == lines)

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


@pytest.mark.parametrize("end", ["cancelled", "killed"])
def test_a_command_that_does_not_end_is_killed_with_all_it_started(tmp_path, end):
    code = f"""
import subprocess
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(100)"])
{prints(events.Progress(3, 9, 1.0, 1.0, 0.1, 40))}
with open(out, "w") as kept:
    kept.write(str(child.pid))
time.sleep(100)
"""
    training, control = by_script(tmp_path, code, patience=0.2), CancelToken()
    follower, said = followed(training, control)
    until(lambda: (tmp_path / "x.frog").is_file() and (tmp_path / "x.frog").read_text())
    control.cancel()
    if end == "killed":
        training.kill()
    follower.join(20)
    assert not follower.is_alive() and said[-1] == events.Cancelled(3, None)
    assert any("did not end within 0 seconds" in str(event) for event in said) == (end == "cancelled")
    if os.name == "posix":
        child = Path(f"/proc/{(tmp_path / 'x.frog').read_text()}/stat")
        until(lambda: not child.is_file() or child.read_text().split()[2] == "Z")


def test_cancelled_before_it_began(tmp_path):
    control = CancelToken()
    control.cancel()
    assert list(by_script(tmp_path, "open(out, 'w')").events(control)) == [events.Cancelled(0, None)]
    assert not (tmp_path / "x.frog").exists()


@pytest.fixture
def chosen(empty, filmed, own_cache, tmp_path, monkeypatch):
    """The add-on's preferences, as in a Blender that has it installed, and the device Remote for a small training."""
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY))
    addon = bpy.context.preferences.addons.new()
    addon.module = torch_environment.base_package
    settings = empty.frog
    settings.capture_folder, settings.output_path, settings.device = str(filmed), str(tmp_path / "here.frog"), "remote"
    settings.recipe, settings.max_gaussians = "draft", 250
    yield addon.preferences
    bpy.context.preferences.addons.remove(addon)


def drawn():
    return panel_says(train_panel.FROG_PT_train)


def test_without_a_command_it_is_grey_and_says_why(chosen, monkeypatch):
    settings = bpy.context.scene.frog
    assert "Roughly" not in drawn()
    assert "needs a Remote Command" in drawn() and not bpy.ops.frog.train.poll()
    refuses("needs a Remote Command in the add-on's preferences", bpy.ops.frog.train)
    chosen.remote_command = f"frog {WHOLE}"
    monkeypatch.setattr(torch_environment, "torch_needed", lambda: "There is no torch.")
    assert bpy.ops.frog.train.poll() and "no torch" not in drawn()
    settings.device = "cpu"
    assert not bpy.ops.frog.train.poll() and "There is no torch." in drawn()


def test_cancelled_from_the_panel_and_trained_on_until_the_scene_is_imported(chosen, tmp_path, monkeypatch):
    """By this Python, which calls the output's folder by another name. Here torch is not even looked for."""
    pytest.importorskip("torch")
    monkeypatch.setattr(torch_environment, "make_torch_importable", lambda: pytest.fail("not needed"))
    scene, output = bpy.context.scene, tmp_path / "here" / "x.frog"
    output.parent.mkdir()
    (tmp_path / "there").symlink_to(output.parent)
    settings = scene.frog
    settings.output_path, settings.steps = str(output), 10**6
    chosen.remote_command = REAL
    chosen.remote_local_folder, chosen.remote_folder = str(output.parent), str(tmp_path / "there")
    assert bpy.ops.frog.train() == {"FINISHED"}
    task = TrainingTask.current()
    assert "frog.pause_training" in drawn() and "show_live" not in drawn()
    while not task.state.step:
        assert background_task.tick() is not None, task.error
    assert bpy.ops.frog.cancel_training() == {"FINISHED"}
    finish(task)
    assert task.is_cancelled and not task.error and task.state.result == output and output.is_file()
    assert "Import What There Is" not in drawn() and "frog.train" in drawn()

    settings.steps = steps_done(settings) + 20
    seen, take = [], TrainingTask.apply
    monkeypatch.setattr(TrainingTask, "apply", lambda self, event: (seen.append(type(event)), take(self, event)))
    assert bpy.ops.frog.train(resume=True) == {"FINISHED"}
    task = TrainingTask.current()
    assert task.join(120.0)
    while background_task.tick() is not None:
        pass
    state = task.state
    assert not task.error and not task.note and state.step == settings.steps and state.preview is not None
    assert {events.Started, events.Evaluated, events.Saved} <= set(seen) and state.psnr and state.capacity
    assert state.result == output and state.result_bytes == output.stat().st_size
    assert [playback.file_of(obj) for obj in playback.captures(scene.objects)] == [output]
    assert "Finished in" in drawn()
