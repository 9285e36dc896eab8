"""``frog info``, ``frog eval`` and ``frog cache``: what a capture, a scene and the cache hold; a scene's quality."""

import argparse
from datetime import datetime
from pathlib import Path
from typing import Any

from ..engine.capture.calibration.report import report_lines
from ..engine.capture.capture import Capture, mask_lines
from ..engine.capture.quality_check import check_capture
from ..engine.capture.readers import open_capture
from ..engine.errors import UsageError, listed
from ..engine.evaluation.metrics import SPLITS
from ..engine.frames.limit import clear, limit_of, make_room, set_limit, stored_frames
from ..engine.io.cache_folder import default_cache_folder
from ..engine.options import TrainingOptions
from ..engine.playback.player import ScenePlayer
from ..engine.recipes import recipe
from ..engine.scene import compression_report
from ..engine.scene.header import SceneHeader
from ..engine.training.session.output_paths import training_seconds
from ..engine.training.session.time_estimate import Workload, estimate, likely_device
from .arguments import Reads, add_options, given_of
from .terminal import add_json_argument, say


def add_info_parser(commands: Any) -> None:
    """Adds the command."""
    info = commands.add_parser("info", help="describe a capture or a .frog")
    info.add_argument("path", type=Path, action=Reads)
    add_json_argument(info)
    info.add_argument(
        "--check",
        action="store_true",
        help="look at some images of a capture: do matches fit the poses, are cameras in step, exposure, blur",
    )
    add_options(info, "pixel_offsets", "masks", "key", "layout")
    info.set_defaults(run=_info)


def _info(options: argparse.Namespace) -> int:
    path, check = options.path, options.check
    if path.suffix == ".frog":
        if check:
            raise UsageError(f"{path}: --check looks at the images of a capture, found a scene.")
        figures, more = _of_scene(ScenePlayer.load(path), path), {}
    else:
        chosen = TrainingOptions(**given_of(options))
        masks, offsets = chosen.mask_settings, chosen.pixel_offsets
        capture = open_capture(path, pixel_offsets=offsets, masks=masks, layout=chosen.layout)
        figures, more = _of_capture(capture), {"training": _training_times(capture)}
        figures |= _checked(capture) if check else {}
    if options.as_json:
        options.figures = figures
        return 0
    for key, value in (_for_people(figures) | more).items():
        for line in value if isinstance(value, list) else [value]:
            say(f"{key.replace('_', ' '):>17}  {f'{line:.6g}' if isinstance(line, float) else line}")
    return 0


def _checked(capture: Capture) -> dict[str, Any]:
    """What some images say of the capture, and what its calibration's report said."""
    from .progress import bar

    with bar("decoding images") as report:
        quality = check_capture(capture, report)
    warnings = ["nothing but the warnings above"] if capture.warnings else ["nothing that should be seen to"]
    findings = list(quality.findings) or warnings
    calibration = report_lines(capture)
    told = {"calibration": calibration} if calibration else {}
    return told | {"check": quality.lines(), "not_told": list(quality.untold), "found": findings}


def _of_capture(capture: Capture) -> dict[str, Any]:
    """What ``--json`` says, see docs/json-schema.json."""
    return {
        "folder": str(capture.path),
        "format": capture.format,
        **_filmed(capture),
        "held_out_cameras": sorted(capture.test_cameras),
        "held_out_frames": sorted(capture.test_frames),
        "masks": mask_lines(capture),
        "has_distortion": any(capture.distortions),
        "warnings": list(capture.warnings),
    }


def _of_scene(scene: ScenePlayer, path: Path) -> dict[str, Any]:
    """The same of a scene."""
    header = scene.header
    return {
        "method": header.method,
        "gaussians": scene.count,
        "dynamic_gaussians": scene.num_dynamic,
        "sh_degree": scene.sh_degree,
        "bytes": path.stat().st_size,
        **_filmed(header),
        "recipe": header.recipe.get("name"),
        "steps": header.steps,
        "training_seconds": training_seconds(path),
        "psnr_db": header.metrics.get("psnr"),
        "split": header.metrics.get("split"),
        "capture": header.capture_path,
        "world": None if header.world.is_plain else f"the files' coordinates are {header.world}",
        "reductions": header.capacity.get("reductions", []),
    }


def _filmed(of: Capture | SceneHeader) -> dict[str, Any]:
    """Cameras and times."""
    sizes = [{"name": each.name, "width_pixels": each.width, "height_pixels": each.height} for each in of.cameras]
    times = {"frames": of.frame_count, "frames_per_second": of.frames_per_second}
    return {"cameras": sizes, "is_moving": of.is_moving, **times}


def _for_people(figures: dict[str, Any]) -> dict[str, Any]:
    """The same in words; a list is printed a line an entry, and nothing of what is not known."""
    cameras = figures["cameras"]
    sizes = sorted({f"{each['width_pixels']} x {each['height_pixels']}" for each in cameras})
    told = {name: value for name, value in figures.items() if value is not None and name != "is_moving"}
    told["cameras"] = "1, moving" if figures["is_moving"] else f"{len(cameras)}: {listed([c['name'] for c in cameras])}"
    told["size"] = ", ".join(sizes)
    told |= {name: listed(told[name]) for name in ("held_out_cameras", "held_out_frames") if name in told}
    return told | {"reductions": compression_report.lines(figures)}


def _training_times(capture: Capture) -> list[str]:
    """How long the recipes for any computer would take, a line each."""
    device = likely_device("auto")
    scale = capture.usual_scale
    works = {name: Workload.of(capture, recipe(name), scale=scale) for name in ("draft", "standard")}
    return [f"{name}: {estimate(work, device)}" for name, work in works.items()]


def add_eval_parser(commands: Any) -> None:
    """Adds the command."""
    evaluate = commands.add_parser("eval", help="compare a scene with the capture's images")
    evaluate.add_argument("scene", type=Path, action=Reads)
    evaluate.add_argument("capture", type=Path, action=Reads)
    evaluate.add_argument("--mask", type=Path, action=Reads, help="an image, or an .npz with a mask for each camera")
    evaluate.add_argument("--split", choices=["auto", *SPLITS], default="auto")
    evaluate.add_argument("--perceptual", action="store_true", help="also FLIP and LPIPS, where they are installed")
    evaluate.add_argument(
        "--cameras",
        type=Path,
        action=Reads,
        metavar="FILE",
        help="instead of the capture's images those that a transforms.json lists, from off the rig",
    )
    evaluate.add_argument("--metric", action="append", default=[], metavar="NAME", help="also this one, of a package")
    add_json_argument(evaluate)
    evaluate.set_defaults(run=_eval)


def _eval(options: argparse.Namespace) -> int:
    from ..engine.evaluation.evaluate import evaluate_file, metrics_named
    from ..engine.evaluation.fly import evaluate_fly
    from ..engine.evaluation.perceptual import perceptual_metrics
    from .progress import bar

    installed, missing = perceptual_metrics() if options.perceptual else ({}, {})
    more = {**metrics_named(options.metric), **installed}
    asked = {"split": options.split, "mask_file": options.mask, "more_metrics": more}
    with bar("Evaluating") as report:
        if options.cameras is None:
            figures = evaluate_file(options.scene, options.capture, **asked, progress=report)
        elif more or options.mask or options.split != "auto" or options.perceptual:
            raise UsageError("--cameras: found --split, --mask, --perceptual or --metric, expected none of them.")
        else:
            figures = evaluate_fly(options.scene, options.capture, options.cameras, progress=report)
    if options.perceptual:
        figures |= {**dict.fromkeys(missing), "missing": missing}
    if options.as_json:
        options.figures = figures
        return 0
    for key, reason in figures.pop("missing", {}).items():
        figures[key] = f"- ({reason})"
    for name, group in figures.pop("groups", {}).items():
        figures |= {name: group["psnr"], f"{name} one_image": group["one_image"]}
    for key, value in figures.items():
        if key != "cameras":
            say(f"{key:>18}  {value:.4f}" if isinstance(value, float) else f"{key:>18}  {value}")
    return 0


def add_cache_parser(commands: Any) -> None:
    """Adds the command."""
    cache = commands.add_parser("cache", help="show or delete decoded frames")
    cache.add_argument("--clear", action="store_true", help="delete all that no running program has open")
    cache.add_argument(
        "--limit", metavar="SIZE", help="how large they may be from now on: 40GB, 25%% of the disk, or default"
    )
    add_json_argument(cache)
    cache.set_defaults(run=_cache)


def _cache(options: argparse.Namespace) -> int:
    folder, done = default_cache_folder(), dict[str, int]()
    if options.limit is not None:
        set_limit(folder, options.limit)
        make_room(folder)
    if options.clear:
        done["freed_bytes"], done["stores_in_use"] = clear(folder)
    entries, (limit, said) = stored_frames(folder), limit_of(folder)
    total = sum(entry.size for entry in entries)
    if options.as_json:
        shown = [
            {"capture": e.index.capture if e.index else "", "folder": str(e.folder), "bytes": e.size}
            | {"used_unix_seconds": e.used}
            for e in entries
        ]
        whole = {"folder": str(folder), "bytes": total, "limit_bytes": limit}
        options.figures = {**whole, **done, "frames": shown}
        return 0
    if done:
        kept = f"; {done['stores_in_use']} in use stay" if done["stores_in_use"] else ""
        say(f"{_size(done['freed_bytes'])} freed{kept}")
    say(f"{folder}: {_size(total)} of decoded frames, at most {_size(limit)} ({said})")
    for entry in reversed(entries):
        used = f"{datetime.fromtimestamp(entry.used):%Y-%m-%d %H:%M}"
        say(f"{_size(entry.size):>10}  {used}  {entry.index.capture if entry.index else entry.folder.name}")
    return 0


def _size(size: int) -> str:
    return f"{size / 1e9:.2f} GB" if size >= 1e8 else f"{size / 1e6:.1f} MB"
