"""The frames of films that PyAV has open, behind FFmpeg's filters, and what they show whatever their files say."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import ImageArray

_WATCHED = 50  # frames, by which it is judged what a film shows
_REPEATS = 1.15  # frames a picture, from which on a film is said to repeat them


def decoded(container: Any, stream: Any) -> Iterator[Any]:
    """The frames of a track, what is damaged left out."""
    import av

    for packet in container.demux(stream):
        try:
            yield from packet.decode()
        except av.error.InvalidDataError:
            continue


def _graph(stream: Any, *filters: tuple[str, str]) -> Any:
    """An ``av.filter.Graph`` of FFmpeg's filters, by their names and options, for the frames of a track."""
    import av

    graph = av.filter.Graph()
    added = [graph.add(*filter_and_options) for filter_and_options in filters]
    graph.link_nodes(graph.add_buffer(template=stream), *added, graph.add("buffersink")).configure()
    return graph


def filtered(container: Any, stream: Any, name: str, options: str = "") -> Iterator[Any]:
    """A track's frames behind one of FFmpeg's filters."""
    import av

    graph = _graph(stream, (name, options))
    for frame in chain(decoded(container, stream), [None]):
        graph.push(frame)
        with suppress(av.error.BlockingIOError, av.error.EOFError):
            while True:
                yield graph.pull()


def to_rgb(stream: Any, matrix: str) -> Callable[[Any], ImageArray]:
    """What makes (H, W, 3) uint8 RGB of a track's frame.

    Not ``av.VideoFrame.to_ndarray``, whose versions disagree about matrix and range.

    Args:
        matrix: FFmpeg's name of the colours', "auto" for what the file says.
    """
    graph = _graph(stream, ("scale", f"in_color_matrix={matrix}"), ("format", "rgb24"))

    def image_of(frame: Any) -> ImageArray:
        graph.push(frame)
        return np.asarray(graph.pull().to_ndarray())

    return image_of


def seen(container: Any, stream: Any) -> tuple[str, float]:
    """The fields that a track's first frames show, as ``FilmHeader.fields`` has them or "unknown", and how many in turn
    are the same."""
    images: list[NDArray[np.int16]] = []
    counts = dict.fromkeys(("tff", "bff", "progressive"), 0.0)
    small = {"width": 96, "height": 54, "format": "gray", "interpolation": "AREA"}
    for frame in islice(filtered(container, stream, "idet"), _WATCHED):
        said = getattr(frame, "metadata", {})  # which older versions of PyAV do not hand out
        counts = {kind: float(said.get(f"lavfi.idet.multiple.{kind}", 0)) for kind in counts}
        images.append(frame.to_ndarray(**small).astype(np.int16))
    steps = np.abs(np.diff(images, axis=0)).mean(axis=(1, 2)) if len(images) > 1 else np.zeros(1)
    gaps = np.diff(np.flatnonzero(steps > 0.1 * np.percentile(steps, 95)))  # images from one that is new to the next
    is_regular = len(gaps) >= 5 and gaps.max() <= 2 * np.median(gaps)  # else people stood still for a while
    most = max(counts, key=counts.__getitem__)
    fields = "unknown" if not counts[most] else "" if most == "progressive" else most
    return fields, float(gaps.mean()) if is_regular and gaps.mean() >= _REPEATS else 1.0
