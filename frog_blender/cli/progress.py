"""Training events and other long work as progress bars on a terminal (tqdm)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from tqdm import tqdm

from ..engine.errors import printable
from ..engine.scene.compression_report import lines, summary
from ..engine.training.session import events
from ..engine.training.session.events import Event
from ..engine.training.session.output_paths import checkpoint_path
from ..engine.training.session.time_estimate import about
from .printing import complain, say


@contextmanager
def stage_bars() -> Iterator[Callable[[str, int, int], None]]:
    """Yields ``report(stage, done, total)``, which shows a bar for each stage in turn."""
    line: tqdm | None = None

    def report(stage: str, done: int, total: int) -> None:
        nonlocal line
        if line is None or line.desc != stage:
            _close(line)
            line = tqdm(desc=stage, file=sys.stderr, leave=False)
        line.total = total
        line.update(done - line.n)

    try:
        yield report
    finally:
        _close(line)


@contextmanager
def bar(name: str) -> Iterator[Callable[[int, int], None]]:
    """Yields ``report(done, total)``; nothing is shown before its first call."""
    with stage_bars() as report:
        yield partial(report, name)


def show(stream: Iterator[Event], output: Path, prefix: str = "") -> bool:
    """Follows a training to ``output`` to its end; True when it finished, False when it was cancelled. ``prefix`` is
    said before each stage's name."""
    line: tqdm | None = None

    def switch(name: str, total: int, done: int) -> tqdm:
        nonlocal line
        name = prefix + name
        if line is None or line.desc != name:
            if line is not None:
                line.close()
            line = tqdm(desc=name, total=total, file=sys.stderr, smoothing=0.1)
        line.total = total
        line.update(done - line.n)
        return line

    try:
        for event in stream:
            match event:
                case events.Stage(name, done, total):
                    switch(name, total, done)
                case events.Started(device="cuda"):
                    _note("training on the GPU")
                case events.Progress(step, steps, _, left, loss, gaussians, num_dynamic):
                    figures = {"loss": f"{loss:.4f}", "gaussians": gaussians, "dynamic": num_dynamic}
                    postfix = {**figures, "left": about(left)}
                    switch("Training", steps, step).set_postfix(postfix)
                case events.Reduced(_, message):
                    _note(message)
                case events.Evaluated(step=step, psnr=psnr, split=split):
                    _note(f"{prefix}step {step}: {split} PSNR {psnr:.2f} dB")
                case events.CompressionPreview(path, _):
                    text = f"{path}: dynamic Gaussians are orange, static ones blue, pruned ones red dots"
                    _note(text)
                case events.WarningEvent(message):
                    _note(f"warning: {message}")
                case events.Finished(path, steps, seconds, psnr, gaussians, capacity, phases):
                    _close(line)
                    quality = "PSNR not measured" if psnr is None else f"PSNR {psnr:.2f} dB"
                    whole = f" ({sum(phases.values()):.0f} s in all)" if phases else ""
                    say(f"{path}: {steps} steps in {seconds:.0f} s{whole}, {gaussians} Gaussians, {quality}")
                    for text in [summary(capacity), *lines(capacity)] if capacity else []:
                        say(f"  {text}")
                    return True
                case events.Cancelled(step, path):
                    _close(line)
                    complain(f"cancelled at step {step}, {_kept(path, output)}.")
                    return False
    finally:
        _close(line)
    return False


def _kept(path: str | None, output: Path) -> str:
    """What is left of a training that was cancelled: its checkpoint lies beside ``output``, wherever the scene went."""
    if path is None:
        return "nothing was written"
    if not checkpoint_path(output).is_file():
        return f"kept in {path}"
    return f"kept in {path}; --resume goes on" + ("" if Path(path) == output else f" from {checkpoint_path(output)}")


def _note(text: str) -> None:
    """A line above the bars."""
    tqdm.write(printable(text), file=sys.stderr)


def _close(line: tqdm | None) -> None:
    if line is not None:
        line.close()
