"""Frames of anybody's USD file with ``ParticleField3DGaussianSplat`` prims, time-sampled or not.

USD's own library reads the file, and it trusts what it reads: a damaged file can end the process. So this runs in a
process of its own (see imports), with a limit to its memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Array
from ..errors import brief, found_instead
from ..gaussians import LOW_PASS, WIDEST_LOW_PASS, GaussianArrays, NumpyGaussians, joined
from ..io.paths import is_network_path
from ..io.regular_file import regular_file, utf8_name
from ..scene.header import MAX_FRAMES
from .frame_source import FrameSource
from .stills import AS_THEY_ARE, Y_UP, Part, gathered
from .usd_cameras import cameras_of, time_code, world_matrix
from .usd_export import OWN_LOW_PASS, PRIM_TYPE

if TYPE_CHECKING:
    from pxr import Usd

_EXPECTED = f"a USD file with {PRIM_TYPE} prims"
_NAMES = ("positions", "orientations", "scales", "opacities", "radiance:sphericalHarmonicsCoefficients")
_NOT_SHOWN = "are left out: they are invisible, guides, proxies, empty, or there for copies alone"
_MOST_PRIMS, _MOST_LAYERS = 4096, 1024
_SPARSE, _SPARSEST = 4, 256
"""Frames for a time sample, at most: where times lie on a grid, and where they do not."""
_COEFFICIENTS = (1, 4, 9, 16)


class UsdSource(FrameSource):
    """Frames of a USD file. Where counts are constant, USD takes a row for the same Gaussian.

    Its cameras stand where they are at the first frame.

    Raises:
        FrogError: for a file without Gaussians, or one that calls another computer.
        ImportError: where there is no USD library.
    """

    origin = "usd"

    def __init__(self, path: Path) -> None:
        from pxr import Tf, Usd, UsdGeom, UsdUtils

        utf8_name(regular_file(path, _EXPECTED))
        self._path = path
        self._quiet = UsdUtils.CoalescingDiagnosticDelegate()  # its warnings are for nobody here
        try:
            self._layers = _checked_layers(path)
            self._stage = Usd.Stage.Open(str(path))
            self._prims = [
                prim for prim in self._stage.Traverse(Usd.TraverseInstanceProxies()) if prim.GetTypeName() == PRIM_TYPE
            ]
            if not 1 <= len(self._prims) <= _MOST_PRIMS:
                raise found_instead(path, f"{len(self._prims)} such prims", _EXPECTED)
            _make_placeable(self._stage, self._prims)
            self._up = Y_UP if UsdGeom.GetStageUpAxis(self._stage) == "Y" else AS_THEY_ARE
            unit = float(UsdGeom.GetStageMetersPerUnit(self._stage))
            if UsdGeom.StageHasAuthoredMetersPerUnit(self._stage) and not math.isclose(unit, 1) and 1e-9 < unit < 1e9:
                self._up = self._up @ np.diag([unit, unit, unit, 1])
                self.notes = (f"Its unit is {unit:g} m; places and sizes are in metres now.",)
            self._times, self.rate = self._grid(float(self._stage.GetTimeCodesPerSecond()))
            found, self._prims = self._prims, [prim for prim in self._prims if _is_there(prim, self._times)]
            if not self._prims:
                raise found_instead(path, f"{len(found)} such prims, which {_NOT_SHOWN}", _EXPECTED)
            if hidden := len(found) - len(self._prims):
                self.notes += (f"{hidden} of its {len(found)} prims {_NOT_SHOWN}.",)
            self.cameras = tuple(cameras_of(self._stage, self._times[0], self._up))
        except Tf.ErrorException as error:
            raise found_instead(path, f"a file that the USD library cannot read ({brief(error)})", _EXPECTED) from error
        self.frame_count = len(self._times)
        counts = {tuple(len(_value(prim, "positions", time)) for prim in self._prims) for time in self._times}
        self.keeps_identity = len(counts) == 1

    def at(self, frame: int) -> NumpyGaussians:
        """A frame, counted from 0, in the file's world with z up."""
        from pxr import Tf, UsdGeom

        time = self._times[frame]
        try:
            cache = UsdGeom.XformCache(time_code(time))
            parts, left_out = [], 0
            for prim in self._prims:
                where = f"{self._path}: {brief(prim.GetPath())}"
                part = Part(self._gaussians(where, prim, time), self._up @ world_matrix(cache, prim))
                if not len(part.gaussians):
                    continue
                gaussians, without = gathered(where, [part], keep_rows=self.frame_count > 1)
                if not _is_shown(prim, time):  # as it is in another frame
                    gaussians.opacities = np.zeros_like(gaussians.opacities)
                parts.append(gaussians)
                left_out += without
        except Tf.ErrorException as error:
            what = f"a frame that the USD library cannot read ({brief(error)})"
            raise found_instead(self._path, what, _EXPECTED) from error
        self.left_out = max(self.left_out, left_out)
        if not parts:
            raise found_instead(self._path, f"no Gaussians in frame {frame}", _EXPECTED)
        return joined(parts)

    def _gaussians(self, where: str, prim: Usd.Prim, time: float | None) -> NumpyGaussians:
        means, turns, scales, opacities, colors = (_value(prim, name, time) for name in _NAMES)
        count = len(means)
        turns = turns if len(turns) else np.tile(np.array([0, 0, 0, 1], np.float32), (count, 1))
        opacities = opacities if len(opacities) else np.ones(count, np.float32)
        colors = colors if len(colors) else np.zeros((count, 3), np.float32)
        degree = len(colors) // count if count else 1
        lengths = {"scales": len(scales), "orientations": len(turns), "opacities": len(opacities)}
        wrong = [f"{length:,} {name}" for name, length in lengths.items() if length != count]
        if len(colors) != count * degree or degree not in _COEFFICIENTS:
            wrong.append(f"{len(colors):,} coefficients")
        if wrong:
            raise found_instead(where, f"{count:,} positions and {', '.join(wrong)}", "as many of each")
        turns, colors = np.roll(turns, 1, axis=1), colors.reshape(count, degree, 3)
        own = prim.GetCustomDataByKey(OWN_LOW_PASS)
        low_pass = own if isinstance(own, float) and 0 <= own <= WIDEST_LOW_PASS else LOW_PASS
        return GaussianArrays(means, turns, scales, opacities, colors, low_pass=low_pass)

    def _grid(self, codes_per_second: float) -> tuple[list[float | None], float]:
        """Time codes of the frames, in equal steps, and frames a second. [None] for a file without time samples."""
        if not 1e-6 < codes_per_second < 1e6:
            raise found_instead(self._path, f"{codes_per_second:g} time codes a second", "up to a million")
        codes: set[float] = set()
        for prim in self._prims:
            for attribute in _timed(prim):
                codes.update(attribute.GetTimeSamples() if attribute.GetNumTimeSamples() <= MAX_FRAMES else ())
        times = sorted(code for code in codes if abs(code) < 1e9)
        if len(times) < 2:
            return [times[0] if times else None], codes_per_second
        step = float(np.diff(times).min())
        places = (np.array(times) - times[0]) / step
        count = round(places[-1]) + 1
        if np.abs(places - np.rint(places)).max() > 1e-3 or count > _SPARSE * len(times) + 1:
            step, count = 1.0, int(times[-1] - times[0]) + 1
        if count > min(MAX_FRAMES, _SPARSEST * len(times)) or codes_per_second / step > 1e6:
            expected = f"at most {_SPARSEST} for each of its {len(times):,} time samples"
            raise found_instead(self._path, f"{count:,} frames", expected)
        return [times[0] + step * index for index in range(count)], codes_per_second / step


def _make_placeable(stage: Usd.Stage, prims: Sequence[Usd.Prim]) -> None:
    """USD libraries before 26.03, such as Blender's before 5.3, do not know that these prims have transforms."""
    from pxr import UsdGeom

    stage.SetEditTarget(stage.GetSessionLayer())
    for prim in prims:
        if not prim.IsA(UsdGeom.Xformable) and not prim.IsInstanceProxy():
            prim.SetTypeName("Xform")


def _timed(prim: Usd.Prim) -> Iterator[Any]:  # of pxr, which has no types
    """The attributes that hold the prim's Gaussians, and what moves it and its parents."""
    yield from (attribute for attribute in prim.GetAttributes() if attribute.GetName().removesuffix("h") in _NAMES)
    for above in prim.GetPath().GetPrefixes():
        attributes = prim.GetStage().GetPrimAtPath(above).GetAttributes()
        yield from (one for one in attributes if one.GetName().startswith(("xformOp:", "visibility")))


def _is_shown(prim: Usd.Prim, time: float | None) -> bool:
    """Whether a renderer shows a prim where it is."""
    from pxr import UsdGeom

    imageable = UsdGeom.Imageable(prim)
    if imageable.ComputeVisibility(time_code(time)) == "invisible" or imageable.ComputePurpose() in ("guide", "proxy"):
        return False
    above = map(prim.GetStage().GetPrimAtPath, prim.GetPath().GetPrefixes())
    return not any(one.IsA(UsdGeom.PointInstancer) for one in above)


def _is_there(prim: Usd.Prim, times: Sequence[float | None]) -> bool:
    return any(_is_shown(prim, time) and len(_value(prim, "positions", time)) for time in times)


def _value(prim: Usd.Prim, name: str, time: float | None) -> Array:
    """(N, width) or (N,) of an attribute: of its single-precision form, or else of its half one; empty without any."""
    for suffix in ("", "h"):
        attribute = prim.GetAttribute(name + suffix)
        if attribute and attribute.HasAuthoredValue():
            value = attribute.Get(time_code(time))
            array = np.array(value if value is not None else [])
            width = {"orientations": (4,), "opacities": ()}.get(name, (3,))
            if array.size and (not array.ndim or array.shape[1:] != width or array.dtype.kind != "f"):
                raise found_instead(str(prim.GetPath()), f"{name} of another type", "the schema's")
            if array.size:
                return array
    return np.empty(0, np.float32)


def _checked_layers(path: Path) -> list[Any]:  # of pxr, which has no types
    """The file and all that it is composed of, at any depth: while these are held, a stage opens no other.

    FrogError where one names a file of another computer: nothing that a file says may call one. Opening a layer opens
    nothing that it names.
    """
    from pxr import Sdf

    layers: dict[str, Any] = {}
    waiting = [str(path)]
    while waiting:
        identifier = waiting.pop()
        if identifier in layers:
            continue
        if len(layers) >= _MOST_LAYERS:
            raise found_instead(path, f"more than {_MOST_LAYERS:,} files", "fewer")
        layers[identifier] = layer = Sdf.Layer.FindOrOpen(identifier)
        for name in _named_files(layer) if layer else ():
            if is_network_path(name) or "://" in name or name.startswith("`"):  # "`": made of variables
                raise found_instead(path, f"a reference to {brief(name)}", "files of this computer alone")
        named = layer.GetCompositionAssetDependencies() if layer else ()
        waiting += [layer.ComputeAbsolutePath(name) for name in named if name]
    return list(layers.values())


def _named_files(layer: Any) -> Iterator[str]:  # of pxr, which has no types
    """Every path that a layer says: of compositions, clips, and of values and metadata of any spec."""
    from pxr import Sdf

    yield from layer.GetCompositionAssetDependencies()
    paths: list[Sdf.Path] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
    for path in paths:
        spec = layer.GetObjectAtPath(path) if path != Sdf.Path.absoluteRootPath else layer.pseudoRoot
        if spec is None:  # what a relationship names
            continue
        values = "asset" in str(getattr(spec, "typeName", ""))
        for key in spec.ListInfoKeys():
            if values or key not in ("default", "timeSamples"):
                with suppress(TypeError):  # of a kind that Python has not, which is no path
                    yield from _assets(spec.GetInfo(key), is_clip=key == "clips")


def _assets(value: Any, *, is_clip: bool) -> Iterator[str]:
    """The paths in a value. A pattern of clips is a text."""
    from pxr import Sdf

    if isinstance(value, Sdf.AssetPath):
        yield value.path
    elif isinstance(value, str) and is_clip:
        yield value
    elif isinstance(value, Mapping | Sdf.AssetPathArray):
        for part in value.values() if isinstance(value, Mapping) else value:
            yield from _assets(part, is_clip=is_clip)
