"""How others' programs open what we write: ``make test-clients``, for the table of docs/experiments/interchange.md.

    python tools/clients/clients.py FOLDER [--only PROGRAM]

FOLDER has a ``scene.frog`` and the environments that the Makefile sets up: ``node_modules``, ``python`` and, where
there is a Python 3.13, ``blender``. One frame of the scene is exported by ``frog export`` in every format. A program
either gives back the numbers that it reads, which our rasterizer then draws, or draws a picture itself. Both are
compared with our own picture.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from plyfile import PlyData

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.evaluation.metrics import psnr
from frog_blender.engine.gaussians import GaussianArrays, NumpyGaussians, joined
from frog_blender.engine.interchange.imports import import_scene
from frog_blender.engine.interchange.stills import Y_UP
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import render_image
from frog_blender.engine.playback.transform import Y_DOWN, sh_basis, transform
from frog_blender.engine.spherical_harmonics import SH_DC

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs" / "experiments" / "interchange.md"
FRAME = 15
WIDTH, HEIGHT = 512, 384
PATIENCE = 400  # seconds for one program
Z_UP, TO_Y_UP = np.eye(4), np.linalg.inv(Y_UP)
AXES = {"as they are": Z_UP, "y up": TO_Y_UP, "y down": Y_DOWN}
"""(4, 4) from a scene's own axes, with z up, to those of files."""


@dataclass(frozen=True)
class Format:
    """Attributes:
    options: of ``frog export``.
    axes: those of the file, a key of AXES.
    whole: the file has all frames, not one.
    """

    name: str
    ending: str
    options: tuple[str, ...]
    axes: str = "y up"
    whole: bool = False


FORMATS = (
    Format("`.ply`", ".ply", ("--y-down",), "y down"),
    Format("`.compressed.ply`", ".compressed.ply", ("--compressed-ply", "--y-down"), "y down"),
    Format("`.sog`", ".sog", ("--sog", "--y-down"), "y down"),
    Format("`.spz` 2", ".spz", ("--spz",)),
    Format("`.spz` 3", ".spz", ("--spz", "--spz-version", "3")),
    Format("`.spz` 3 coarse", ".spz", ("--spz", "--spz-version", "3", "--spz-coarse")),
    Format("`.spz` 4", ".spz", ("--spz", "--spz-version", "4")),
    Format("`.glb`", ".glb", ("--glb",)),
    Format("`.usdc`", ".usdc", ("--usd",), "as they are"),
    Format("`.usdc`, 30 frames", ".usdc", ("--usd",), "as they are", whole=True),
    Format("web page, 30 frames", ".html", ("--html",), "as they are", whole=True),
)


class Refused(Exception):
    """A program does not open a file; the message is what it says."""


@dataclass(frozen=True)
class File:
    format: Format
    path: Path


@dataclass(frozen=True)
class Result:
    """Attributes:
    text: of the table's cell.
    note: what is to be said of it below the table, "" for nothing.
    """

    text: str
    note: str = ""


@dataclass(frozen=True)
class Case:
    """What is drawn, and what it has to look like.

    Attributes:
        folder: with the environments, for files as well.
        picture: (H, W, 3) in [0, 1], ours.
    """

    folder: Path
    scene: ScenePlayer
    camera: Camera

    @cached_property
    def picture(self) -> np.ndarray:
        return self.drawn(self.scene.at_frame(FRAME))

    def drawn(self, gaussians: NumpyGaussians) -> np.ndarray:
        return render_image(gaussians, self.camera).astype(np.float32) / 255

    def of_numbers(self, read: NumpyGaussians, file: File, frame: int = FRAME) -> Result:
        """The PSNR of what a program read, in whichever axes it is; those of the file need no word."""
        expected = self.picture if frame == FRAME else self.drawn(self.scene.at_frame(frame))
        found = {axes: psnr(self.drawn(transform(read, np.linalg.inv(AXES[axes]))), expected) for axes in AXES}
        best = max(found, key=lambda axes: found[axes])
        turned = "" if best == file.format.axes else f"with axes {best}"
        return Result(f"{found[best]:.1f}", turned)

    @cached_property
    def clamped(self) -> np.ndarray:
        """(H, W, 3), ours where no Gaussian's colour is beyond 1: some viewers keep eight bits of it."""
        gaussians = self.scene.at_frame(FRAME)
        directions = gaussians.means - self.camera.center
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        colors = np.einsum("nk,nkc->nc", sh_basis(gaussians.sh.shape[1], directions), gaussians.sh)
        return self.drawn(gaussians.changed({"sh": (np.minimum(colors, 0.5) / SH_DC)[:, None]}))

    def of_picture(self, path: Path) -> Result:
        shown = np.asarray(Image.open(path).convert("RGB"), np.float32) / 255
        exact, clamped = psnr(shown, self.picture), psnr(shown, self.clamped)
        return Result(f"{exact:.1f}/{clamped:.1f}" if clamped > exact else f"{exact:.1f}")


def run(*command: str | Path, environment: dict[str, str] | None = None) -> str:
    """What a command prints; Refused with its last words where it fails."""
    try:
        done = subprocess.run(
            [str(word) for word in command],
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=False,
            env={**os.environ, **(environment or {})},
        )
    except subprocess.TimeoutExpired:
        raise Refused(f"nothing in {PATIENCE} seconds") from None
    if done.returncode:
        said = [line.strip() for line in (done.stderr + "\n" + done.stdout).splitlines() if line.strip()]
        raise Refused(next((line for line in reversed(said) if "rror" in line), said[-1] if said else "no word"))
    return done.stdout


def of_ply(path: Path) -> NumpyGaussians:
    """3DGS's plain ``.ply``, by another reader than ours."""
    rows = PlyData.read(str(path))["vertex"].data
    names = rows.dtype.names or ()

    def columns(*wanted: str) -> np.ndarray:
        return np.stack([np.asarray(rows[name], np.float32) for name in wanted], axis=1)

    rest = sum(name.startswith("f_rest_") for name in names)
    sh = columns("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    if rest:
        further = columns(*(f"f_rest_{index}" for index in range(rest))).reshape(len(rows), 3, -1)
        sh = np.concatenate([sh, further.transpose(0, 2, 1)], axis=1)
    opacities = 1 / (1 + np.exp(-np.asarray(rows["opacity"], np.float64)))
    scales, turns = np.exp(columns("scale_0", "scale_1", "scale_2")), columns("rot_0", "rot_1", "rot_2", "rot_3")
    return GaussianArrays(columns("x", "y", "z"), turns, scales, opacities, sh)


Trial = Callable[[Case, File], Result]


def by_us(case: Case, file: File) -> Result:
    """Our own import: what the format itself loses. It turns to z up what has y up by its format's rule."""
    back = ScenePlayer.load(import_scene(file.path, case.folder / "back.frog").path)
    axes = "as they are" if file.format.axes == "y up" else file.format.axes
    turned = replace(file, format=replace(file.format, axes=axes))
    return case.of_numbers(back.at_frame(FRAME if file.format.whole else 0), turned)


def by_splat_transform(case: Case, file: File) -> Result:
    out = case.folder / "read.ply"
    tool = case.folder / "node_modules/@playcanvas/splat-transform/bin/cli.mjs"
    run("node", tool, "-w", "-q", file.path, out)
    return case.of_numbers(of_ply(out), file)


def by_package(name: str, kind: str = "ply") -> Trial:
    def trial(case: Case, file: File) -> Result:
        out = case.folder / f"read.{kind}"
        run(case.folder / "python/bin/python", HERE / "read.py", name, file.path, out)
        if kind == "ply":
            return case.of_numbers(of_ply(out), file)
        with np.load(out) as found:
            read = GaussianArrays.of({name: found[name] for name in found})
        result = case.of_numbers(read, file, 0 if file.format.whole else FRAME)
        return replace(result, note="the first frame") if file.format.whole else result

    return trial


def by_gltf_validator(case: Case, file: File) -> Result:
    said = json.loads(run("node", case.folder / "validate.mjs", file.path))
    unknown = f"does not know KHR_gaussian_splatting ({said['unknown']} complaints)"
    return Result("valid", f"{unknown}, others: {', '.join(said['others']) or 'none'}")


def by_usd_validators(_case: Case, file: File) -> Result:
    from pxr import Usd, UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(file.path)))
    if errors:
        raise Refused(", ".join(sorted({error.GetName() for error in errors})))
    return Result("valid")


def by_blender(case: Case, file: File) -> Result:
    """Blender's own importer without the add-on, the frame on its timeline."""
    out = case.folder / "read.npz"
    script = ROOT / "tests" / "support" / "stock_usd_import.py"
    run(case.folder / "blender/bin/python", script, file.path, str(FRAME + 1), out)
    with np.load(out) as found:
        arrays = {name: found[name] for name in found}
    parts = []
    for cloud in sorted({name.rpartition("/")[0] for name in arrays}):
        here = {name.rpartition("/")[2]: array for name, array in arrays.items() if name.rpartition("/")[0] == cloud}
        base = here["radiance:base"]
        further = [here[f"radiance:sh_{index}"] for index in range(15) if f"radiance:sh_{index}" in here]
        sh = np.stack([base[:, :3], *further], axis=1)
        read = GaussianArrays(here["position"], here["rotation"], here["scale"], base[:, 3], sh)
        parts.append(transform(read, here["place"]))
    return case.of_numbers(joined(parts), file)


def view_of(camera: Camera, axes: str) -> dict[str, Any]:
    """What viewers.js wants of a camera for a file with these axes."""
    to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])  # y up, z back
    fov = 2 * np.degrees(np.arctan(camera.height / 2 / camera.intrinsics[1, 1]))
    return {"fov": fov, "matrix": (AXES[axes] @ to_world).T.ravel().tolist()}


def by_viewer(name: str) -> Trial:
    def trial(case: Case, file: File) -> Result:
        picture = case.folder / f"{name} {file.path.name}.png"
        job: dict[str, Any] = {"width": WIDTH, "height": HEIGHT, "picture": str(picture), "url": f"/{file.path.name}"}
        if file.format.ending == ".html":
            job["url"] += f"#camera={case.camera.name}&frame={FRAME}&plain"
        else:
            job |= {"viewer": name, **view_of(case.camera, file.format.axes)}
        jobs = case.folder / "jobs.json"
        jobs.write_text(json.dumps([job]))
        said = json.loads(run("node", case.folder / "view.mjs", jobs, environment={"FROG_CHROMIUM": chromium()}))
        if "error" in said or np.asarray(Image.open(picture).convert("RGB")).std() < 1:
            raise Refused([*said["said"], said.get("error", "nothing, and draws nothing")][0])
        return case.of_picture(picture)

    return trial


def chromium() -> str:
    found = os.environ.get("FROG_CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    if found is None:
        raise Refused("there is no Chromium; FROG_CHROMIUM names one")
    return found


@dataclass(frozen=True)
class Program:
    """Attributes:
    package: whose version it has: ``npm NAME``, ``pip NAME``, or "" for none.
    endings: of the formats that it says it opens.
    """

    name: str
    package: str
    endings: tuple[str, ...]
    trial: Trial

    def version(self, folder: Path) -> str:
        kind, _, name = self.package.partition(" ")
        if kind == "npm":
            return str(json.loads((folder / "node_modules" / name / "package.json").read_text())["version"])
        python = {"ours": sys.executable}.get(kind, folder / kind / "bin" / "python")
        script = f"from importlib.metadata import version; print(version({name!r}))"
        return run(python, "-c", script).strip() if name else ""


PLY = (".ply", ".compressed.ply")
SPLATS = (*PLY, ".spz", ".sog")
PROGRAMS = (
    Program("our import", "", (*SPLATS, ".glb", ".usdc"), by_us),
    Program("splat-transform", "npm @playcanvas/splat-transform", SPLATS, by_splat_transform),
    Program("gsply", "python gsply", SPLATS, by_package("gsply")),
    Program("gaussforge", "python gaussforge", SPLATS, by_package("gaussforge")),
    Program("fourdgs", "python fourdgs", (".compressed.ply", ".glb", ".usdc"), by_package("fourdgs", "npz")),
    Program("glTF validator", "npm gltf-validator", (".glb",), by_gltf_validator),
    Program("usd-core's validators", "ours usd-core", (".usdc",), by_usd_validators),
    Program("Blender", "blender bpy", (".usdc",), by_blender),
    Program("Spark", "npm @sparkjsdev/spark", SPLATS, by_viewer("Spark")),
    Program("GaussianSplats3D", "npm @mkkellogg/gaussian-splats-3d", (*PLY, ".spz"), by_viewer("GaussianSplats3D")),
    Program("PlayCanvas", "npm playcanvas", (*PLY, ".sog", ".glb"), by_viewer("PlayCanvas")),
    Program("three.js", "npm three", (".ply", ".spz", ".glb"), by_viewer("three.js")),
    Program("Chromium", "", (".html",), by_viewer("Chromium")),
)


def exported(case: Case, form: Format, index: int) -> File:
    frames = () if form.whole else ("--frames", f"{FRAME}:{FRAME + 1}")
    out = case.folder / f"export{index}"
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    target = out if {"--usd", "--html"}.isdisjoint(form.options) else out / f"x{form.ending}"
    command = Path(sys.executable).with_name("frog"), "export", case.folder / "scene.frog"
    run(*command, "--out", target, *frames, *form.options)
    written = next(path for path in out.iterdir() if path.name.endswith(form.ending))
    path = case.folder / f"scene{index}{form.ending}"
    shutil.move(written, path)
    return File(form, path)


def tried(program: Program, case: Case, file: File) -> Result:
    if file.format.ending not in program.endings:
        return Result("")
    try:
        result = program.trial(case, file)
    except Refused as refused:
        result = Result("no", f'"{refused}"')
    print(f"{program.name}, {file.format.name}: {result.text} {result.note}", flush=True)
    return result


def table(rows: Iterable[tuple[str, list[str]]]) -> str:
    (head, titles), *others = rows
    lines = [f"| {head} | {' | '.join(titles)} |", "|---" * (len(titles) + 1) + "|"]
    return "\n".join([*lines, *(f"| {name} | {' | '.join(cells)} |" for name, cells in others)])


def fill_in(block: str, text: str) -> None:
    """Puts it between a block's marks on the page."""
    marks = re.compile(rf"(<!-- {block} -->\n).*?(<!-- end of {block} -->)", re.DOTALL)
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(marks.sub(lambda match: f"{match[1]}{text}\n\n{match[2]}", page), encoding="utf-8")


def case_in(folder: Path, width: int, height: int) -> Case:
    """With our scripts beside the scene; the camera is the first."""
    for script in (*HERE.glob("*.mjs"), HERE / "view.html", HERE / "viewers.js"):
        shutil.copy(script, folder)
    scene = ScenePlayer.load(folder / "scene.frog")
    return Case(folder, scene, scene.header.cameras[0].resized(width, height))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", metavar="PROGRAM", help="try one again, and keep what is known of the others")
    options = parser.parse_args()
    folder = options.folder.resolve()
    case = case_in(folder, WIDTH, HEIGHT)
    Image.fromarray(np.uint8(case.picture * 255 + 0.5)).save(folder / "ours.png")
    files = [exported(case, form, index) for index, form in enumerate(FORMATS)]
    kept = folder / "results.json"
    known = json.loads(kept.read_text()) if options.only else {}
    rows = [
        ("program", [file.format.name for file in files]),
        ("size, MB", [f"{file.path.stat().st_size / 1e6:.2f}" for file in files]),
    ]
    notes = []
    for program in PROGRAMS:
        try:
            name = f"{program.name} {program.version(folder)}".strip()
        except (Refused, OSError) as error:
            notes.append(f"- {program.name} could not be set up here: {error}.")
            continue
        if options.only in (None, program.name):
            for file in files:
                known[f"{program.name}, {file.format.name}"] = astuple(tried(program, case, file))
                kept.write_text(json.dumps(known))
        results = [Result(*known.get(f"{program.name}, {file.format.name}", ("?",))) for file in files]
        rows.append((name, [result.text for result in results]))
        for note in dict.fromkeys(result.note for result in results if result.note):
            about = [file.format.name for file, result in zip(files, results, strict=True) if result.note == note]
            notes.append(f"- {program.name}, {', '.join(about)}: {note}.")
    text = "\n\n".join([table(rows), "\n".join(notes)])
    print(text)
    fill_in("clients", text)


if __name__ == "__main__":
    main()
