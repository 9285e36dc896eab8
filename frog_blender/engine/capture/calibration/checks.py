"""What speaks for a solution, camera by camera and pair by pair, and whether it is to be used.

What is not to be used gets a sentence that names cameras, and says what to film. A low residual proves nothing, so none
of these checks looks at it. What they ask is whether independent parts of the data agree: three cameras about a point,
two halves. Limits stand in the table of ``limits``.
"""

from collections.abc import Sequence

import numpy as np

from ...errors import listed
from ..epipolar import fundamental, sampson_distances
from ..synchronization.films import CalibrationRefused
from . import limits
from .colmap import Adjusted, undistorted_pixels, verified
from .model import CalibratedCamera, Calibration, CameraSupport, Model, Pairs, PairSupport, oriented
from .structure import Images, Solution

_CELLS = np.array([8, 6])  # of an image, in which observations are counted
_SHOWN = 400  # observations of a camera, for the report
_GAPS = (1, 2)  # images between two that are compared: farther ones share too little to tell motion from false matches
_MOST_PAIRS = 120
_COHERENT = 0.5  # of the matches that contradict: a false geometry takes a quarter of false matches

REMEDY = (
    "Next time hold a ChArUco board into the views of neighbouring cameras, set the cameras closer together, or film "
    "a slow walk through the empty set with one more camera"
)
"""What to film where standing cameras are not connected."""
_PATH_REMEDY = (
    "Next time start the walk-through beside that camera, at its height, and walk on slowly, so that the film shows "
    "what the camera sees from near its place"
)
_MOVING_REMEDY = (
    "Next time move the camera sideways, slowly and without turning on the spot, past textured things that rest, or "
    "film with several standing cameras"
)


def pair_support(solution: Solution, images: Images, matches: Pairs) -> list[PairSupport]:
    """What supports each pair of the standing cameras, the first of the images; ``matches`` are those of all images."""
    count, tracks = images.standing, solution.adjusted.tracks
    agree = solution.adjusted.agree & (tracks.cameras < count)
    sees = np.zeros((tracks.count, count), np.int64)
    sees[tracks.points[agree], tracks.cameras[agree]] = 1
    together = sees.T @ sees  # how many points two of them agree about
    return [
        PairSupport(one, other, len(rows), len(solution.verified.get((one, other), ())), int(together[one, other]))
        for (one, other), rows in sorted(matches.items())
        if other < count
    ]


def camera_support(adjusted: Adjusted, count: int) -> list[CameraSupport]:
    """What supports each of the first ``count`` cameras."""
    agree, tracks = adjusted.agree, adjusted.tracks
    lengths = np.bincount(tracks.points[agree], minlength=tracks.count)
    supports = []
    for camera, lens in enumerate(adjusted.model.lenses[:count]):
        own = tracks.cameras == camera
        good = own & agree
        cells = (tracks.pixels[good] / [lens.width, lens.height] * _CELLS).astype(int).clip(0, _CELLS - 1)
        supports.append(
            CameraSupport(
                observations=int(good.sum()),
                share=float(good.sum() / max(own.sum(), 1)),
                shared_by_three=int((lengths[tracks.points[good]] >= 3).sum()),
                residual=float(np.median(adjusted.distances[good])) if good.any() else float("inf"),
                coverage=len(np.unique(cells, axis=0)) / float(_CELLS.prod()),
                focal_uncertainty=float(adjusted.uncertainty[camera]),
            )
        )
    return supports


def calibration_of(names: Sequence[str], adjusted: Adjusted, *, least: int = 2, is_metric: bool = False) -> Calibration:
    """The first cameras of a model and its points, in the world that they suggest.

    Args:
        names: of those cameras.
        least: observations that must agree about a point; the best seen ones come first.
        is_metric: lengths are metres, and stay so; otherwise the world's scale is chosen.
    """
    count, agree, tracks = len(names), adjusted.agree, adjusted.tracks
    model = Model(adjusted.model.poses[:count], adjusted.model.lenses[:count])
    model, points = oriented(model, adjusted.points, keep_scale=is_metric)
    supports, cameras = camera_support(adjusted, count), []
    for index, (name, lens, pose) in enumerate(zip(names, model.lenses, model.poses, strict=True)):
        own = np.flatnonzero(tracks.cameras == index)
        own = own[:: max(1, len(own) // _SHOWN)]
        observations = np.column_stack([tracks.pixels[own].round(1), agree[own]]).astype(np.float64)
        cameras.append(CalibratedCamera(lens.camera(name, pose), (lens.k1, lens.k2), supports[index], observations))
    return Calibration(tuple(cameras), points[adjusted.sure_points(least)].round(4), is_metric=is_metric)


# --- whether it is to be used


def refusal(solution: Solution, images: Images, matches: Pairs, names: Sequence[str]) -> str | None:
    """Why standing cameras must not be used, in one sentence; None where nothing speaks against them."""
    if len(names) < 3 and not images.connected:
        return (
            f"{len(names)} standing cameras cannot be calibrated from their images: a single pair proves nothing. "
            "Next time film with at least three cameras, or hold a ChArUco board into the views."
        )
    cameras, placed = camera_support(solution.adjusted, len(names)), solution.adjusted.model.placed
    weak = [name for name, camera in zip(names, cameras, strict=True) if camera.shared_by_three < limits.LEAST_SHARED]
    lost = [name for index, name in enumerate(names) if index not in placed] or weak
    if lost and images.connected:
        return _unseen(solution, names, lost)
    if lost:
        return _unconnected(names, pair_support(solution, images, matches), lost)
    remedy = _PATH_REMEDY if images.connected else REMEDY
    return _open(solution, max(camera.focal_uncertainty for camera in cameras), "the cameras", "the rig's size", remedy)


def check_places(calibration: Calibration) -> None:
    """CalibrationRefused where two cameras stand at one place and look one way, which no rig has."""
    cameras = [known.camera for known in calibration.cameras]
    for index, one in enumerate(cameras):
        depth = np.median(np.linalg.norm(calibration.points - one.center, axis=1)) if len(calibration.points) else 0.0
        for other in cameras[index + 1 :]:
            apart = np.linalg.norm(one.center - other.center)
            if apart < limits.ONE_PLACE * depth and one.forward @ other.forward > 1 - limits.ONE_PLACE:
                raise CalibrationRefused(
                    f"{one.name} and {other.name} stand at one place and look one way, expected one film of each"
                    " camera: if they are two films of one camera, take one away."
                )


def moving_refusal(solution: Solution, count: int) -> str | None:
    """The same for a moving camera of so many images."""
    lost = count - len(solution.adjusted.model.placed)
    if lost == count:
        return f"No two images of the moving camera could be placed. {_MOVING_REMEDY}."
    if lost > (1 - limits.LEAST_PLACED) * count:
        return f"{lost} of {count} images could not be placed. {_MOVING_REMEDY}."
    return _open(solution, solution.adjusted.unsure, "the camera", "its path", _MOVING_REMEDY)


def warnings(solution: Solution, images: Images, cameras: Sequence[CalibratedCamera]) -> list[str]:
    """Sentences about what is in doubt though nothing speaks against it."""
    supports, sentences = {known.camera.name: known.support for known in cameras}, []
    if weak := [name for name, support in supports.items() if support.shared_by_three < limits.FEW_SHARED]:
        others = "the walk-through" if images.connected else "two other cameras at once"
        sentences.append(f"Few points are seen by {listed(weak)} and {others}: look at the result.")
    sentences += _doubts(solution, max(support.focal_uncertainty for support in supports.values()), "the rig's size")
    if doubted := [name for name, support in supports.items() if support.share < limits.LEAST_AGREEING]:
        sentences.append(f"Most matches of {listed(doubted)} disagree with the solution: look at the result.")
    return sentences


def moving_warnings(solution: Solution, count: int, moving: float) -> list[str]:
    """The same for a moving camera; ``moving`` is the share of matches that ``moving_share`` tells."""
    lost = count - len(solution.adjusted.model.placed)
    sentences = [f"{lost} of {count} images could not be placed."] if lost else []
    sentences += _doubts(solution, solution.adjusted.unsure, "the path's size")
    if moving > limits.MOST_MOVING:
        sentences.append(
            f"{100 * moving:.0f} % of the matches between neighbouring images move otherwise than the rest: something "
            "large moves, and the camera's path may be wrong, or relative to it. Look at the result; next time let "
            "more of what rests be seen around it."
        )
    return sentences


def _open(solution: Solution, unsure: float, what: str, size: str, remedy: str) -> str | None:
    """Why the data leave a solution open: its focal length, or its places."""
    if not unsure <= limits.MOST_UNSURE:
        return f"The images do not fix the focal length (within {_percent(unsure)}). {_fixing(solution, remedy)}."
    if not solution.halves_apart <= limits.MOST_APART:
        return (
            f"Two halves of the points put {what} {_percent(solution.halves_apart)} of {size} apart: there are too "
            f"few. {remedy}."
        )
    return None


def _doubts(solution: Solution, unsure: float, size: str) -> list[str]:
    sentences = []
    if unsure > limits.DOUBTFUL_UNSURE:
        sentences.append(f"The focal length is known within {_percent(unsure)} only.")
    if solution.halves_apart > limits.DOUBTFUL_APART:
        sentences.append(f"Camera positions are known within about {_percent(solution.halves_apart)} of {size} only.")
    return sentences


def _fixing(solution: Solution, remedy: str) -> str:
    """What to film so that focal lengths are fixed.

    Cameras that only shift leave them open whatever they see: the depth of everything and the focal length trade off.
    """
    if remedy != REMEDY:
        return remedy
    model = solution.adjusted.model
    ahead = model.poses[model.placed][:, 2, :3]
    if np.degrees(np.arccos(np.clip((ahead @ ahead.T).min(), -1, 1))) < limits.PARALLEL:
        return "Turn the cameras towards one place: they look in the same direction; or hold a ChArUco board"
    return "Next time fill more of the images with textured things at different depths, or hold a ChArUco board"


def _unconnected(names: Sequence[str], pairs: Sequence[PairSupport], lost: Sequence[str]) -> str:
    """The refusal for cameras that share no points with two others, with the pairs that do match."""
    good = sorted((pair for pair in pairs if pair.agreeing >= limits.LEAST_SHARED), key=lambda pair: -pair.agreeing)
    matching = [f"{names[pair.one]}-{names[pair.other]} ({pair.agreeing} points)" for pair in good]
    only = f"only {listed(matching)} match" + ("es" if len(matching) == 1 else "") if matching else "no pair matches"
    sharing = f"share{'s' if len(lost) == 1 else ''} no points with two other cameras at once"
    return f"{listed(lost)} {sharing}: {only}. {REMEDY}."


def _unseen(solution: Solution, names: Sequence[str], lost: Sequence[str]) -> str:
    """The refusal for standing cameras that the walk-through does not connect."""
    indices = [names.index(name) for name in lost]
    most = [
        max((len(rows) for pair, rows in solution.verified.items() if index in pair), default=0) for index in indices
    ]
    matches = ", ".join(f"{name} (at most {count})" for name, count in zip(lost, most, strict=True))
    return (
        f"The walk-through does not show enough of what {listed(lost, len(lost))} see{'s' if len(lost) == 1 else ''}: "
        f"too few points match in three images or more; matches with one image: {matches}. {_PATH_REMEDY}."
    )


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share < float("inf") else "any amount"


def moving_share(images: Images, model: Model, matches: Pairs) -> float:
    """Median share of the matches of two near images that contradict the cameras' poses, and do so in one way.

    A fundamental matrix follows whatever has most features. Where a large subject has them, poses are relative to it,
    or to neither, and fit all the same: their residuals, costs and halves look as they do where nothing moves.
    """
    placed = set(model.placed)
    near = [pair for pair in sorted(matches) if pair[1] - pair[0] in _GAPS and placed.issuperset(pair)]
    shares = []
    for pair in near[:: max(1, -(-len(near) // _MOST_PAIRS))]:
        rows = matches[pair]
        if len(rows) < limits.LEAST_MATCHES:
            continue
        lenses = [model.lenses[index] for index in pair]
        matrix = fundamental(*(lens.camera("", model.poses[index]) for lens, index in zip(lenses, pair, strict=True)))
        pixels = [undistorted_pixels(lens, images.pixels[index]) for lens, index in zip(lenses, pair, strict=True)]
        missed = np.abs(sampson_distances(matrix, pixels[0][rows[:, 0]], pixels[1][rows[:, 1]]))
        rest = rows[missed > max(lens.limit for lens in lenses)]
        together = verified(lenses[0], pixels[0], lenses[1], pixels[1], rest)
        is_motion = len(together) >= _COHERENT * len(rest)
        shares.append(len(together) / len(rows) if is_motion else 0.0)
    return float(np.median(shares)) if shares else 0.0
