"""Images of moving cameras: their features, and the matches between those that may see the same things."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product
from pathlib import Path

import numpy as np

from ...arrays import Ints
from ...io.plain_values import JsonObject
from ..video import read_gray
from .features import BACKGROUND, SMALL, Extractor, Features
from .films import resized
from .lens import Lens
from .matching import match
from .tracks import Pairs
from .two_view import verified
from .work_folder import WorkFolder, key_of, key_of_file

Tell = Callable[[str, int, int], None]
EXHAUSTIVE = 60
"""Images up to which every pair is matched, and the incremental mapper alone is asked."""
_OVERLAP = 10  # neighbours in time that an image is matched with, besides those 2, 4, 8, ... images away
_GLANCES = 12  # images of each camera that are compared with those of another camera before their neighbours are
_FOLLOWED = 40  # pairs of two cameras' images about which neighbours are compared as well


@dataclass(frozen=True)
class Walk:
    """The images of one moving camera, in order.

    Attributes:
        name: of the camera.
        images: the files.
        size: width and height in pixels of each.
        group: cameras of one group share their lens.
    """

    name: str
    images: tuple[Path, ...]
    size: tuple[int, int]
    group: int = 0

    def plain(self) -> JsonObject:
        """As a request to the child holds it; ``walk_of`` reads it back."""
        images = [str(path) for path in self.images]
        return {"name": self.name, "images": images, "size": list(self.size), "group": self.group}


def walk_of(entry: JsonObject) -> Walk:
    """The walk that a request holds."""
    size = (int(entry["size"][0]), int(entry["size"][1]))
    return Walk(str(entry["name"]), tuple(Path(name) for name in entry["images"]), size, int(entry["group"]))


def walk_features(work: WorkFolder, walks: Sequence[Walk], tell: Tell) -> list[Features]:
    """The features of all images, walk by walk, of an earlier run or new.

    Raises:
        FrogError: for an image that cannot be read.
    """
    wanted = [(path, walk.size) for walk in walks for path in walk.images]
    found = []
    for place, (path, size) in enumerate(wanted):
        tell("features", place, len(wanted))
        found.append(_features(work, path, size))
    return found


def _features(work: WorkFolder, path: Path, size: tuple[int, int]) -> Features:
    key = key_of(key_of_file(path))
    kept = work.load("image", key)
    if kept is None:
        gray = resized(read_gray(path), size)
        pixels, descriptors = Extractor(upsampled=max(size) < SMALL).of(gray)
        scale = np.array(size) / gray.shape[::-1]
        kept = {"pixels": pixels.astype(np.float64) * scale, "descriptors": descriptors}
        work.keep("image", key, kept)
    return Features(kept["pixels"], kept["descriptors"], np.full(len(kept["pixels"]), BACKGROUND, np.int64))


def walk_pairs(work: WorkFolder, walks: Sequence[Walk], features: Sequence[Features], tell: Tell) -> Pairs:
    """Verified matches between the images of all walks, of an earlier run or new."""
    key = key_of([key_of_file(path) for walk in walks for path in walk.images], [len(walk.images) for walk in walks])
    kept = work.load("sequence", key)
    if kept is None:
        lenses = [Lens(*walk.size, 1.2 * walk.size[0]) for walk in walks for _ in walk.images]
        starts = np.cumsum([0, *(len(walk.images) for walk in walks)]).tolist()
        parts = [range(start, end) for start, end in pairwise(starts)]
        if len(features) <= EXHAUSTIVE:
            found = compared(lenses, features, list(combinations(range(len(features)), 2)), tell)
        else:
            found = {}
            for part in parts:
                found |= compared(lenses, features, [(part[i], part[j]) for i, j in neighbours(len(part))], tell)
            for one, other in combinations(parts, 2):
                found |= across(lenses, features, one, other, tell)
        kept = {f"{one} {other}": matches for (one, other), matches in found.items()}
        work.keep("sequence", key, kept)
    return {(int(name.split()[0]), int(name.split()[1])): array for name, array in kept.items()}


def neighbours(count: int) -> list[tuple[int, int]]:
    """Pairs of a walk's images to match: all of few, else those near in time and at growing distances."""
    if count <= EXHAUSTIVE:
        return list(combinations(range(count), 2))
    steps = sorted({*range(1, _OVERLAP + 1), *(2**power for power in range(4, 12))})
    return [(one, one + step) for one in range(count) for step in steps if one + step < count]


def across(
    lenses: Sequence[Lens], features: Sequence[Features], one: Sequence[int], other: Sequence[int], tell: Tell
) -> dict[tuple[int, int], Ints]:
    """Verified matches between two sequences of images: first of a few, then of those about the best of them."""
    near, far = (np.unique(np.linspace(0, len(each) - 1, _GLANCES).round().astype(int)) for each in (one, other))
    found = compared(lenses, features, [(one[i], other[j]) for i, j in product(near.tolist(), far.tolist())], tell)
    best = sorted(found, key=lambda pair: -len(found[pair]))[:_FOLLOWED]
    shifts = [_shifts(len(each)) for each in (one, other)]
    places = [{image: place for place, image in enumerate(each)} for each in (one, other)]
    more = {
        (one[i], other[j])
        for a, b in best
        for i, j in product((places[0][a] + s for s in shifts[0]), (places[1][b] + s for s in shifts[1]))
        if 0 <= i < len(one) and 0 <= j < len(other)
    }
    return found | compared(lenses, features, sorted(more - set(found)), tell)


def _shifts(count: int) -> list[int]:
    """Places about an image that was compared at which its neighbours are, none of a camera that stands."""
    step = count / _GLANCES
    return sorted({round(share * step) for share in (-0.4, 0.0, 0.4)}) if step > 1 else [0]


def compared(
    lenses: Sequence[Lens], features: Sequence[Features], pairs: Iterable[tuple[int, int]], tell: Tell
) -> dict[tuple[int, int], Ints]:
    """The verified matches (M, 2) of those pairs of images that have any."""
    wanted, found = list(pairs), {}
    for place, (one, other) in enumerate(wanted):
        tell("matches", place, len(wanted))
        a, b = features[one], features[other]
        checked = verified(lenses[one], a.pixels, lenses[other], b.pixels, match(a, b))
        if len(checked):
            found[one, other] = checked
    return found
