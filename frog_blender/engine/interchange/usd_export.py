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
import shutil
import tempfile
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..errors import FrogError
from ..gaussians import NumpyGaussians
from ..io.atomic_files import write_atomically
from ..source_media.clips import camera_path
from .take import Sound, Take, TakeFrame
from .usd_cameras import NAME, SIZE

if TYPE_CHECKING:
    from pxr import Usd

PRIM_TYPE = "ParticleField3DGaussianSplat"
SUFFIXES = (".usdc", ".usda", ".usd")
COLOR_SPACE = "srgb-rec709-display"
"""What the colours are, in the words of the .4dgs format, whose tools read the key below."""
_COLOR_KEYS = ("frog:colorSpace", "fourdgs:colorSpace")
_MEANING = "Radiance is display-referred sRGB minus one half, as 3DGS trainings write it; it is no linear light."
_SAME_ROWS = "The same row is the same Gaussian at every time."
_OTHER_ROWS = "Rows are other Gaussians at each time: between two samples the earlier one holds."
_SH_NAME = "radiance:sphericalHarmonicsCoefficients"
_APERTURE = 36.0  # tenths of a unit, as of a 35 mm film in millimetres
_FLUSHED = 256 << 20  # bytes of samples that are held before they go to the disk
_LARGEST_HALF = 65504.0
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
        raise FrogError(f"{path}: found the ending {path.suffix!r}, expected {', '.join(SUFFIXES)}.")
    folder = ""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.mkdtemp(prefix=".frog-usd-", dir=path.parent)
        # Deleted as a whole: USD writes files of its own beside the one that it saves.
        unfinished = Path(folder) / f"unfinished{path.suffix.lower()}"
        yield from _written(unfinished, path, take, full_precision)
        os.replace(unfinished, path)
    except Tf.ErrorException as error:
        raise FrogError(f"{path}: could not be written ({error}); nothing was changed.") from error
    except OSError as error:
        raise FrogError(f"{path}: could not be written ({error.strerror or error}); nothing was changed.") from error
    finally:
        del quiet
        if folder:
            shutil.rmtree(folder, ignore_errors=True)


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
    static = dynamic = None
    place, pending, before = _Place(stage, root), 0, None
    shown: list[tuple[float, float]] = []
    for done, frame in enumerate(take.frames(), 1):
        gaussians = _compatible(frame.gaussians, before)
        if done == 1:
            count, moving = len(gaussians), take.num_dynamic
            if moving < count:
                static = _Field(stage, f"{root.GetPath()}/Static", gaussians, slice(moving, count), full_precision)
            if moving:
                dynamic = _Field(stage, f"{root.GetPath()}/Dynamic", gaussians, slice(0, moving), full_precision)
        if static is not None and done == 1:
            static.put_still(gaussians)
        if dynamic is not None:
            if done == 1:
                dynamic.put_still(gaussians, without=_attributes(take.changing))
            pending += dynamic.put(gaussians, frame.number, _attributes(take.changing))
        place.put(frame)
        shown.append((frame.number, frame.time))
        before = gaussians.quaternions
        if pending > _FLUSHED:
            layer.Save()
            pending = 0
        yield done
    for each in (static, dynamic):
        if each is not None:
            each.close()
    _add_cameras(stage, f"{root.GetPath()}/Cameras", take, shown)
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

    types, uniform = Sdf.ValueTypeNames, Sdf.VariabilityUniform
    prim = stage.DefinePrim(path, "SpatialAudio")
    prim.CreateAttribute("filePath", types.Asset, False, uniform).Set(Sdf.AssetPath(_beside(played, file.parent)))
    prim.CreateAttribute("auralMode", types.Token, False, uniform).Set("nonSpatial")
    prim.CreateAttribute("startTime", types.TimeCode, False, uniform).Set(Sdf.TimeCode(number))
    prim.CreateAttribute("mediaOffset", types.Double, False, uniform).Set(sound.start)


def _beside(file: Path, folder: Path) -> str:
    """A path as USD writes it: relative where the file lies near the scene."""
    try:
        relative = os.path.relpath(file.resolve(), folder.resolve())
    except ValueError:  # another drive
        return file.resolve().as_posix()
    return Path(relative).as_posix() if relative.count("..") < 3 else file.resolve().as_posix()


def _attributes(columns: Sequence[str]) -> frozenset[str]:
    """The prim's attributes that hold columns of a frame."""
    plain = {"means": "positions", "quaternions": "orientations", "scales": "scales"}
    found = {plain[name] for name in columns if name in plain}
    if any(name not in plain for name in columns):
        found.add(_SH_NAME)
    return frozenset(found | ({"opacities"} if "base" in columns else set()))


def _compatible(gaussians: NumpyGaussians, before: Array | None) -> NumpyGaussians:
    """The same turns by those of two signs that are near the frame before: other programs interpolate them."""
    if before is None:
        return gaussians
    flipped = (gaussians.quaternions * before).sum(axis=1) < 0
    if flipped.any():
        gaussians.quaternions = np.where(flipped[:, None], -gaussians.quaternions, gaussians.quaternions)
    return gaussians


class _Field:
    """A prim of some of the Gaussians."""

    def __init__(
        self, stage: Usd.Stage, path: str, gaussians: NumpyGaussians, rows: slice, full_precision: bool
    ) -> None:
        from pxr import Sdf

        self._rows, self._full = rows, full_precision
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        types, uniform = Sdf.ValueTypeNames, Sdf.VariabilityUniform
        self._prim = stage.DefinePrim(path, PRIM_TYPE)
        for key in _COLOR_KEYS:
            self._prim.SetCustomDataByKey(key, COLOR_SPACE)
        self._prim.SetCustomDataByKey("frog:meaning", _MEANING)
        degree = self._prim.CreateAttribute("radiance:sphericalHarmonicsDegree", types.Int, False, uniform)
        degree.Set(gaussians.sh_degree)
        hint = self._prim.CreateAttribute("sortingModeHint", types.Token, False, uniform)
        hint.Set("zDepth")
        kinds: Mapping[str, tuple[Any, Any]] = {
            "positions": (types.Point3fArray, types.Point3hArray),
            "orientations": (types.QuatfArray, types.QuathArray),
            "scales": (types.Float3Array, types.Half3Array),
            "opacities": (types.FloatArray, types.HalfArray),
            _SH_NAME: (types.Float3Array, types.Half3Array),
        }
        self._targets = {}
        for name, (single, half) in kinds.items():
            is_half = not full_precision and name != "positions"
            self._targets[name] = self._prim.CreateAttribute(
                f"{name}h" if is_half else name, half if is_half else single, False
            )

    def put_still(self, gaussians: NumpyGaussians, without: frozenset[str] = frozenset()) -> None:
        """Writes what does not change, as attributes without time samples."""
        for name, values in self._values(gaussians).items():
            if name not in without:
                self._targets[name].Set(values)

    def put(self, gaussians: NumpyGaussians, number: float, names: frozenset[str]) -> int:
        """Writes the attributes ``names`` of a frame; returns the bytes that they take."""
        written = 0
        for name, values in self._values(gaussians).items():
            if name in names:
                self._targets[name].Set(values, number)
                written += 12 * len(values)
        return written

    def close(self) -> None:
        """Writes the box around everything that was put."""
        from pxr import Gf, Sdf, Vt

        extent = self._prim.CreateAttribute("extent", Sdf.ValueTypeNames.Float3Array, False)
        corners = [Gf.Vec3f(*(float(value) for value in corner)) for corner in (self._low, self._high)]
        extent.Set(Vt.Vec3fArray(corners))

    def _values(self, gaussians: NumpyGaussians) -> dict[str, Any]:  # of Vt, which has no types
        from pxr import Vt

        rows = self._rows
        means, scales = gaussians.means[rows], gaussians.scales[rows]
        reach = _REACH * scales.max(axis=1, keepdims=True)
        self._low = np.minimum(self._low, (means - reach).min(axis=0))
        self._high = np.maximum(self._high, (means + reach).max(axis=0))
        turns = np.roll(gaussians.quaternions[rows], -1, axis=1)  # in memory their real part comes last
        colors = gaussians.sh[rows].reshape(-1, 3)
        single = Vt.Vec3fArray.FromNumpy
        if self._full:
            return {
                "positions": single(np.ascontiguousarray(means)),
                "orientations": Vt.QuatfArray.FromNumpy(np.ascontiguousarray(turns)),
                "scales": single(np.ascontiguousarray(scales)),
                "opacities": Vt.FloatArray.FromNumpy(np.ascontiguousarray(gaussians.opacities[rows])),
                _SH_NAME: single(np.ascontiguousarray(colors)),
            }
        return {
            "positions": single(np.ascontiguousarray(means)),
            "orientations": Vt.QuathArray.FromNumpy(_half(turns)),
            "scales": Vt.Vec3hArray.FromNumpy(_half(scales)),
            "opacities": Vt.HalfArray.FromNumpy(_half(gaussians.opacities[rows])),
            _SH_NAME: Vt.Vec3hArray.FromNumpy(_half(colors)),
        }


def _half(values: Array) -> Array:
    return np.ascontiguousarray(values.clip(-_LARGEST_HALF, _LARGEST_HALF), np.float16)


class _Place:
    """Where the take's root stands; time samples where it moves."""

    def __init__(self, stage: Usd.Stage, root: Usd.Prim) -> None:
        self._root = root
        self._target: Usd.Attribute | None = None

    def put(self, frame: TakeFrame) -> None:
        from pxr import Gf, Sdf, Vt

        if frame.placement is None:
            return
        if self._target is None:
            self._target = self._root.CreateAttribute("xformOp:transform", Sdf.ValueTypeNames.Matrix4d, False)
            order = self._root.CreateAttribute(
                "xformOpOrder", Sdf.ValueTypeNames.TokenArray, False, Sdf.VariabilityUniform
            )
            order.Set(Vt.TokenArray(["xformOp:transform"]))
        matrix = Gf.Matrix4d(np.asarray(frame.placement, np.float64).T.tolist())  # rows are vectors in USD
        self._target.Set(matrix, frame.number)


def _add_cameras(stage: Usd.Stage, scope: str, take: Take, shown: Sequence[tuple[float, float]]) -> None:
    """The capture's cameras; one that moves is where it was at the frame that is shown.

    Args:
        shown: frame numbers, and the capture's frame at each.
    """
    header = take.header
    if not header.cameras:
        return
    stage.DefinePrim(scope, "Scope")
    if header.is_moving:
        path = camera_path(header)
        filmed = np.array([frame for frame, _ in path])
        views = [(number, path[int(np.abs(filmed - time).argmin())][1]) for number, time in shown]
        _add_camera(stage, scope, "Moving Camera", views)
        return
    for camera in header.cameras:
        _add_camera(stage, scope, camera.name, [(None, camera)])


def _add_camera(stage: Usd.Stage, scope: str, name: str, views: Sequence[tuple[float | None, Camera]]) -> None:
    """One camera at its frame numbers, or without time samples where there is one view of number None."""
    from pxr import Gf, Sdf, Tf, Usd, Vt

    types, identifier, number = Sdf.ValueTypeNames, Tf.MakeValidIdentifier(name), 1
    while stage.GetPrimAtPath(f"{scope}/{identifier}"):
        number += 1
        identifier = f"{Tf.MakeValidIdentifier(name)}_{number}"
    prim = stage.DefinePrim(f"{scope}/{identifier}", "Camera")
    prim.SetCustomDataByKey(NAME, name)
    prim.SetCustomDataByKey(SIZE, Gf.Vec2i(views[0][1].width, views[0][1].height))
    prim.CreateAttribute("clippingRange", types.Float2, False).Set(Gf.Vec2f(0.01, 10_000.0))
    prim.CreateAttribute("projection", types.Token, False).Set("perspective")
    lens = {each: prim.CreateAttribute(each, types.Float, False) for each in _lens(views[0][1])}
    pose = prim.CreateAttribute("xformOp:transform", types.Matrix4d, False)
    order = prim.CreateAttribute("xformOpOrder", types.TokenArray, False, Sdf.VariabilityUniform)
    order.Set(Vt.TokenArray(["xformOp:transform"]))
    for at, camera in views:
        time = Usd.TimeCode.Default() if at is None else Usd.TimeCode(at)
        for each, value in _lens(camera).items():
            lens[each].Set(value, time)
        to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])
        pose.Set(Gf.Matrix4d(to_world.T.tolist()), time)


def _lens(camera: Camera) -> dict[str, float]:
    """A pinhole camera in USD's words; an off-centre principal point is an offset of the aperture."""
    k, width, height = camera.intrinsics, camera.width, camera.height
    tall = _APERTURE * height / width * k[0, 0] / k[1, 1]
    return {
        "focalLength": float(k[0, 0] * _APERTURE / width),
        "horizontalAperture": _APERTURE,
        "verticalAperture": float(tall),
        "horizontalApertureOffset": float(_APERTURE * (0.5 - k[0, 2] / width)),
        "verticalApertureOffset": float(tall * (k[1, 2] / height - 0.5)),
    }
