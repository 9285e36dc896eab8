"""What the arrays of a calibration's stages look like: a file that anybody may have written is taken for no other."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from ...arrays import Array

_Form = Mapping[str, tuple[str, str]]
"""By a pattern of names: the kind of numbers, and lengths; a letter is one length in all arrays of a file."""

_FEATURES: _Form = {"pixels": ("f8", "N 2"), "descriptors": ("u1", "N 128")}
_MATCHES: _Form = {r"\d{1,6} \d{1,6}": ("i8", "? 2")}
_VIEW: _Form = {
    "plate": ("u1", "H W"),
    "changing": ("b1", "H W"),
    "shares": ("f8", "M"),
    r"(image|next)\d{1,6}": ("u1", "H W"),
}
_FORMS: Mapping[str, _Form] = {
    "standing": {"standing": ("b1", "")},
    "sharp": {"frames": ("i8", "N")},
    "look": _VIEW,
    "view": _VIEW,
    "features": {**_FEATURES, "moments": ("i8", "N")},
    "image": _FEATURES,
    "pairs": {r"\d{1,6} \d{1,6}( verified)?": ("i8", "? 2")},
    "sequence": _MATCHES,
    "held": _MATCHES,
    "look_for_motion": {"times": ("f8", "N"), "energies": ("f8", "N"), "changing": ("u1", "H W")},
    "moving_points": {
        "keyframes": ("i8", "N"),
        "key_times": ("f8", "K"),
        "times": ("f8", "N T"),
        "tracks": ("f8", "N T 2"),
        "descriptors": ("f4", "N 128"),
    },
}
_MAY_MISS = r"\d"  # patterns of numbered arrays may fit none
_MAY_BE_NAN = ("tracks",)  # where a point was lost


def fits(stage: str, arrays: Mapping[str, Array]) -> bool:
    """Whether the arrays are those of a stage: names, kinds, lengths, finite numbers. Any stage without a form fits."""
    form = _FORMS.get(stage)
    if form is None:
        return True
    if any(_MAY_MISS not in name and name not in arrays for name in form):
        return False
    lengths: dict[str, int] = {}
    for name, array in arrays.items():
        found = next((each for pattern, each in form.items() if re.fullmatch(pattern, name)), None)
        if found is None or not _fits(array, found, lengths):
            return False
        if array.dtype.kind == "f" and name not in _MAY_BE_NAN and not np.isfinite(array).all():
            return False
    return True


def _fits(array: Array, form: tuple[str, str], lengths: dict[str, int]) -> bool:
    kind, named = form
    wanted = named.split()
    if array.dtype != np.dtype(kind) or array.ndim != len(wanted):
        return False
    for length, name in zip(array.shape, wanted, strict=True):
        if name == "?":
            continue
        if length != (int(name) if name.isdigit() else lengths.setdefault(name, length)):
            return False
    return True
