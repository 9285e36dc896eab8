"""Training in the background. Its worker never touches Blender, so it goes on while another file is opened."""

import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Self

import bpy
import numpy as np

from .. import addon_state, unsaved_changes
from ..engine import memory
from ..engine.capture.camera import Camera
from ..engine.errors import FrogError, brief
from ..engine.playback.player import ScenePlayer
from ..engine.scene.compression_report import lines, summary
from ..engine.training.session import events
from ..engine.training.session.cancel_token import CancelToken
from ..engine.training.session.events import Event
from ..engine.training.session.live_scene import LiveScene
from ..engine.whole_progress import Standing
from ..scene_import.capture_objects import finder
from ..timeline import open_scenes, playback, playback_cache, prefetch
from .background_task import BackgroundTask, Ended, Message, Progress

MOST_WAITING = 1000
_KEPT = (Ended, events.Finished, events.Cancelled, events.Reduced, events.WarningEvent)

EventSource = Callable[[CancelToken], Iterator[Event]]
OnFinished = Callable[[Path], str | None]
"""Is called with a finished scene's file; returns an additional note for the panel, if any. May raise FrogError."""


@dataclass
class TrainingState:
    """What the panel shows.  Only ``pump()`` writes it, so it needs no lock."""

    step: int = 0
    steps: int = 0
    seconds: float = 0.0
    loss: float | None = None
    gaussians: int = 0
    moving: int = 0
    capacity: list[str] = field(default_factory=list)  # what was removed from the model, one line each
    psnr: float | None = None
    psnr_split: str = ""
    preview: np.ndarray | None = None  # (H, W, 3) uint8, the latest
    warnings: list[str] = field(default_factory=list)
    result: Path | None = None  # the finished scene, or what a cancelled training left
    result_bytes: int = 0  # of the finished scene's file
    is_cancelled: bool = False

    @property
    def sentence(self) -> str:
        """What a finished training made: ``4,100 of 33,000 Gaussians move; file 1.1 MB; quality 33.8 dB.``"""
        gaussians = f"{self.moving:,} of {self.gaussians:,} Gaussians move"
        if self.moving in (0, self.gaussians):
            gaussians = f"{self.gaussians:,} Gaussians, {'none' if self.moving == 0 else 'all'} of which move"
        parts = [gaussians]
        if self.result_bytes:
            parts.append(f"file {_size(self.result_bytes)}")
        if self.psnr is not None:
            parts.append(f"quality {self.psnr:.1f} dB")
        return f"{'; '.join(parts)}."

    def take(self, event: Event) -> Progress | None:
        """Applies an event of the engine; returns the progress that it tells, if any."""
        match event:
            case events.Stage():
                return _progress(event, event.name[:1].upper() + event.name[1:], event.done, max(event.total, 1))
            case events.Started():
                self.step, self.steps, self.gaussians = event.step, event.steps or 0, event.gaussians
                return Progress(_step(self.step, self.steps) if self.steps else "Training", self.step, self.steps)
            case events.Progress():
                self.step, self.steps, self.loss = event.step, event.steps, event.loss
                self.seconds = event.seconds
                self.gaussians, self.moving = event.gaussians, event.num_dynamic
                return _progress(event, _step(event.step, event.steps), event.step, event.steps)
            case events.Reduced():
                self.capacity.append(event.message)
            case events.Preview():
                self.preview = event.image
            case events.Evaluated():
                self.psnr, self.psnr_split = event.psnr, event.split
            case events.WarningEvent():
                self.warnings.append(event.message)
            case events.Finished():
                self._finish(event)
            case events.Cancelled():
                self.is_cancelled = True
                self.result = Path(event.path) if event.path else None
        return None

    def _finish(self, event: events.Finished) -> None:
        self.result = Path(event.path)
        self.step, self.steps = event.steps, event.steps
        self.seconds = sum(event.phases.values()) or event.seconds  # by the clock, as it was promised
        with suppress(OSError):
            self.result_bytes = self.result.stat().st_size
        self.gaussians = event.gaussians
        self.psnr = event.psnr if event.psnr is not None else self.psnr
        if event.capacity:
            self.moving = event.capacity["dynamic"]
            self.capacity = [summary(event.capacity), *lines(event.capacity)]


def _step(step: int, steps: int) -> str:
    return f"Step {step:,} of {steps:,}"


def _progress(event: events.Stage | events.Progress, stage: str, done: int, total: int) -> Progress:
    """What an event tells."""
    return Progress(stage, done, total, Standing(stage, event.fraction or done / max(total, 1), event.seconds_left))


def _size(count: int) -> str:
    return f"{count / 1e6:,.1f} MB" if count >= 1e5 else f"{count / 1e3:,.0f} KB"


class LiveView:
    """What is seen of one training.

    Args:
        scene: the Blender scene whose viewports show it.
        cameras: of the capture, through which it can be looked at.
        distance: from the first one, of what it films.

    Attributes:
        source: what the training offers its snapshots to.
        player: the latest one; None until there is one.
        was_looked_at: whether viewports that nobody had moved were turned to it.
    """

    def __init__(self, scene: bpy.types.Scene, cameras: Sequence[Camera] = (), distance: float = 1.0) -> None:
        self.source = LiveScene(is_wanted=self._is_seen(scene))
        self.player: ScenePlayer | None = None
        self.was_looked_at = False
        self.cameras, self.distance = cameras, distance
        self._find = finder(scene)

    @property
    def scene(self) -> bpy.types.Scene | None:
        """The scene whose viewports show it; None where that is not open."""
        return self._find()

    def attach(self, scene: bpy.types.Scene) -> None:
        """From now on the viewports of another scene show it."""
        self._find = finder(scene)

    def camera(self, name: str) -> Camera | None:
        """The camera of that name, otherwise the first one; None without any."""
        named = (camera for camera in self.cameras if camera.name == name)
        return next(named, self.cameras[0] if self.cameras else None)

    def update(self) -> bool:
        """Takes the newest snapshot, and says whether further ones are wanted; true if there was one."""
        scene = self.scene
        self.source.is_wanted = scene is not None and self._is_seen(scene)
        newest = self.source.take()
        if newest is None:
            return False
        self.forget()
        self.player = newest
        return True

    def forget(self) -> None:
        """Drops what was seen, and what is kept of it elsewhere."""
        if self.player is not None:
            playback_cache.frames().forget(self.player.token)
        self.player = None

    @staticmethod
    def _is_seen(scene: bpy.types.Scene) -> bool:
        return bool(scene.frog.show_live) and not bpy.app.background


class TrainingTask(BackgroundTask):
    """One training; its result is a finished scene's file, or what a cancelled one left.

    Args:
        source: gives the events; called on the worker thread.
        on_finished: is given the file of a finished scene.
        prepare: does a part of ``on_finished`` before it, so that neither keeps the user waiting; at another time.
        live: where viewports find its scene while it runs.

    Attributes:
        control: pauses, resumes and cancels it at any time.
        state: what the panel shows besides.
        waiting: a finished file that is not handed over yet.
    """

    what = "training"
    busy = "A training is already running. Wait for it or cancel it first."
    quit_seconds = 10.0  # for a cancelled training to finish its step and write its scene when Blender quits
    patience: ClassVar[float] = 0.5
    """Of those, seconds before a message is printed."""

    def __init__(
        self,
        source: EventSource,
        on_finished: OnFinished | None = None,
        *,
        prepare: Callable[[], None] | None = None,
        live: LiveView | None = None,
    ) -> None:
        super().__init__()
        self.live = live
        self.state = TrainingState()
        self.on_finished, self.prepare = on_finished, prepare
        self.waiting: Path | None = None
        self.control = CancelToken()
        self._source = source
        self._images: dict[type[Event], Event] = {}  # that wait

    def begin(self) -> Self:
        last = self.current()
        if last is not None and last.waiting:
            raise FrogError(
                "The last scene is still waiting to be imported. Finish the current render or operation first."
            )
        return super().begin()

    def show(self) -> Self:
        if self.current() is not self:
            self.forget()
        return super().show()

    @classmethod
    def forget(cls, slot: str = "") -> None:
        last = cls.current()
        super().forget(slot)
        if last is not None and last.live is not None:
            last.live.forget()
            _tell_live_watchers()

    def cancel(self) -> None:
        """Asks the worker to end, paused or not; it still writes what it has."""
        super().cancel()
        self.control.cancel()

    @property
    def paused(self) -> bool:
        """True while a running training is paused."""
        return self.is_running and self.control.paused

    @classmethod
    def is_computing(cls) -> bool:
        """Whether a training is running and not paused."""
        task = cls.current()
        return task is not None and task.is_running and not task.paused

    def work(self) -> None:
        try:
            for event in self._source(self.control):
                self._open_result(event)
                self.put(event)
        finally:
            memory.trim_heap()

    def _open_result(self, event: Event) -> None:
        """Reads a finished scene here, so that the main thread, which imports it, does not stand still for it."""
        if self.on_finished is None or not isinstance(event, events.Finished):
            return
        with suppress(FrogError):  # which the import tells
            open_scenes.scene(Path(event.path)).at(0.0)

    def put(self, message: Message) -> None:
        """Queues a message. What comes while Blender takes none is bounded: of images the latest waits alone, and of
        what the next event says anew only so much.
        """
        if isinstance(message, events.Preview):
            self._images[type(message)] = message
            message = type(message)
        if isinstance(message, _KEPT) or self._messages.qsize() < MOST_WAITING:
            super().put(message)

    def take(self, message: Event | type[Event]) -> None:
        """Applies an event of the source, or the latest image of a kind."""
        event = self._images.pop(message, None) if isinstance(message, type) else message
        if event is None:
            return
        try:
            told, whole = self.state.take(event), self.progress.whole
            if told is not None and told.whole is None:
                whole = whole or Standing("", told.fraction, 0.0)
                told = replace(told, whole=replace(whole, stage=told.stage))
            self.progress = told or self.progress
        except Exception as error:  # the events that follow can still be shown
            self.state.warnings.append(f"An event of the training cannot be shown ({brief(repr(error))}).")

    def conclude(self, ended: Ended) -> None:
        """An error counts though it was cancelled: what it has learned may be lost."""
        self.result, self.error, self.is_cancelled = self.state.result, ended.error, self.state.is_cancelled

    @property
    def kept_at_quit(self) -> str:
        return "What it has learned by then is saved, and Resume goes on from there."

    def hand_over(self) -> None:
        self.waiting = self.result
        self.hand_over_when_possible()

    def hand_over_when_possible(self) -> None:
        """Calls ``on_finished`` with the file of a finished training once nothing else uses the scene; ``prepare``
        alone the first time, where there is any.
        """
        if self.waiting is None or unsaved_changes.is_scene_in_use():
            return
        if self.prepare is not None:
            prepare, self.prepare = self.prepare, None
            with suppress(Exception):  # which happens in ``on_finished`` as well, and is told then
                prepare()
            return
        self.waiting = None
        super().hand_over()
        playback.forget_unused()  # opening did not: this task's thread had read the file before

    def tick(self) -> bool:
        applied = 0
        try:
            if (applied := self.pump()) or self.is_redraw_due:
                for watcher in addon_state.get(Watchers).of_state:
                    watcher(self.state)
                self.redraw()
            if self.live is not None and self.live.update():
                _tell_live_watchers()
            if self.is_running:
                unsaved_changes.count_as_unsaved()
        except Exception:  # the training goes on
            traceback.print_exc(file=sys.stderr)
            self.state.preview = None
        if not applied:  # else that was enough at a time
            self.hand_over_when_possible()
        goes_on = self.is_running or self.waiting is not None
        if not goes_on and self.live is not None:
            self.live.forget()
            _tell_live_watchers()
        return goes_on

    def stop(self) -> None:
        """Cancels it, gives it ``quit_seconds`` to save, and drains its event queue."""
        self.cancel()
        self.on_finished = self.prepare = None  # its result must not be imported into whatever comes next
        if not self.join(self.patience):
            has_learned = self.state.step > 0
            doing = "Saving what the training has learned" if has_learned else "Ending the training"
            _print(f"{doing}, which may take up to {self.quit_seconds:.0f} seconds.")
            if not self.join(self.quit_seconds - self.patience):
                _print("That took longer." + (" The last checkpoint is kept, if there is one." if has_learned else ""))
                return
        self.pump_all()


class Watchers:
    """Who is told of the training that panels show.

    Attributes:
        of_state: are given its state whenever that has changed.
        of_scene: are called whenever there is another snapshot of its scene, or none any more.
    """

    def __init__(self) -> None:
        self.of_state: list[Callable[[TrainingState], None]] = []
        self.of_scene: list[Callable[[], None]] = []


def _tell_live_watchers() -> None:
    for watcher in addon_state.get(Watchers).of_scene:
        watcher()


def _print(sentence: str) -> None:
    print(f"FRoG: {sentence}", file=sys.stderr, flush=True)


def register() -> None:
    prefetch.share_cores(TrainingTask.is_computing)
