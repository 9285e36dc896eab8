"""A training elsewhere: the command that starts it, and its events, followed as if it trained in this Blender."""

import os
import re
import shlex
import time
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from getopt import GetoptError, getopt
from pathlib import Path, PurePath

from ..engine.errors import FrogError, brief, printable
from ..engine.io.child_process import ChildProcess, Stopped
from ..engine.options import Door, Resume, options_at
from ..engine.setting import text_of
from ..engine.training.session import events
from ..engine.training.session.cancel_token import CancelToken
from ..engine.training.session.events import Event, event_of
from .training_request import TrainingRequest

PLACEHOLDERS = ("{capture}", "{output}", "{options}")
_ANY = re.compile("|".join(map(re.escape, PLACEHOLDERS)))
_ALONE = re.compile(r"[\w@+=:,./-]*\{(capture|output)\}[\w@+=:,./-]*|\{options\}")
_PLAIN = re.compile(r"[\w@+=:,./#~-]*")  # what no shell of any system reads as more than it is
_DRIVE = re.compile(r"[A-Za-z]:")
_PROGRAM = re.compile(r"frog|python[\d.]*")  # which hand their words to no shell
_SSH = "1246ab:c:e:fgi:kl:m:no:p:qstvxyAB:CD:E:F:GI:J:KL:MNO:P:Q:R:S:TVw:W:XY"
_SSH_FLAGS = {"ssh": _SSH, "plink": _SSH, "autossh": _SSH.replace("M", "M:")}
"""By the name of a program: its options, as ``getopt`` takes them. Unknown ones of plink end the reading."""
PATIENCE = 20.0  # seconds for a cancelled training to save and end
_PACE = 0.0005  # seconds between two events: no faster than the panel takes them, whatever is sent
MOST_SENTENCES = 1000  # warnings and reductions, which the panel keeps


@dataclass(frozen=True)
class RemoteCommand:
    """A command with placeholders for the capture, the output and the options of ``frog train``.

    Attributes:
        text: the command. It is split into arguments and started without a shell.
        local_folder, remote_folder: one folder as it is called here and there; empty where paths are the same.
    """

    text: str
    local_folder: str = ""
    remote_folder: str = ""

    def problem(self) -> str:
        """Why it cannot be started, as a sentence; empty where it can be tried."""
        if not self.text.strip():
            return "The device Remote needs a Remote Command in the add-on's preferences."
        try:
            words = _words(self.text)
        except ValueError as error:
            return f"The Remote Command in the add-on's preferences cannot be read ({error})."
        missing = [name for name in PLACEHOLDERS if not any(name in word for word in words[1:])]
        if missing:
            return f"The Remote Command in the add-on's preferences lacks {' and '.join(missing)}."
        held = [word for word in (*self.text.split(), *words) if _ANY.search(word)]
        if unfit := next((word for word in held if not _ALONE.fullmatch(word)), words[0] if words[0] in held else None):
            return (
                f"The Remote Command in the add-on's preferences has {brief(unfit)}, expected placeholders as words of "
                "their own behind a program, not within quotes: FRoG quotes paths itself."
            )
        if bool(self.local_folder) != bool(self.remote_folder):
            return "The add-on's preferences need both a Local Folder and a Remote Folder, or neither."
        return ""

    def arguments(self, request: TrainingRequest) -> list[str]:
        """What is started for a training; FrogError where the command is none, or where a shell might read a path.

        Placeholders are replaced after splitting, so that no path can become several arguments. Where ssh, autossh or
        plink starts frog, they are quoted for the shell of the other computer, which reads the words joined. Any other
        program is given plain words as they are: what it does with them is not known.
        """
        if problem := self.problem():
            raise FrogError(problem)
        words = _words(self.text)
        values = {
            "{capture}": [self.there(request.capture)],
            "{output}": [self.there(request.output)],
            "{options}": options_of(request),
        }
        far = _behind_ssh(words)
        starts_frog = bool(_PROGRAM.fullmatch(_name(next(iter(words if far is None else far), ""))))
        if not starts_frog or far is not None:
            has_quotes = starts_frog and values["{capture}"][0].startswith("/")  # another system's shell has others
            values = {key: [_handed(value, words[0], has_quotes) for value in given] for key, given in values.items()}
        arguments = []
        for word in words:
            # All placeholders at once: paths stay as they are.
            arguments += values[word] if word == "{options}" else [_ANY.sub(lambda match: values[match[0]][0], word)]
        return arguments

    def there(self, path: Path) -> str:
        """A path of this computer as it is called on the other one."""
        folder = Path(self.local_folder)
        if self.local_folder and path.is_relative_to(folder):
            return "/".join([self.remote_folder.rstrip("/\\"), *path.relative_to(folder).parts])
        return str(path)

    def here(self, told: str) -> Path:
        """A path that the other computer told as it is called here."""
        folder = _slashes(self.remote_folder).rstrip("/") + "/"
        if self.remote_folder and _slashes(told).startswith(folder):
            return Path(self.local_folder, _slashes(told)[len(folder) :])
        return Path(told)

    def is_there(self, told: str, path: Path) -> bool:
        """Whether the other computer told the name of a path of this one, as it escapes it."""
        return _slashes(told) == _slashes(printable(self.there(path)))


def options_of(request: TrainingRequest) -> list[str]:
    """The options of ``frog train`` that a request stands for, apart from the capture, the output and the device: those
    that differ from what they are by default; of a resumed training those that it may be given anew.
    """
    arguments = ["--end-with-input"]
    for option in options_at(Door.REMOTE):
        value = getattr(request.options, option.name)
        is_ignored = request.options.resume and option.resume is Resume.KEPT
        if value == option.default or is_ignored:
            continue
        if option.is_switch:
            arguments.append(option.flag)
        elif isinstance(value, dict):
            arguments += [f"{option.flag}={name}={text_of(part)}" for name, part in value.items()]
        else:
            arguments.append(f"{option.flag}={text_of(value)}")
    return arguments


def _words(text: str) -> list[str]:
    """The command's arguments; ValueError for a quotation that does not end."""
    words = shlex.shlex(text, posix=True, punctuation_chars=False)
    words.whitespace_split, words.commenters = True, ""
    if os.name == "nt":
        words.escape = ""  # which separates folders there
    return list(words)


def _name(word: str) -> str:
    """Of the program that a word starts."""
    return PurePath(word).name.lower().removesuffix(".exe")


def _behind_ssh(words: list[str]) -> list[str] | None:
    """What ssh or one of its kind hands, joined, to a shell of the other computer; None where it is not started."""
    flags = _SSH_FLAGS.get(_name(words[0]))
    try:
        return None if flags is None else getopt(words[1:], flags)[1][1:]
    except GetoptError:
        return []


def _handed(value: str, program: str, has_quotes: bool) -> str:
    """A value as a program is given it that may hand it to a shell; FrogError where that might read another."""
    if has_quotes:
        return shlex.quote(value)
    plain = _slashes(value) if _DRIVE.match(value) else value
    if not _PLAIN.fullmatch(plain):
        raise FrogError(
            f"{brief(value)}: {program} may hand this to a shell, which reads more than a name there. Expected letters,"
            " digits and . _ - + = : , @ # ~ / alone, or a Remote Command that begins with frog or with ssh HOST frog."
        )
    return plain


def _slashes(path: str) -> str:
    return path.replace("\\", "/")


class RemoteTraining:
    """One training by a command.

    Args:
        command: starts it.
        request: what to train. Its output is known here by a path of this computer.
        patience: seconds that it has to end once it was cancelled; then it is killed.
    """

    def __init__(self, command: RemoteCommand, request: TrainingRequest, patience: float = PATIENCE) -> None:
        self._command, self._request, self._patience = command, request, patience
        self._arguments = command.arguments(request)
        self._process: ChildProcess | None = None
        self._told = {"pause": "resume", "preview": "preview "}
        self._cancelled_at: float | None = None
        self._step = self._sentences = 0
        self._was_killed = False

    def events(self, control: CancelToken) -> Iterator[Event]:
        """Runs it: an event source for ``TrainingTask``. FrogError if it fails."""
        if control.ended:
            yield events.Cancelled(0, None)
            return
        self._request.copy_checkpoint()
        with ChildProcess(self._arguments) as process:
            self._process = process
            last = yield from self._followed(process, control)
            yield from self._end(process, control, last)

    def kill(self) -> None:
        """Ends the command at once; from any thread."""
        if self._process is not None:
            self._process.kill()

    def _followed(self, process: ChildProcess, control: CancelToken) -> Generator[Event, None, Event | None]:
        """Yields events until the command has ended; returns the training's last, which waits for that: what the
        command does after a training, such as copying the scene here, belongs to it.
        """

        def is_over() -> bool:
            self._pass_on(process, control)
            return self._cancelled_at is not None and time.monotonic() - self._cancelled_at > self._patience

        last: Event | None = None
        try:
            for line in process.lines(is_over):
                match event_of(line):
                    case None:
                        pass
                    case events.Finished() | events.Cancelled() as event:
                        last = event
                    case events.Saved() as event:
                        yield replace(event, path=str(self._here(event.path)))
                    case events.Reduced() | events.WarningEvent() as event:  # only so many, as the panel keeps them
                        self._sentences += 1
                        if self._sentences <= MOST_SENTENCES:
                            yield event
                    case event:
                        self._step = event.step if isinstance(event, events.Progress) else self._step
                        yield event
                time.sleep(_PACE)
        except Stopped:
            self._was_killed = True
        return last

    def _pass_on(self, process: ChildProcess, control: CancelToken) -> None:
        """Tells the command what is asked of it and was not before: a pause, another preview, its end."""
        if self._cancelled_at is not None:
            return
        if control.ended:
            self._cancelled_at = time.monotonic()
            process.end_input()
            return
        asked = control.preview_camera
        preview = (self._request.options.preview_camera or "") if asked is None else asked
        wishes = {"pause": "pause" if control.paused else "resume", "preview": f"preview {' '.join(preview.split())}"}
        for kind, line in wishes.items():
            if line != self._told[kind]:
                process.send(line)
        self._told = wishes

    def _here(self, told: str) -> Path:
        """A path that the command told, on this computer."""
        output = self._request.output
        return output if self._command.is_there(told, output) else self._command.here(told)

    def _end(self, process: ChildProcess, control: CancelToken, last: Event | None) -> Iterator[Event]:
        """Yields the training's last event, with what is left of it here; FrogError where it failed."""
        if isinstance(last, events.Finished):
            path = self._here(last.path)
            if not os.path.isfile(path):  # unlike Path.is_file false for a name that no file can have
                why = f" The command {process.end}." if process.code else ""
                raise FrogError(f"{brief(path)}: the scene is trained, but its file is not on this computer.{why}")
            yield replace(last, path=str(path))
        elif isinstance(last, events.Cancelled):
            left = self._here(last.path) if last.path is not None else None
            if left is not None and not os.path.isfile(left):
                yield events.WarningEvent(f"{brief(last.path)}: what was learned is on the other computer alone.")
                left = None
            yield events.Cancelled(last.step, str(left) if left is not None else None)
        elif control.ended:
            if self._was_killed:
                yield events.WarningEvent(
                    f"The remote command did not end within {self._patience:.0f} seconds and was killed."
                )
            yield events.Cancelled(self._step, None)
        elif process.code:
            raise FrogError(f"The remote command {process.end}.")
        else:
            raise FrogError(
                f"The remote command did not tell how the training ended ({process.last_words}). It has to run "
                "frog train with --events."
            )
