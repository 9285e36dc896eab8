"""How late Blender's window answers while a training runs in it.

    blender --factory-startup --python benchmarks/ui_latency.py -- CAPTURE [--seconds 30] [--recipe draft] \\
        [--play X.frog | --steps 300]

In a window (timers do not fire with -b) a timer asks to be called every 10 ms and notes how much later it is called:
what a click would wait.  First without a training, then while one decodes and finds its seed points, then during its
steps.  With --play a scene plays in the rendered viewport all the while; since software OpenGL may take most of a
second to draw a window, what the add-on itself takes for a frame and for an image is measured then, not lateness.

With --steps a capture is chosen, the button is pressed, and the training goes to its end and is imported; no viewport
is drawn then, since software OpenGL and the training share the processor. What a call was late is told with the
processor's time that Blender took meanwhile: where others use the machine, that is what was its own of the delay.

Prints one line of JSON, milliseconds, and quits Blender.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy
import numpy as np

import frog_blender
from frog_blender import app_handlers
from frog_blender.engine.options import TrainingOptions
from frog_blender.render import viewport
from frog_blender.tasks import background_task
from frog_blender.tasks.training import TrainingTask
from frog_blender.tasks.training_request import TrainingRequest
from frog_blender.timeline.handlers import on_frame

INTERVAL = 0.01  # seconds
IDLE_SECONDS = 8.0
SETTLE_SECONDS = 4.0  # a window that has just opened is busy with itself
CHOOSING_SECONDS = 3.0  # between the choice of a capture and the button, as people take them
PATIENCE_SECONDS = 300.0  # for the training to reach its first step


class Watch:
    """The timer: one phase after the other, the lateness of every call noted under its phase."""

    def __init__(self, request: TrainingRequest, seconds: float) -> None:
        self.request = request
        self.seconds = seconds
        phases = ("idle", "choosing", "preparing", "training", "ending")
        self.late: dict[str, list[tuple[float, float, float]]] = {phase: [] for phase in phases}
        self.to_the_end = False
        self.processor, self.main = time.process_time(), time.thread_time()
        self.own: dict[str, dict[str, list[float]]] = {}
        self.phase = "settling"
        self.since = self.due = time.perf_counter()

    def __call__(self) -> float | None:
        now, used, main = time.perf_counter(), time.process_time(), time.thread_time()
        if self.phase in self.late:
            late = max(now - self.due, 0.0), used - self.processor, main - self.main
            self.late[self.phase].append((1000.0 * late[0], 1000.0 * late[1], 1000.0 * late[2]))
        if self.advance(now - self.since):
            self.since = now
        if self.phase == "done":
            self.report()
            return None
        self.processor, self.main = time.process_time(), time.thread_time()
        self.due = time.perf_counter() + INTERVAL
        return INTERVAL

    def timed(self, name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        """``work``, every call of which is measured under this name and the present phase."""

        def measured(*arguments: Any) -> Any:
            started = time.perf_counter()
            result = work(*arguments)
            took = 1000.0 * (time.perf_counter() - started)
            self.own.setdefault(self.phase, {}).setdefault(name, []).append(took)
            return result

        return measured

    def play(self, scene: Path) -> None:
        """Play a scene in the window from now on."""
        bpy.ops.import_scene.frog(filepath=str(scene.resolve()))
        handlers = bpy.app.handlers.frame_change_pre
        original = app_handlers.guarded(on_frame)
        handlers[handlers.index(original)] = self.timed("frame handler", original)
        viewport.image_of = self.timed("image of the viewport", viewport.image_of)
        window = bpy.context.window_manager.windows[0]
        with bpy.context.temp_override(window=window, screen=window.screen):
            bpy.ops.screen.animation_play()

    def advance(self, elapsed: float) -> bool:
        """Go to the next phase when this one has lasted; whether it did."""
        task = TrainingTask.current()
        if self.phase == "settling" and elapsed > SETTLE_SECONDS:
            self.phase = "idle"
        elif self.phase == "idle" and elapsed > IDLE_SECONDS:
            self.choose()
            self.phase = "choosing"
        elif self.phase == "choosing" and elapsed > CHOOSING_SECONDS:
            self.begin()
            self.phase = "preparing"
        elif self.phase == "preparing" and task is not None and task.state.step:
            self.phase = "training"
        elif self.to_the_end:
            if self.phase == "training" and task is not None and task.state.step >= task.state.steps:
                self.phase = "ending"  # with its last measurement, its export and its import
            elif self.phase == "ending" and task is not None and not (task.is_running or task.waiting):
                self.phase = "imported"
            elif self.phase == "imported" and elapsed > SETTLE_SECONDS:
                self.phase = "done"
            else:
                return False
        elif (self.phase == "training" and elapsed > self.seconds) or (
            task is not None and (not task.is_running or elapsed > max(PATIENCE_SECONDS, self.seconds))
        ):
            self.phase = "done"
        else:
            return False
        return True

    def choose(self) -> None:
        """Choose the capture in the panel, where the button is to be pressed."""
        if self.to_the_end:
            settings = bpy.context.scene.frog
            settings.capture_folder, settings.output_path = str(self.request.capture), str(self.request.output)
            settings.recipe, settings.length, settings.steps = (
                self.request.options.recipe,
                "STEPS",
                self.request.options.steps,
            )

    def begin(self) -> None:
        """Press the button, or start the training without it."""
        if not self.to_the_end:
            TrainingTask(self.request.events).begin()
        elif bpy.ops.frog.train() != {"FINISHED"}:
            sys.exit("The training could not be started.")

    def report(self) -> None:
        """Print the figures and leave."""
        figures: dict[str, object] = {"interval_ms": 1000.0 * INTERVAL, "blender": bpy.app.version_string}
        for phase, late in self.late.items():
            if late and not self.own:
                figures[phase] = summary([wall for wall, *_ in late]) | worst(late)
            elif phase in self.own:
                figures[phase] = {name: summary(taken) for name, taken in self.own[phase].items()}
        task = TrainingTask.current()
        if task is not None:
            figures |= {"steps": task.state.step, "gaussians": task.state.gaussians, "error": task.error}
        print(json.dumps(figures), flush=True)
        background_task.stop()
        bpy.ops.wm.quit_blender()


def without_viewports() -> None:
    """Other editors in the viewports' places, and a cursor of the system's, as where a mouse has been moved.

    X11 looks its first cursor up in a library, for which it waits where another is loaded at the moment.
    """
    for window in bpy.context.window_manager.windows:
        window.cursor_modal_set("WAIT")
        window.cursor_modal_restore()
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.type = "TEXT_EDITOR"


def summary(milliseconds: list[float]) -> dict[str, float]:
    p50, p95 = np.percentile(milliseconds, (50, 95))
    shown = {"calls": len(milliseconds), "p50": p50, "p95": p95, "max": max(milliseconds)}
    return {name: round(float(value), 2) for name, value in shown.items()}


def worst(late: list[tuple[float, float, float]]) -> dict[str, float]:
    """The longest delay in the processor's time: all that Blender's threads used, and what its main thread did."""
    everything = max(min(wall, used) for wall, used, _ in late)
    return {"max_processor": round(everything, 2), "max_main": round(max(main for *_, main in late), 2)}


def main() -> None:
    parser = argparse.ArgumentParser(prog="ui_latency.py", description="Latency of the window while a training runs.")
    parser.add_argument("capture", type=Path)
    parser.add_argument("--seconds", type=float, default=30.0, help="how long to measure during training")
    parser.add_argument("--recipe", default="draft")
    parser.add_argument("--play", type=Path, help="a scene that plays while it is measured")
    parser.add_argument("--steps", type=int, help="press the button, train so many steps, and import")
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
    if bpy.app.background:
        sys.exit("This measures a window: start Blender without -b.")
    bpy.context.preferences.view.show_splash = False
    frog_blender.register()
    output = Path(tempfile.mkdtemp()) / "latency.frog"
    chosen = TrainingOptions(recipe=options.recipe, steps=options.steps)
    request = TrainingRequest(options.capture.resolve(), output, chosen)
    watch = Watch(request, options.seconds)
    watch.to_the_end = options.steps is not None
    if options.play is not None:
        watch.play(options.play)
    elif watch.to_the_end:
        without_viewports()
    bpy.app.timers.register(watch.__call__, first_interval=INTERVAL)


main()
