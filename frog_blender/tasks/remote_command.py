"""The command that trains on another computer: its arguments, and how paths are called there."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

from ..engine.errors import FrogError, printable
from ..engine.options import Door, Resume, options_at
from ..engine.setting import text_of

if TYPE_CHECKING:
    from .training_request import TrainingRequest

PLACEHOLDERS = ("{capture}", "{output}", "{options}")
_ANY = re.compile("|".join(map(re.escape, PLACEHOLDERS)))


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
        if bool(self.local_folder) != bool(self.remote_folder):
            return "The add-on's preferences need both a Local Folder and a Remote Folder, or neither."
        return ""

    def arguments(self, request: TrainingRequest) -> list[str]:
        """What is started for a training; FrogError where the command is none.

        Placeholders are replaced after splitting, so that no path can become several arguments. Values are quoted
        where a shell reads them: ``ssh`` hands its arguments to one, joined, and so do words within an argument of
        several, as in ``bash -c "frog train {capture} ..."``.
        """
        if problem := self.problem():
            raise FrogError(problem)
        options = options_of(request)
        values = {"{capture}": self.there(request.capture), "{output}": self.there(request.output)}
        quoted = {name: shlex.quote(value) for name, value in values.items()} | {"{options}": shlex.join(options)}
        words = _words(self.text)
        over_ssh = any(PurePath(word).stem.lower() == "ssh" for word in words)
        arguments = []
        for word in words:
            if over_ssh or len(word.split()) > 1:
                arguments.append(_replaced(word, quoted))
            elif word == "{options}":
                arguments += options
            else:
                arguments.append(_replaced(word, values | {"{options}": shlex.join(options)}))
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
    arguments = []
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


def _replaced(word: str, values: Mapping[str, str]) -> str:
    """All at once: a path with the name of a placeholder in it stays as it is."""
    return _ANY.sub(lambda found: values[found[0]], word)


def _slashes(path: str) -> str:
    return path.replace("\\", "/")
