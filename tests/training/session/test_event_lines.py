"""Events as lines of JSON: every kind, plain numbers alone, and images of a size that a front end can take."""

import json
import zlib
from base64 import b64decode

import numpy as np
import pytest

from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.events import line_of

IMAGE = np.random.default_rng(0).integers(0, 256, (9, 16, 3), np.uint8)
EVENTS = [
    events.Stage("decoding frames", 3, 10),
    events.Started("frog", None, 3, 10, 100),
    events.Progress(7, 50, 1.25, 9.5, 0.0421, 320, 200),
    events.Statistics(7, {"l1": 0.03, "alpha": 0.0}, {"means": 1e-4}, 30, 12),
    events.Reduced(30, "120 Gaussians came to rest \u2192 \u00e4"),
    events.Evaluated(40, 27.5, "held-out", 3.5),
    events.Preview(40, IMAGE),
    events.WarningEvent('The room is "dark".'),
    events.Saved("/out/x.frog"),
    events.Finished("/out/x.frog", 50, 5.0, 28.0, 500, {"gaussians": 500}, {"decoding": 0.5, "training": 5.0}),
    events.Cancelled(0, None),
]


def test_the_table_has_every_event() -> None:
    assert {type(event) for event in EVENTS} == set(events.Event.__subclasses__())


@pytest.mark.parametrize("event", EVENTS, ids=lambda event: type(event).__name__)
def test_a_line_says_all_of_an_event(event: events.Event) -> None:
    line = line_of(event)
    assert "\n" not in line and line.isascii()
    values = json.loads(line)
    assert values.pop("event") == type(event).__name__.removesuffix("Event").lower()
    if isinstance(event, events.Preview):
        assert zlib.decompress(b64decode(values.pop("image")["rgb"])) == event.image.tobytes()
    assert values == {name: value for name, value in vars(event).items() if name != "image"}


def test_numbers_that_json_has_not() -> None:
    assert json.loads(line_of(events.Finished("x.frog", 1, 1.0, float("inf"), 5)))["psnr"] is None
    assert json.loads(line_of(events.Progress(1, 2, 1.0, 1.0, float("nan"), 5)))["loss"] is None


def test_a_large_image_is_sent_smaller() -> None:
    image = json.loads(line_of(events.Preview(1, np.full((1500, 2600, 3), 77, np.uint8))))["image"]
    assert (image["height"], image["width"]) == (500, 867)
