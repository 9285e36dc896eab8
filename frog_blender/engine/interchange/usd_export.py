"""Animated USD: Gaussians as ``ParticleField3DGaussianSplat`` prims, which OpenUSD has since 26.03.

Static Gaussians are one prim without time samples, dynamic ones another with samples of those attributes that change:
what rests costs its size once. Prims and attributes are written by their names, so that any USD library will do: that
of ``usd-core``, or the one in Blender, which knows the schema since 5.3 alone.

The schema (openusd.org, usdVol/ParticleField) stores linear sizes, opacities in [0, 1] and quaternions, as playback
does. It has no word for what its colours mean, and its radiance is linear light by definition; ours is display-referred
sRGB as filmed, which the prims' ``customData`` says.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Generator, Sequence, Set
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import Array
from ..errors import UsageError, in_words
from ..gaussians import NumpyGaussians
from ..io.atomic_files import write_atomically
from ..scene.scene_file import HALF
from .take import Sound, Take
from .usd_cameras import add_cameras, put, time_code, transform_of, usd_matrix

if TYPE_CHECKING:
    from pxr import Usd

PRIM_TYPE = "ParticleField3DGaussianSplat"
OWN_LOW_PASS = "frog:lowPass"
"""In the prims' ``customData``: see GaussianArrays."""
SUFFIXES = (".usdc", ".usda", ".usd")
_COLOR_SPACE = "srgb-rec709-display"
_MEANING = "Radiance is display-referred sRGB minus one half, as 3DGS trainings write it; it is no linear light."
_SAME_ROWS = "The same row is the same Gaussian at every time."
_OTHER_ROWS = "Rows are other Gaussians at each time: between two samples the earlier one holds."
_SH_NAME = "radiance:sphericalHarmonicsCoefficients"
_ATTRIBUTES = {
    "positions": ("Point3fArray", "Point3fArray"),
    "orientations": ("QuatfArray", "QuathArray"),
    "scales": ("Float3Array", "Half3Array"),
    "opacities": ("FloatArray", "HalfArray"),
    _SH_NAME: ("Float3Array", "Half3Array"),
}
"""Types of the prims' attributes in single precision, and in half where that is enough."""
_COLUMNS = {"means": "positions", "quaternions": "orientations", "scales": "scales"}
_FLUSHED = 256 << 20  # bytes of samples that are held before they go to the disk
_REACH = 3.0  # standard deviations within which a Gaussian is seen


def write_usd(path: Path, take: Take, *, full_precision: bool = False) -> Generator[int, None, None]:
    """Writes a take as a USD file; yields how many frames are done. The file appears when all are.

    Numbers are half floats, but for positions: half floats move a Gaussian at 5 m by up to 2 mm.

    Args:
        path: ends in .usdc, .usda or .usd.
        full_precision: write single precision throughout.

    Raises:
        FrogError: for another ending, Gaussians that USD cannot hold, or a file that cannot be written.
        ImportError: where there is no USD library.
    """
    from pxr import Tf, UsdUtils

    quiet = UsdUtils.CoalescingDiagnosticDelegate()  # what USD says of its own file format is for nobody here
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: found the ending {path.suffix!r}, expected {', '.join(SUFFIXES)}.")
    try:
        with in_words(f"{path}: could not be written", "; nothing was changed.", kinds=(Tf.ErrorException, OSError)):
            path.parent.mkdir(parents=True, exist_ok=True)
            # Deleted as a whole: USD writes files of its own beside the one that it saves.
            with tempfile.TemporaryDirectory(prefix=".frog-usd-", dir=path.parent, ignore_cleanup_errors=True) as name:
                unfinished = Path(name) / f"unfinished{path.suffix.lower()}"
                yield from _written(unfinished, path, take, full_precision)
                os.replace(unfinished, path)
    finally:
        del quiet


def rate_to_set(take: Take) -> str:
    """What is to be said of a take that was written: Blender, for one, leaves its scene at the rate that it has."""
    return f"It plays as filmed at {take.rate:g} frames a second: set the rate of the scene that it is imported to."


def _written(unfinished: Path, path: Path, take: Take, full_precision: bool) -> Generator[int, None, None]:
    from pxr import Tf, Usd

    stage = Usd.Stage.CreateNew(str(unfinished))
    root = stage.DefinePrim(f"/{Tf.MakeValidIdentifier(take.name)}", "Xform")
    stage.SetDefaultPrim(root)
    layer = stage.GetRootLayer()
    stage.SetMetadata("upAxis", "Z")
    stage.SetMetadata("metersPerUnit", 1.0)
    layer.timeCodesPerSecond = layer.framesPerSecond = take.rate
    layer.startTimeCode, layer.endTimeCode = take.numbers[0], take.numbers[-1]
    layer.comment = f"{_MEANING} {_SAME_ROWS if take.keeps_identity else _OTHER_ROWS}"
    root.SetMetadata("kind", "component")
    root.SetCustomDataByKey("frog:method", take.header.method)
    fields: list[_Field] = []
    pose, pending, before = None, 0, None
    changing = _attributes(take.changing)
    shown: list[tuple[float, float]] = []
    for done, frame in enumerate(take.frames(), 1):
        gaussians = _compatible(frame.gaussians, before)
        if done == 1:
            rows = {"Static": slice(take.num_dynamic, len(gaussians)), "Dynamic": slice(0, take.num_dynamic)}
            for name, some in rows.items():
                if some.start < some.stop:
                    field = _Field(stage, f"{root.GetPath()}/{name}", gaussians, some, full_precision)
                    field.put(gaussians, _ATTRIBUTES.keys())  # of readers of stills, too
                    fields.append(field)
        if take.num_dynamic:
            pending += fields[-1].put(gaussians, changing, frame.number)
        if frame.placement is not None:
            pose = pose or transform_of(root)
            pose.Set(usd_matrix(frame.placement), frame.number)
        shown.append((frame.number, frame.time))
        before = gaussians.quaternions
        if pending > _FLUSHED:
            layer.Save()
            pending = 0
        yield done
    for field in fields:
        field.close()
    add_cameras(stage, f"{root.GetPath()}/Cameras", take.header, shown)
    if take.sound is not None:
        _add_sound(stage, f"{root.GetPath()}/Sound", take.sound, take.numbers[0], path)
    layer.Save()


def _add_sound(stage: Usd.Stage, path: str, sound: Sound, number: float, file: Path) -> None:
    """The film's path is written, for hosts open it themselves, or that of a sound file beside the scene's, where one
    was made."""
    from pxr import Sdf

    played = sound.path
    if sound.content:
        played = file.with_name(f"{file.stem}_sound.wav")
        if played.exists() and played.read_bytes() != sound.content:  # which may be anybody's
            digest = hashlib.blake2b(sound.content, digest_size=4).hexdigest()
            played = file.with_name(f"{file.stem}_sound_{digest}.wav")
        write_atomically(played, sound.content)

    prim = stage.DefinePrim(path, "SpatialAudio")
    put(prim, "filePath", "Asset", Sdf.AssetPath(_beside(played, file.parent)), varies=False)
    put(prim, "auralMode", "Token", "nonSpatial", varies=False)
    put(prim, "startTime", "TimeCode", Sdf.TimeCode(number), varies=False)
    put(prim, "mediaOffset", "Double", sound.start, varies=False)


def _beside(file: Path, folder: Path) -> str:
    """A path as USD writes it: relative where the file lies near the scene."""
    try:
        relative = os.path.relpath(file.resolve(), folder.resolve())
    except ValueError:  # another drive
        return file.resolve().as_posix()
    return Path(relative).as_posix() if relative.count("..") < 3 else file.resolve().as_posix()


def _attributes(columns: Sequence[str]) -> frozenset[str]:
    """The prim's attributes that hold columns of a frame."""
    names = {_COLUMNS.get(name, _SH_NAME) for name in columns}
    return frozenset(names | ({"opacities"} if "base" in columns else set()))


def _compatible(gaussians: NumpyGaussians, before: Array | None) -> NumpyGaussians:
    """The same turns by those of two signs that are near the frame before: other programs interpolate them."""
    if before is not None:
        flipped = (gaussians.quaternions * before).sum(axis=1) < 0
        gaussians.quaternions = np.where(flipped[:, None], -gaussians.quaternions, gaussians.quaternions)
    return gaussians


class _Field:
    """A prim of some of the Gaussians."""

    def __init__(
        self, stage: Usd.Stage, path: str, gaussians: NumpyGaussians, rows: slice, full_precision: bool
    ) -> None:
        self._rows = rows
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._prim = stage.DefinePrim(path, PRIM_TYPE)
        self._prim.SetCustomDataByKey("frog:colorSpace", _COLOR_SPACE)
        self._prim.SetCustomDataByKey("frog:meaning", _MEANING)
        self._prim.SetCustomDataByKey(OWN_LOW_PASS, float(np.max(gaussians.low_pass)))
        put(self._prim, "radiance:sphericalHarmonicsDegree", "Int", gaussians.sh_degree, varies=False)
        put(self._prim, "sortingModeHint", "Token", "zDepth", varies=False)
        self._attributes: dict[str, Usd.Attribute] = {}
        for name, (single, half) in _ATTRIBUTES.items():
            own, kind = (name, single) if full_precision or half == single else (f"{name}h", half)
            self._attributes[name] = put(self._prim, own, kind)

    def put(self, gaussians: NumpyGaussians, names: Set[str], number: float | None = None) -> int:
        """Writes attributes of a frame, without time samples where it has no number; returns the bytes they take."""
        rows, written = self._rows, 0
        means, scales = gaussians.means[rows], gaussians.scales[rows]
        reach = _REACH * scales.max(axis=1, keepdims=True)
        self._low = np.minimum(self._low, (means - reach).min(axis=0))
        self._high = np.maximum(self._high, (means + reach).max(axis=0))
        values = {
            "positions": means,
            "orientations": np.roll(gaussians.quaternions[rows], -1, axis=1),  # in memory their real part comes last
            "scales": scales,
            "opacities": gaussians.opacities[rows],
            _SH_NAME: gaussians.sh[rows].reshape(-1, 3),
        }
        for name, attribute in self._attributes.items():
            if name in names:
                array = values[name]
                if attribute.GetName() != name:
                    array = array.clip(*HALF).astype(np.float16)
                kind = attribute.GetTypeName().type.pythonClass
                attribute.Set(kind.FromNumpy(np.ascontiguousarray(array)), time_code(number))
                written += 12 * len(array)
        return written

    def close(self) -> None:
        """Writes the box around everything that was put."""
        from pxr import Vt

        put(self._prim, "extent", "Float3Array", Vt.Vec3fArray.FromNumpy(np.array([self._low, self._high], np.float32)))
