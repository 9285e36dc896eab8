"""Training events and other long work as progress bars on a terminal (tqdm), or as lines for another program."""

import io
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from ..engine.errors import printable
from ..engine.scene.compression_report import lines, summary
from ..engine.training.session import events
from ..engine.training.session.output_paths import checkpoint_path
from ..engine.whole_progress import Standing, about
from .terminal import Output, complain, log_line, say

_LINE_EVERY = 5.0  # seconds, where there is no terminal


class Line(tqdm):
    """A bar on a terminal. Elsewhere, and in a log, it is a plain line every few seconds."""

    def __init__(self, **options: Any) -> None:
        shows, self._told_until = sys.stderr.isatty() and not Output.quiet, 0.0
        super().__init__(file=sys.stderr if shows else io.StringIO(), **options)

    def display(self, msg: str | None = None, pos: int | None = None) -> None:
        """See tqdm, which calls it several times a second at most."""
        if self.fp is not None and not isinstance(self.fp, io.StringIO):
            super().display(msg, pos)
        if msg is None and self.desc and time.monotonic() >= self._told_until:
            self._told_until = time.monotonic() + _LINE_EVERY
            plain = self.format_meter(**{**self.format_dict, "bar_format": "{desc}: {percentage:.0f} %{postfix}"})
            if sys.stderr.isatty() or Output.quiet:
                log_line(plain)
            else:
                print(plain, file=sys.stderr, flush=True)


class _Bars:
    """One progress bar at a time: it is closed when the next kind of work begins."""

    def __init__(self, **options: object) -> None:
        self._options = options
        self._line: Line | None = None

    def report(self, name: str, done: int, total: int, **figures: object) -> None:
        """Shows the bar of that name, at ``done`` of ``total``, and figures behind it."""
        if self._line is None or self._line.desc != name:
            self.close()
            self._line = Line(desc=name, total=total, **self._options)
        self._line.total = total
        self._line.update(done - self._line.n)
        if figures:
            self._line.set_postfix(figures)

    def close(self) -> None:
        if self._line is not None:
            self._line.close()


@contextmanager
def whole_bar() -> Iterator[Callable[[Standing], None]]:
    """Yields what shows where work in stages is, as one bar."""
    shown = "{desc}: {percentage:.0f}%|{bar}|{postfix}"
    with closing(Line(total=1.0, leave=False, bar_format=shown)) as line:

        def told(standing: Standing) -> None:
            line.set_description_str(standing.stage, refresh=False)
            line.set_postfix_str(f"{about(standing.seconds_left)} left", refresh=False)
            line.update(standing.fraction - line.n)

        yield told


@contextmanager
def bar(name: str) -> Iterator[Callable[[int, int], None]]:
    """Yields ``report(done, total)``; nothing is shown before its first call."""
    with closing(_Bars(leave=False)) as bars:
        yield partial(bars.report, name)


def show(stream: Iterator[events.Event], output: Path, prefix: str = "") -> bool:
    """Follows a training to ``output`` to its end; True when it finished, False when it was cancelled. ``prefix`` is
    said before each stage's name."""
    with closing(_Bars(smoothing=0.1)) as bars:
        for event in stream:
            match event:
                case events.Stage(name, done, total, _, left):
                    bars.report(prefix + name, done, total, left=about(left))
                case events.Started(device="cuda"):
                    _note("training on the GPU")
                case events.Progress(step, steps, _, left, loss, gaussians, num_dynamic):
                    figures = {"loss": f"{loss:.4f}", "gaussians": gaussians, "dynamic": num_dynamic}
                    bars.report(f"{prefix}Training", step, steps, **figures, left=about(left))
                case events.Reduced(_, message):
                    _note(message)
                case events.Evaluated(step=step, psnr=psnr, split=split):
                    _note(f"{prefix}step {step}: {split} PSNR {psnr:.2f} dB")
                case events.WarningEvent(message):
                    tqdm.write(printable(f"warning: {message}"), file=sys.stderr)
                case events.Finished(path, steps, seconds, psnr, gaussians, capacity, phases):
                    bars.close()
                    quality = "PSNR not measured" if psnr is None else f"PSNR {psnr:.2f} dB"
                    whole = f" ({sum(phases.values()):.0f} s in all)" if phases else ""
                    say(f"{path}: {steps} steps in {seconds:.0f} s{whole}, {gaussians} Gaussians, {quality}")
                    for text in [summary(capacity), *lines(capacity)] if capacity else []:
                        say(f"  {text}")
                    return True
                case events.Cancelled(step, path):
                    bars.close()
                    complain(f"cancelled at step {step}, {_kept(path, output)}.")
                    return False
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
    if Output.quiet:
        log_line(printable(text))
    else:
        tqdm.write(printable(text), file=sys.stderr)


def tell(stream: Iterator[events.Event]) -> bool:
    """Prints each event as a line of JSON; True when the training finished, False when it was cancelled."""
    finished = False
    for event in stream:
        print(events.line_of(event), flush=True)
        finished = isinstance(event, events.Finished)
    return finished
