"""Events as lines: each comes back as it was, and nothing that another program prints does harm."""

import dataclasses
import json
import random
import zlib
from base64 import b64encode

import numpy as np
import pytest
from fuzzing import mutating

from frog_blender.engine.io.child_process import LONGEST_LINE
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.events import event_of, line_of

IMAGE = np.random.default_rng(0).integers(0, 256, (9, 16, 3), np.uint8)
REPORT = {
    "gaussians": 500,
    "dynamic": 40,
    "sh_degree": 2,
    "reductions": [{"what": "pruned", "before": 900, "after": 500, "progress": 0.5, "loss": None, "bytes": 12}],
}
EVENTS = [
    events.Stage("decoding frames", 3, 10),
    events.Started("frog", 50, 3, 10, 100, "cuda", 4096, 30),
    events.Started("frog", None, 3, 10, 100),
    events.Progress(7, 50, 1.25, 9.5, 0.0421, 320, 200),
    events.Statistics(7, {"l1": 0.03, "alpha": 0.0}, {"means": 1e-4}, 30, 12),
    events.Reduced(30, "120 Gaussians came to rest \u2192 \u00e4"),
    events.Evaluated(40, 27.5, "held-out", 3.5),
    events.Preview(40, IMAGE),
    events.WarningEvent('The room is "dark".'),
    events.Saved("/out/x.frog"),
    events.Finished("/out/x.frog", 50, 5.0, 28.0, 500, REPORT, {"decoding": 0.5, "training": 5.0}),
    events.Finished("/out/x.frog", 50, 5.0, None, 500),
    events.Cancelled(3, "/out/x.frog"),
    events.Cancelled(0, None),
]


def same(first: object, second: object) -> bool:
    """Fields of images as well, which ``==`` does not compare."""
    if type(first) is not type(second):
        return False
    names = [field.name for field in dataclasses.fields(first)]  # type: ignore[arg-type]
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names)


def read(**values: object) -> object:
    return event_of(json.dumps(values).encode())


def test_the_table_has_every_event() -> None:
    assert {type(event) for event in EVENTS} == set(events.Event.__subclasses__())


@pytest.mark.parametrize("event", EVENTS, ids=lambda event: type(event).__name__)
def test_an_event_comes_back_as_it_was(event: events.Event) -> None:
    line = line_of(event)
    assert line is not None and "\n" not in line and line.isascii()
    assert same(event, event_of(f"{line}\n".encode()))


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"Welcome to gpu7!\n",
        b"\xff\xfe\x00",
        b"null",
        b"{}",
        b'{"event": "explosion"}',
        b'{"event": ["stage"]}',
        b'{"event": "stage", "name": "x", "done": 1}',
        b'{"event": "stage", "name": "x", "done": 1.5, "total": 2}',
        b'{"event": "stage", "name": "x", "done": true, "total": 2}',
        b'{"event": "stage", "name": "x", "done": -1, "total": 2}',
        b'{"event": "stage", "name": 7, "done": 1, "total": 2}',
        b'{"event": "stage", "name": "' + b"x" * 5000 + b'", "done": 1, "total": 2}',
        b'{"event": "evaluated", "step": 1, "psnr": 1e999, "split": ""}',
        b'{"event": "evaluated", "step": 1' + b"0" * 5000 + b', "psnr": 1, "split": ""}',
        b'{"event": "cancelled", "step": 1, "path": 5}',
        b"[" * 10**5,
        b'{"event": "saved", "path": "x", "more": "' + b"x" * 2**18 + b'"}',
    ],
    ids=lambda line: line[:40].decode("ascii", "replace"),
)
def test_what_is_no_event_is_skipped(line: bytes) -> None:
    assert event_of(line) is None


def test_a_newer_version_may_say_more_and_an_older_one_less() -> None:
    assert read(event="saved", path="x.frog", size=7) == events.Saved("x.frog")
    assert read(event="evaluated", step=1, psnr=20, split="training") == events.Evaluated(1, 20.0, "training")


def test_numbers_that_json_has_not() -> None:
    line = line_of(events.Finished("x.frog", 1, 1.0, float("inf"), 5))
    assert line is not None and event_of(line.encode()) == events.Finished("x.frog", 1, 1.0, None, 5)
    line = line_of(events.Progress(1, 2, 1.0, 1.0, float("nan"), 5))
    assert line is not None and "NaN" not in line and event_of(line.encode()) is None


def test_text_cannot_command_a_terminal() -> None:
    assert read(event="warning", message="a\x1b[2Jb") == events.WarningEvent("a\\x1b[2Jb")


@pytest.mark.parametrize(
    "image",
    [
        None,
        {"height": 2, "width": 2},
        {"height": 2, "width": 2, "rgb": "not base64!"},
        {"height": 2, "width": 2, "rgb": b64encode(b"not deflated").decode()},
        {"height": 2, "width": 2, "rgb": b64encode(zlib.compress(bytes(11))).decode()},
        {"height": 2, "width": 2, "rgb": b64encode(zlib.compress(bytes(10**7))).decode()},
        {"height": 10**6, "width": 10**6, "rgb": ""},
        {"height": 0, "width": 2, "rgb": ""},
    ],
)
def test_images_that_are_none(image: object) -> None:
    assert read(event="preview", step=1, image=image) is None


def test_a_large_image_is_sent_smaller() -> None:
    line = line_of(events.Preview(1, np.full((1500, 2600, 3), 77, np.uint8)))
    preview = event_of(line.encode()) if line is not None else None
    assert isinstance(preview, events.Preview) and preview.image.shape == (500, 867, 3) and (preview.image == 77).all()
    noise = np.random.default_rng(1).integers(0, 256, (1024, 1024, 3), np.uint8)
    line = line_of(events.Preview(1, noise))
    assert line is not None and len(line) < LONGEST_LINE


@pytest.mark.parametrize("capacity", [[], {"gaussians": 5}, {**REPORT, "dynamic": "x"}, {**REPORT, "reductions": [3]}])
def test_reports_that_nobody_could_read_out(capacity: object) -> None:
    values = {"path": "x", "steps": 1, "seconds": 1, "psnr": None, "gaussians": 1}
    assert read(event="finished", **values, capacity=capacity) is None
    assert read(event="finished", **values, capacity={**REPORT, "reductions": REPORT["reductions"] * 2000}) is None


def test_mutated_lines_end_nothing() -> None:
    """Bytes changed, left out, doubled, and values swapped for others of any kind."""
    chance = random.Random(3)
    lines = [str(line_of(event)) for event in EVENTS]
    understood = 0
    for _ in range(400):
        change = chance.choice((mutating.flipped, mutating.torn, mutating.words))
        line = change(chance.choice(lines).encode(), chance)
        understood += event_of(line) is not None
    for _ in range(400):
        values = json.loads(chance.choice(lines))
        values[chance.choice(list(values))] = chance.choice(mutating.HOSTILE)
        understood += event_of(json.dumps(values).encode()) is not None
    assert understood < 600
