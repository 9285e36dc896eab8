"""Labels of a chart's points, placed so that none covers another label, a point or the edge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

_GAP = 4.0  # pixels between boxes
_DIRECTIONS = 16
_STEP = 8.0  # pixels by which a label moves away from its point
_RINGS = 60


def place_labels(
    axes: Any, points: Sequence[tuple[float, float]], names: Sequence[str], radii: Sequence[float]
) -> None:
    """Writes each label as near its point as possible, the most crowded points first; a line leads to distant labels.

    Args:
        axes: matplotlib axes whose limits are final.
        points: in data units.
        radii: of the markers, in pixels.
    """
    renderer = _renderer(axes.figure)
    centers = [tuple(axes.transData.transform(point)) for point in points]
    blobs = [(x - r, y - r, x + r, y + r) for (x, y), r in zip(centers, radii, strict=True)]
    taken = list(blobs)
    if (legend := axes.get_legend()) is not None:
        taken.append(tuple(legend.get_window_extent(renderer).extents))
    frame = tuple(axes.get_window_extent(renderer).extents)
    crowd = [sum(math.dist(a, b) < 120 for b in centers) for a in centers]
    for index in sorted(range(len(names)), key=lambda i: (-crowd[i], i)):
        text = axes.text(*points[index], names[index], fontsize=9, ha="center", va="center", zorder=5)
        extent = text.get_window_extent(renderer)
        place = _free_place(centers[index], radii[index], (extent.width, extent.height), taken, frame)
        x, y = place
        text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5, "alpha": 0.8})  # above the front's line
        text.set_position(axes.transData.inverted().transform(place))
        box = (x - extent.width / 2, y - extent.height / 2, x + extent.width / 2, y + extent.height / 2)
        taken.append(box)
        if _gap(box, blobs[index]) > 2 * _STEP:
            ends = axes.transData.inverted().transform([centers[index], place])
            axes.plot(*zip(*ends, strict=True), color="0.6", linewidth=0.7, zorder=1)


def _renderer(figure: Any) -> Any:
    """A renderer of the figure, with everything laid out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = figure.canvas if isinstance(figure.canvas, FigureCanvasAgg) else FigureCanvasAgg(figure)
    canvas.draw()
    return canvas.get_renderer()


def _free_place(
    center: tuple[float, float],
    radius: float,
    size: tuple[float, float],
    taken: Sequence[tuple[float, ...]],
    frame: tuple[float, ...],
) -> tuple[float, float]:
    """The centre of a free box: right of the point, then around it, then further out; the point itself if none is free.

    Args:
        center, radius: of the point's marker, pixels.
        size: (width, height) of the box, pixels.
        taken: boxes (left, bottom, right, top) to avoid.
        frame: the box to stay in.
    """
    width, height = size
    for ring in range(_RINGS):
        for turn in range(_DIRECTIONS):
            angle = 2 * math.pi * turn / _DIRECTIONS
            reach = radius + _GAP + ring * _STEP
            # From the box's own edge, so that wide and flat names lie equally near.
            x = center[0] + math.cos(angle) * (reach + width / 2)
            y = center[1] + math.sin(angle) * (reach + height / 2)
            box = (x - width / 2, y - height / 2, x + width / 2, y + height / 2)
            inside = box[0] > frame[0] and box[1] > frame[1] and box[2] < frame[2] and box[3] < frame[3]
            if inside and not any(_gap(box, other) < _GAP / 2 for other in taken):
                return x, y
    return center


def _gap(a: Sequence[float], b: Sequence[float]) -> float:
    """Pixels between two boxes, 0 or less where they overlap."""
    return max(b[0] - a[2], a[0] - b[2], b[1] - a[3], a[1] - b[3])


def overlapping(figure: Any) -> list[tuple[str, str]]:
    """Pairs of visible texts of a figure that overlap."""
    from matplotlib.text import Text

    renderer = _renderer(figure)
    outside = {label for axes in figure.axes for label in _labels_outside(axes)}
    texts = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    texts = [text for text in texts if text not in outside]
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in texts]
    boxes = [(name, box) for name, box in boxes if box.width > 1 and box.height > 1]
    return [
        (name, other)
        for i, (name, box) in enumerate(boxes)
        for other, rest in boxes[i + 1 :]
        if _gap(box.extents, rest.extents) < 0
    ]


def _labels_outside(axes: Any) -> list[Any]:
    """Labels of ticks beyond the limits, which exist but are not drawn."""
    labels = []
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not low <= tick.get_loc() <= high:
                labels += [tick.label1, tick.label2]
    return labels
