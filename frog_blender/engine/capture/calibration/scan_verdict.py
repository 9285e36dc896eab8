"""Whether standing cameras in a walk-through's world are to be believed, in sentences that name cameras."""

from __future__ import annotations

from collections.abc import Sequence

from .belief import doubts, is_apart, is_contradicted, is_doubtful, is_unsure, is_weak, percent
from .evidence import CLOSES, CameraEvidence
from .scan_solve import Joined
from .tracks import Pairs
from .verdict import listed

_REMEDY = (
    "Next time start the walk-through beside that camera, at its height, and walk on slowly, so that the film shows "
    "what the camera sees from near its place"
)


def unplaced(names: Sequence[str], lost: Sequence[int], pairs: Pairs) -> str:
    """The refusal for standing cameras that the walk-through does not place."""
    matching = [max((len(found) for pair, found in pairs.items() if index in pair), default=0) for index in lost]
    listed = ", ".join(f"{names[index]} (at most {most})" for index, most in zip(lost, matching, strict=True))
    return (
        f"The walk-through does not show enough of what {_listed([names[i] for i in lost])} "
        f"see{'s' if len(lost) == 1 else ''}: too few points match in three images or more; matches with one image: "
        f"{listed}. {_REMEDY}."
    )


def refusal(found: Joined, evidence: Sequence[CameraEvidence], names: Sequence[str]) -> str | None:
    """Why the cameras must not be used; None where nothing speaks against them."""
    weak = [name for name, each in zip(names, evidence, strict=True) if is_weak(each)]
    if weak:
        return f"Too few points are seen by {_listed(weak)} and two images of the walk-through at once. {_REMEDY}."
    contradicted = [name for name, each in zip(names, evidence, strict=True) if is_contradicted(each)]
    if contradicted:
        return (
            f"The views of {_listed(contradicted)} contradict the walk-through: the rotations of most triangles with "
            f"its images do not close within {CLOSES:g} degrees. {_REMEDY}."
        )
    unsure = [name for name, each in zip(names, evidence, strict=True) if is_unsure(each.focal_uncertainty)]
    if unsure:
        return f"The images do not fix the focal length of {_listed(unsure)}. {_REMEDY}."
    if is_apart(found.apart):
        return f"Two halves of the points put the cameras {percent(found.apart)} of the rig's size apart. {_REMEDY}."
    return None


def warnings(found: Joined, evidence: Sequence[CameraEvidence], names: Sequence[str]) -> list[str]:
    """Sentences about what is in doubt though nothing speaks against it."""
    sentences = []
    weak = [name for name, each in zip(names, evidence, strict=True) if is_doubtful(each)]
    if weak:
        sentences.append(f"Few points are seen by {_listed(weak)} and the walk-through: look at the result.")
    return sentences + doubts(max(each.focal_uncertainty for each in evidence), found.apart, "the rig's size")


def _listed(names: Sequence[str]) -> str:
    """All of the names: each asks for a walk-through of its own."""
    return listed(names, len(names))
