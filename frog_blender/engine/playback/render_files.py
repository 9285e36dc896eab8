"""Frames of a scene, rendered to image files."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

import numpy as np

from ..arrays import Array
from ..capture.camera import MAX_PIXELS, Camera
from ..capture.media import EXR
from ..capture.video import IMAGE_SUFFIXES, VIDEO_SUFFIXES, load_opencv, write_image
from ..errors import UsageError, in_words, listed
from ..gaussians import NumpyGaussians
from ..io.atomic_files import check_writable, write_atomically
from ..native.options import RasterizeOptions
from ..notices import say
from ..optional_imports import importing
from ..scene.header import SceneHeader
from ..source_media.clips import camera_path
from .passes import Snapshot, combined_pass, depth_pass, vector_pass
from .player import ScenePlayer
from .render import Drawing, draw, render_image, to_uint8
from .views import View

ALPHAS = ("none", "straight", "premultiplied")
_JPEG = (".jpg", ".jpeg")
_WRITTEN = (".png", *_JPEG, EXR)


class PlayedFrames(Protocol):
    """What has frames: a scene, or one that is retimed."""

    @property
    def header(self) -> SceneHeader:
        """Of the scene's file."""

    @property
    def keeps_identity(self) -> bool:
        """See ``ScenePlayer``."""

    def at_frame(self, frame: int) -> NumpyGaussians:
        """Gaussians at a frame counted from 0."""


def render_views(
    scene: ScenePlayer,
    views: Sequence[View],
    output: Path,
    *,
    background: tuple[float, float, float] | None = None,
    alpha: str = "none",
    full_precision: bool = False,
    vectors: bool = False,
    chosen: Sequence[int] | None = None,
) -> Iterator[Path]:
    """Writes an image for each view; yields their paths as they are written. Whole images alone are ever there.

    PNG and JPEG are display-referred. EXR is scene-linear (Rec. 709), with the layers Combined, Depth (planar, of the
    median surface), Mean Depth (planar, by blending weight) and Vector, named and meant as Blender's: colours are half
    floats, the others single precision. Depths are in the scene's units, 1e10 where nothing is.

    Args:
        views: in order of time.
        output: a folder, made if it does not exist, for a PNG of each view, named after its camera and its number; or
            a name that ends in .png, .jpg or .exr, in which #### stands for the number, at its end where it has none.
        background: display-referred sRGB; None for the one that the scene was trained with.
        alpha: "none" for an image over the background; "straight" or "premultiplied" for one without it.
        full_precision: of an EXR's colours.
        vectors: whether an EXR has the layer Vector: motion to the view before and from the one after.
        chosen: indices of the views to write; None for all.

    Raises:
        FrogError: for what cannot be written so, before anything is drawn; and if a file cannot be written.
    """
    files = image_files(views, output)
    _check(views, files, alpha, of_exr=full_precision or vectors)
    behind = None if alpha != "none" else scene.header.background if background is None else background
    for index in range(len(views)) if chosen is None else chosen:
        view, path = views[index], files[index]
        if path.suffix.lower() != EXR and behind is not None:
            write_image(path, render_image(_shown(scene, view), view.camera, behind))
            yield path
            continue
        drawing = draw(_shown(scene, view), view.camera)
        say(drawing.notice)
        covered = drawing.alpha[..., None].clip(0, 1)
        share = np.maximum(covered, 1e-6) if alpha == "straight" else np.float32(1)
        if path.suffix.lower() == EXR:
            combined = combined_pass(drawing, None if behind is None else np.array(behind), *drawing.alpha.shape[::-1])
            combined[..., :3] /= share
            motion = _motion(scene, views, index) if vectors else None
            write_exr(path, _layers(drawing, combined if full_precision else combined.astype(np.float16), motion))
        else:
            write_image(path, to_uint8(np.concatenate([drawing.rgb / share, covered], axis=-1)))
        yield path


def image_files(views: Sequence[View], output: Path) -> list[Path]:
    """The file of each view, see ``render_views``; FrogError for a name of which no images can be made."""
    name = output.name
    if "#" not in name and (output.suffix.lower() not in (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES) or output.is_dir()):
        return [output / f"{_safe(view.camera.name)}_{view.number:04d}.png" for view in views]
    stem, suffix = (output.stem, output.suffix) if "#" not in output.suffix and output.suffix else (name, ".png")
    if suffix.lower() not in _WRITTEN:
        raise UsageError(f"{output}: found the ending {suffix}, expected one of {', '.join(_WRITTEN)}.")
    before, marks, after = re.split("(#+)(?=[^#]*$)", stem if "#" in stem else f"{stem}####")
    return [output.with_name(f"{before}{view.number:0{len(marks)}d}{after}{suffix}") for view in views]


def _check(views: Sequence[View], files: Sequence[Path], alpha: str, *, of_exr: bool) -> None:
    """FrogError for images that cannot be written."""
    if len(set(files)) < max(len(files), 1):
        raise UsageError(f"Found {len(files)} images of {len(set(files))} numbers, expected one of each, and some.")
    if (most := max(view.camera.width * view.camera.height for view in views)) > MAX_PIXELS:
        raise UsageError(f"Found images of {most:,} pixels, expected at most {MAX_PIXELS:,}.")
    suffix = files[0].suffix.lower()
    if of_exr and suffix != EXR:
        raise UsageError(f"{files[0]}: found floats or motion vectors, expected a name that ends in {EXR} for them.")
    if alpha not in ALPHAS or (alpha != "none" and suffix in _JPEG):
        raise UsageError(f"{files[0]}: found {alpha} alpha, expected {listed(ALPHAS)}; of JPEG none.")
    load_openexr() if suffix == EXR else load_opencv()
    with in_words(f"{files[0].parent}: the folder could not be made"):
        files[0].parent.mkdir(parents=True, exist_ok=True)
    check_writable(files[0])


def _shown(scene: ScenePlayer, view: View) -> NumpyGaussians:
    """As many Gaussians at each frame, all of them transparent where the scene is not there."""
    if view.frame is not None:
        return scene.at_frame(view.frame)
    still = scene.at_frame(0)
    return still.changed({"opacities": np.zeros_like(still.opacities)})


def _layers(drawing: Drawing, combined: Array, motion: Array | None) -> dict[str, Array]:
    """The channels of an EXR by Blender's names."""
    size = combined.shape[1::-1]
    mean = depth_pass(replace(drawing, median_z=drawing.mean_depth), *size)
    layers = [("Combined", "RGBA", combined), ("Depth", "Z", depth_pass(drawing, *size)), ("Mean Depth", "Z", mean)]
    layers += [("Vector", "XYZW", motion)] if motion is not None else []
    return {
        f"ViewLayer.{name}.{channel}": np.atleast_3d(layer)[..., index]
        for name, channels, layer in layers
        for index, channel in enumerate(channels)
    }


def _motion(scene: ScenePlayer, views: Sequence[View], index: int) -> Array:
    """(H, W, 4) see ``vector_pass``; an end of the views has the motion of its only neighbour, a single one none."""

    def snapshot_at(offset: int) -> Snapshot:
        is_there = 0 <= index + offset < len(views) and (scene.keeps_identity or not offset)
        view = views[index + offset if is_there else index]
        return _shown(scene, view) if is_there else None, view.camera

    return vector_pass(snapshot_at, RasterizeOptions())


def load_openexr() -> Any:  # of OpenEXR, which has no types
    """OpenEXR, which writes EXR files of many channels; FrogError where it is not installed."""
    with importing("OpenEXR", f'The Python package OpenEXR is missing, which writes {EXR}; pip install ".[exr]".'):
        import OpenEXR

        return OpenEXR


def write_exr(path: Path, channels: Mapping[str, Array]) -> None:
    """Writes a multilayer EXR of one part.

    Args:
        channels: (H, W) float16 or float32 by name, such as "ViewLayer.Combined.R" (Blender's).

    Raises:
        FrogError: if it cannot be written, or OpenEXR is not installed.
    """
    library = load_openexr()
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    with TemporaryDirectory() as folder:  # the library writes into files alone
        part = Path(folder, "image.exr")
        library.File(header, {name: np.ascontiguousarray(values) for name, values in channels.items()}).write(str(part))
        write_atomically(path, part.read_bytes())


def _safe(name: str) -> str:
    """Without characters that lead to another folder on any system."""
    return re.sub(r'[/\\:*?"<>|]', "_", name)


def camera_at(header: SceneHeader, name: str) -> Callable[[float], Camera]:
    """One of a scene's cameras at each frame of the capture; of a moving camera each name is one pose, and "moving"
    follows its path. FrogError where the scene has no such camera."""
    if header.is_moving and name == "moving":
        path = dict(camera_path(header))
        # The nearest frame that has an image: captures may leave some out.
        return lambda frame: path[min(path, key=lambda known: abs(known - frame))]
    names = [camera.name for camera in header.cameras]
    if name not in names:
        raise UsageError(f"The scene has no camera {name!r}; its cameras: {listed(names)}.")
    fixed = header.cameras[names.index(name)]
    return lambda frame: fixed
