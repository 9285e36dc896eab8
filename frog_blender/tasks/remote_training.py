"""A training elsewhere: a command whose events are followed as if it were a training of this Blender."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..engine.errors import FrogError
from ..engine.io.child_process import ChildProcess, Stopped
from ..engine.training.session import events
from ..engine.training.session.cancel_token import CancelToken
from ..engine.training.session.events import Event, event_of
from .remote_command import RemoteCommand

if TYPE_CHECKING:
    from .training_request import TrainingRequest

PATIENCE = 20.0  # seconds for a cancelled training to save and end
_PACE = 0.0005  # seconds between two events: no faster than the panel takes them, whatever is sent
_MOST_SENTENCES = 1000  # warnings and reductions, which the panel keeps


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
        wishes = _Wishes(process, control, self._request.options.preview_camera)

        def is_over() -> bool:
            wishes.pass_on()
            return wishes.seconds_cancelled > self._patience

        last: Event | None = None
        try:
            for line in process.lines(is_over):
                event = event_of(line)
                if isinstance(event, events.Finished | events.Cancelled):
                    last = event
                elif event is not None and self._is_taken(event):
                    yield self._translated(event)
                time.sleep(_PACE)
        except Stopped:
            self._was_killed = True
        return last

    def _is_taken(self, event: Event) -> bool:
        """Whether the panel is given an event. Only so many sentences are, as it keeps them."""
        if isinstance(event, events.Progress):
            self._step = event.step
        if isinstance(event, events.Reduced | events.WarningEvent):
            self._sentences += 1
            return self._sentences <= _MOST_SENTENCES
        return True

    def _translated(self, event: Event) -> Event:
        if isinstance(event, events.Saved | events.CompressionPreview):
            return replace(event, path=str(self._here(event.path)))
        return event

    def _here(self, told: str) -> Path:
        """A path that the command told, on this computer."""
        output = self._request.output
        return output if self._command.is_there(told, output) else self._command.here(told)

    def _end(self, process: ChildProcess, control: CancelToken, last: Event | None) -> Iterator[Event]:
        """Yields the training's last event, with what is left of it here; FrogError where it failed."""
        if isinstance(last, events.Finished):
            path = self._here(last.path)
            yield replace(last, path=str(path))
            if not path.is_file():
                why = f" The command {process.end}." if process.code else ""
                raise FrogError(f"{path}: the scene is trained, but its file is not on this computer.{why}")
        elif isinstance(last, events.Cancelled):
            left = self._here(last.path) if last.path is not None else None
            if left is not None and not left.is_file():
                yield events.WarningEvent(f"{last.path}: what was learned is on the other computer alone.")
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


class _Wishes:
    """Passes on to a command what is asked of a training: pauses, another preview, its end."""

    def __init__(self, process: ChildProcess, control: CancelToken, preview_camera: str | None) -> None:
        self._process, self._control = process, control
        self._is_paused, self._preview = False, ""
        self._first_preview = preview_camera or ""
        self._cancelled_at: float | None = None

    @property
    def seconds_cancelled(self) -> float:
        """Since the command was asked to end; 0 where it was not."""
        return time.monotonic() - self._cancelled_at if self._cancelled_at is not None else 0.0

    def pass_on(self) -> None:
        """Tells what has changed since the last time."""
        control, process = self._control, self._process
        if self._cancelled_at is not None:
            return
        if control.ended:
            self._cancelled_at = time.monotonic()
            process.end_input()
            return
        if control.paused != self._is_paused:
            self._is_paused = not self._is_paused
            process.send("pause" if self._is_paused else "resume")
        preview = self._first_preview if control.preview_camera is None else control.preview_camera
        if preview != self._preview:
            self._preview = preview
            process.send(f"preview {' '.join(preview.split())}")
