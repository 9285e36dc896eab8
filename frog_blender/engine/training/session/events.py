"""What a training tells while it runs, and the same as lines of JSON for a front end in another process. No torch.

Events have plain values alone: safe to pass between threads, and to any front end. A line may come from another
computer, so nothing in it is believed: kinds, sizes and ranges are checked when it is read, and what is no event is
skipped.
"""

from __future__ import annotations  # the types of fields are texts, by which lines are checked

import base64
import json
import math
import re
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...io.child_process import LONGEST_LINE
from ...io.plain_values import JsonObject, UnfitValue, entries, items, number, plain_json, text, whole
from ...io.unpacking import inflated
from ...scene.compression_report import readable_report


@dataclass(frozen=True)
class Event:
    """What a training tells: one of the kinds below."""


@dataclass(frozen=True)
class Stage(Event):
    """Work before the steps, as decoding frames and finding seed points, and after them, as saving."""

    name: str
    done: int
    total: int
    fraction: float = 0.0
    """Of the whole run by the clock, 0 to 1: it never falls."""
    seconds_left: float = 0.0
    """By the clock, to the end of the run: an estimate."""


@dataclass(frozen=True)
class Started(Event):
    """The steps begin: what is trained, and on what."""

    method: str
    steps: int | None
    """None when the training is limited by time instead."""
    cameras: int
    frames: int
    gaussians: int
    device: str = "cpu"
    """"cpu" or "cuda"."""
    pixels: int = 0
    """Of an image, in the mean over the cameras."""
    images: int = 0
    """Of the capture."""
    step: int = 0
    """That a resumed training begins with."""


@dataclass(frozen=True)
class Progress(Event):
    """A few times a second: where the training is. Seconds are of training, ``loss`` is a running mean."""

    step: int
    steps: int
    """An estimate when the training is limited by time."""
    seconds: float
    seconds_left: float
    """By the clock, to the end of the run: an estimate."""
    loss: float
    gaussians: int
    num_dynamic: int = 0
    """Those of them that the network deforms."""
    fraction: float = 0.0
    """Of the whole run by the clock, 0 to 1: it never falls."""


@dataclass(frozen=True)
class Statistics(Event):
    """After each Progress, for loggers: figures of its step."""

    step: int
    losses: dict[str, float]
    """What the loss of this step's image is the sum of, with weights: by name of ``registry.LOSSES``, and "alpha"."""
    rates: dict[str, float]
    """Learning rates by group of parameters."""
    added: int
    """Gaussians that densification and sampling have added since the run began, or was resumed."""
    removed: int
    """Those that were pruned or replaced since then."""


@dataclass(frozen=True)
class Reduced(Event):
    """A compression step was applied."""

    step: int
    message: str
    """What a compression step did, in words."""


@dataclass(frozen=True)
class Evaluated(Event):
    """The scene was compared with images; PSNR in dB."""

    step: int
    psnr: float
    split: str
    """"held-out", or "training" when nothing is held out."""
    seconds: float = 0.0
    """Of training so far."""


@dataclass(frozen=True)
class Preview(Event):
    """An image of the scene as it stands."""

    step: int
    image: NDArray[np.uint8] = field(repr=False)
    """(H, W, 3) uint8."""


@dataclass(frozen=True)
class WarningEvent(Event):
    """One sentence that the user is to read; the training goes on."""

    message: str


@dataclass(frozen=True)
class Saved(Event):
    """A checkpoint or a scene lies on the disk."""

    path: str


@dataclass(frozen=True)
class Finished(Event):
    """The last event: the scene is written. PSNR in dB."""

    path: str
    steps: int
    seconds: float
    """Of training, without evaluation and saving."""
    psnr: float | None
    """None where it could not be measured."""
    gaussians: int
    capacity: JsonObject = field(default_factory=dict, repr=False)
    """See SceneHeader."""
    phases: dict[str, float] = field(default_factory=dict)
    """Seconds by the clock, without pauses, of decoding, seeding, training and finishing."""


@dataclass(frozen=True)
class Cancelled(Event):
    """The last event of a training that was ended early."""

    step: int
    path: str | None
    """The scene that was saved; None when training had not begun."""


_LONGEST_PLAIN = 2**18  # bytes of a line without an image
_LARGEST_SIDE = 1024  # pixels of an image; larger ones are sent with fewer
_LONGEST_TEXT = 4096
_MOST = 2**53  # of what is counted: every JSON reader keeps such numbers exactly
_MOST_NUMBERS = 64
_MOST_REDUCTIONS = 1024

Check = Callable[[object, str], Any]
"""Takes a JSON value and its name, and returns the field; UnfitValue for what cannot be one."""


def line_of(event: Event) -> str | None:
    """An event as one line without its end; None for one that would be too long to be read."""
    values = {field_.name: _plain(getattr(event, field_.name)) for field_ in fields(event)}
    line = json.dumps({"event": _word(type(event)), **values}, allow_nan=False)
    return line if len(line) < _longest(type(event)) else None


def event_of(line: bytes) -> Event | None:
    """The event that a line tells; None for an unknown kind, a damaged line and whatever else a program may print.

    Fields that are not known are skipped: the other computer may have another version.
    """
    try:
        values = entries(plain_json(line.decode("utf-8"), "an event"), "an event")
        event = _KINDS[_text(values.get("event"), "event")]
        if len(line) > _longest(event):
            return None
        given = [field_ for field_ in fields(event) if field_.name in values]
        return event(**{field_.name: _checked(str(field_.type), values[field_.name], field_.name) for field_ in given})
    except (ValueError, TypeError, KeyError):  # a TypeError where fields are missing
        return None


def _longest(event: type[Event]) -> int:
    return LONGEST_LINE if event is Preview else _LONGEST_PLAIN


def _plain(value: object) -> object:
    """A field as JSON takes it; None for a number that is not finite."""
    if isinstance(value, np.ndarray):
        return _packed(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _packed(image: NDArray[np.uint8]) -> dict[str, object]:
    """An image with at most _LARGEST_SIDE pixels a side. No PNG: who reads it may have nothing that opens one."""
    step = -(-max(image.shape[:2]) // _LARGEST_SIDE)
    smaller = np.ascontiguousarray(image[::step, ::step])
    deflated = base64.b64encode(zlib.compress(smaller.tobytes())).decode("ascii")
    return {"height": smaller.shape[0], "width": smaller.shape[1], "rgb": deflated}


def _image(value: object, what: str) -> NDArray[np.uint8]:
    """(H, W, 3) uint8; no more is inflated than its size says."""
    values = entries(value, what)
    height, width = (whole(values.get(name), name, 1, _LARGEST_SIDE) for name in ("height", "width"))
    size, packed = 3 * height * width, values.get("rgb")
    if type(packed) is not str:
        raise UnfitValue(f"{what} without pixels", "some")
    pixels = inflated(base64.b64decode(packed, validate=True), size, what)
    return np.frombuffer(pixels, np.uint8).reshape(height, width, 3)


_text = partial(text, longest=_LONGEST_TEXT)
_number = partial(number, least=-1e12, most=1e12)


def _numbers(value: object, what: str) -> dict[str, float]:
    values = entries(value, what)
    items(list(values), what, _MOST_NUMBERS)
    return {_text(name, what): _number(figure, what) for name, figure in values.items()}


def _report(value: object, what: str) -> dict[str, Any]:
    report = readable_report(value)
    items(report.get("reductions", []), "reductions", _MOST_REDUCTIONS)
    return report


_CHECKS: Mapping[str, Check] = {
    "str": _text,
    "int": partial(whole, least=0, most=_MOST),
    "float": _number,
    "NDArray[np.uint8]": _image,
    "JsonObject": _report,
    "dict[str, float]": _numbers,
}
"""By the type of a field, how it is read."""


def _checked(type_: str, value: object, what: str) -> Any:
    """A field of that type."""
    plain = type_.removesuffix(" | None")
    return None if value is None and plain != type_ else _CHECKS[plain](value, what)


def _word(event: type[Event]) -> str:
    """What stands for it in a line: ``WarningEvent`` is "warning"."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", event.__name__.removesuffix("Event")).lower()


_KINDS: Mapping[str, type[Event]] = {_word(event): event for event in Event.__subclasses__()}
"""By the word in a line."""
