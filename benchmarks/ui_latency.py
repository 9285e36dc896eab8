"""How late Blender's window answers while a training runs in it.

    blender --factory-startup --python benchmarks/ui_latency.py -- CAPTURE [--seconds 30] [--recipe draft]

In a window (timers do not fire with -b) a timer asks to be called every 10 ms and notes how much later it is called:
what a click would wait.  First without a training, then while one decodes and finds its seed points, then during its
steps.  Prints one line of JSON, milliseconds, and quits Blender.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import bpy
import numpy as np

import frog_blender
from frog_blender import background

INTERVAL = 0.01  # seconds
IDLE_SECONDS = 8.0
SETTLE_SECONDS = 4.0  # a window that has just opened is busy with itself
PATIENCE_SECONDS = 300.0  # for the training to reach its first step


class Watch:
    """The timer: one phase after the other, the lateness of every call noted under its phase."""

    def __init__(self, request: background.TrainingRequest, seconds: float) -> None:
        self.request = request
        self.seconds = seconds
        self.late: dict[str, list[float]] = {"idle": [], "preparing": [], "training": []}
        self.phase = "settling"
        self.since = self.due = time.perf_counter()

    def __call__(self) -> float | None:
        now = time.perf_counter()
        if self.phase in self.late:
            self.late[self.phase].append(1000.0 * max(now - self.due, 0.0))
        if self.advance(now - self.since):
            self.since = now
        if self.phase == "done":
            self.report()
            return None
        self.due = time.perf_counter() + INTERVAL
        return INTERVAL

    def advance(self, elapsed: float) -> bool:
        """Go to the next phase when this one has lasted; whether it did."""
        task = background.current
        if self.phase == "settling" and elapsed > SETTLE_SECONDS:
            self.phase = "idle"
        elif self.phase == "idle" and elapsed > IDLE_SECONDS:
            background.begin(self.request.events)
            self.phase = "preparing"
        elif self.phase == "preparing" and task is not None and task.state.step:
            self.phase = "training"
        elif (self.phase == "training" and elapsed > self.seconds) or (
            task is not None and (not task.state.running or elapsed > max(PATIENCE_SECONDS, self.seconds))
        ):
            self.phase = "done"
        else:
            return False
        return True

    def report(self) -> None:
        """Print the figures and leave."""
        figures: dict[str, object] = {"interval_ms": 1000.0 * INTERVAL, "blender": bpy.app.version_string}
        for phase, late in self.late.items():
            if late:
                p50, p95 = np.percentile(late, (50, 95))
                shown = {"calls": len(late), "p50": p50, "p95": p95, "max": max(late)}
                figures[phase] = {name: round(float(value), 2) for name, value in shown.items()}
        state = background.current.state if background.current else None
        if state is not None:
            figures["steps"], figures["gaussians"], figures["error"] = state.step, state.gaussians, state.error
        print(json.dumps(figures), flush=True)
        background.stop()
        bpy.ops.wm.quit_blender()


def main() -> None:
    parser = argparse.ArgumentParser(prog="ui_latency.py", description="Latency of the window while a training runs.")
    parser.add_argument("capture", type=Path)
    parser.add_argument("--seconds", type=float, default=30.0, help="how long to measure during training")
    parser.add_argument("--recipe", default="draft")
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
    if bpy.app.background:
        sys.exit("This measures a window: start Blender without -b.")
    bpy.context.preferences.view.show_splash = False
    frog_blender.register()
    output = Path(tempfile.mkdtemp()) / "latency.frog"
    watch = Watch(background.TrainingRequest(options.capture.resolve(), output, options.recipe), options.seconds)
    bpy.app.timers.register(watch.__call__, first_interval=INTERVAL)


main()
