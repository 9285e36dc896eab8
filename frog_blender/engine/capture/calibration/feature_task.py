"""The child's task for features: those of some of the images of standing cameras, each kept in the work folder.

pycolmap finds features inside Python's lock, so that threads win nothing: several processes share the images.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ...arrays import Array, ImageArray
from ...io.plain_values import JsonObject
from ..video import load_opencv
from .features import BACKGROUND, Features, background_features, moment_features
from .films import View
from .work_folder import WorkFolder, key_of

Tell = Callable[[str, int, int], None]


def find_features(request: JsonObject, tell: Tell) -> JsonObject:
    """Keeps the features of a request's images: of each view (``standing.calibrate_standing``) those ``moments``."""
    load_opencv().setNumThreads(1)  # the other processors are taken by the other processes
    work = WorkFolder(Path(request["work"]))
    done, all_ = 0, sum(len(entry["moments"]) for entry in request["views"])
    for entry in request["views"]:
        view = loaded(work, entry)
        for moment in entry["moments"]:
            kept_features(work, view, int(moment))
            done += 1
            tell("features", done, all_)
    return {}


def missing_features(work: WorkFolder, view: View) -> list[int]:
    """The moments, BACKGROUND among them, whose features were not kept yet."""
    moments = range(BACKGROUND, len(view.images))
    return [moment for moment in moments if not work.file("features", _key(view, moment)).is_file()]


def kept_features(work: WorkFolder, view: View, moment: int) -> Features:
    """The features of the background, or of a moment: of an earlier run or new."""
    key = _key(view, moment)
    kept = work.load("features", key)
    if kept is None:
        found = background_features(view) if moment == BACKGROUND else moment_features(view, moment)
        kept = {"pixels": found.pixels, "descriptors": found.descriptors, "moments": found.moments}
        work.keep("features", key, kept)
    return Features(kept["pixels"], kept["descriptors"], kept["moments"])


def loaded(work: WorkFolder, entry: JsonObject) -> View:
    """The view of a request's entry; FileNotFoundError if the caller did not keep it."""
    arrays = work.load("view", entry["key"])
    if arrays is None:
        raise FileNotFoundError(work.file("view", entry["key"]))
    return view_of(entry, arrays)


def arrays_of(view: View) -> dict[str, Array]:
    """A view's arrays for the work folder; ``view_of`` reads them back."""
    arrays: dict[str, Array] = {"plate": view.plate, "changing": view.changing, "shares": np.array(view.shares)}
    for kind, images in (("image", view.images), ("next", view.nexts)):
        arrays |= {f"{kind}{place}": image for place, image in enumerate(images) if image is not None}
    return arrays


def view_of(entry: JsonObject, arrays: dict[str, Array]) -> View:
    """The view of a request's entry and its arrays."""
    shares = tuple(arrays["shares"].tolist())

    def images(kind: str) -> tuple[ImageArray | None, ...]:
        return tuple(arrays.get(f"{kind}{place}") for place in range(len(shares)))

    return View(
        entry["name"],
        (int(entry["size"][0]), int(entry["size"][1])),
        arrays["plate"],
        arrays["changing"],
        images("image"),
        shares,
        images("next"),
        int(entry["group"]),
    )


def _key(view: View, moment: int) -> str:
    if moment == BACKGROUND:
        return key_of(view.plate, view.changing)
    near, towards = view.images[moment], view.nexts[moment]
    missing = np.empty(0)
    return key_of(
        missing if near is None else near,
        missing if towards is None else towards,
        view.shares[moment],
        view.changing,
        moment,
    )
