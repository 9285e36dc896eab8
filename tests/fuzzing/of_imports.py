"""Damaged and lying files of other programs, imported and played.

What a library of others reads is read in a process of its own, as in use, only that it is forked from this one, which
has loaded the library.
"""

import json
import multiprocessing
import os
import zipfile
import zlib
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from support import foreign_files
from support.builders import plain_camera
from support.foreign_takes import partly_static
from support.solids import CORNERS, FACES

from frog_blender.engine.editing.closed_mesh import ClosedMesh
from frog_blender.engine.editing.crops import Crop
from frog_blender.engine.editing.edited_scene import EditedScene
from frog_blender.engine.editing.edits import Edits, Timing
from frog_blender.engine.editing.edits_file import load_edits, save_edits
from frog_blender.engine.editing.grades import Grade
from frog_blender.engine.editing.marks import Marks
from frog_blender.engine.errors import FrogError
from frog_blender.engine.interchange import imports
from frog_blender.engine.interchange.frame_files import write_frame
from frog_blender.engine.interchange.gltf import glb_bytes
from frog_blender.engine.interchange.imports import import_scene
from frog_blender.engine.interchange.ply import splat_bytes
from frog_blender.engine.interchange.spz import Spz
from frog_blender.engine.interchange.take import scene_take
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from fuzzing.worker import Kind, limit_time

FORKS = multiprocessing.get_context("fork")


class Imports(Kind):
    """Files that become a scene, which plays.

    Attributes:
        suffix: of the files.
    """

    suffix: str

    def __init__(self, folder: Path) -> None:
        self.target, self._scene = folder / "made.frog", partly_static(folder)
        self.keep(folder / f"mutated{self.suffix}", *self.made(self._scene, folder))

    @staticmethod
    def made(scene: ScenePlayer, folder: Path) -> list[bytes]:
        """The contents of undamaged files."""
        raise NotImplementedError

    def use(self) -> bool:
        self.target.unlink(missing_ok=True)
        self.imported()
        scene = ScenePlayer.load(self.target)
        for time in (0.0, 0.4, 1.0):
            drawn = draw(scene.at(time), plain_camera(), (0.0, 0.0, 0.0))
            assert np.isfinite(drawn.rgb).all()
        return True

    def imported(self) -> None:
        import_scene(self.path, self.target)


class InProcess(Imports):
    """Read by a library that may end its process."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        imports.preload(self.path)

    def imported(self) -> None:
        reader, writer = FORKS.Pipe(duplex=False)
        child = FORKS.Process(target=self._convert, args=(writer,))
        child.start()
        writer.close()
        try:
            said = reader.recv()
        except EOFError:
            said = "its process ended"
        child.join()
        if said:
            raise FrogError(said)

    def _convert(self, writer: Connection) -> None:
        limit_time(self.seconds)  # its own: it must not outlive the file
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
        try:
            imports.convert(self.path, self.target, False, lambda *_: None)
        except FrogError as error:
            writer.send(str(error))
        else:
            writer.send("")


def usd(scene: ScenePlayer, folder: Path, name: str = "whole.usdc") -> list[bytes]:
    from frog_blender.engine.interchange.usd_export import write_usd

    contents = []
    for full in (False, True):
        list(write_usd(folder / name, scene_take(scene, "x", range(3)), full_precision=full))
        contents.append((folder / name).read_bytes())
    return contents


def packed_usd(scene: ScenePlayer, folder: Path) -> list[bytes]:
    from pxr import UsdUtils

    usd(scene, folder)
    assert UsdUtils.CreateNewUsdzPackage(str(folder / "whole.usdc"), str(folder / "whole.usdz"))
    return [(folder / "whole.usdz").read_bytes()]


def spz(scene: ScenePlayer, folder: Path) -> list[bytes]:
    path = folder / "whole.spz"
    write_frame(path, scene.at_frame(2))
    packed = path.read_bytes()
    write_frame(path, scene.at_frame(2), spz=Spz(4))
    return [packed, zlib.decompress(packed, 31), path.read_bytes(), path.read_bytes()]


def gltf(scene: ScenePlayer, folder: Path) -> list[bytes]:
    """With a buffer in the text, and one in a file beside it."""
    beside, buffer = foreign_files.gltf(scene.at_frame(2), "beside.bin")
    (folder / "beside.bin").write_bytes(buffer)
    within, _ = foreign_files.gltf(scene.at_frame(2))
    return [within.encode(), beside.encode()]


def plys(scene: ScenePlayer, _: Path) -> list[bytes]:
    return [make(scene.at_frame(2)) for make in (splat_bytes, foreign_files.double_ply, foreign_files.compressed_ply)]


class SavedEdits(Imports):
    """Edits, which a scene plays with."""

    suffix = ".json"

    @staticmethod
    def made(scene: ScenePlayer, folder: Path) -> list[bytes]:
        count, box = scene.count, tuple(np.eye(4).ravel().tolist())
        some = Marks.of(scene, np.arange(count) % 3 == 0)
        crops = (
            Crop("box", box, feather=0.5),
            Crop("sphere", box, keep_inside=False, time=0.5),
            Crop("mesh", box, feather=0.2, mesh=ClosedMesh.of(CORNERS, FACES)),
        )
        grades = (Grade(exposure=1.0, saturation=0.5), Grade(tint=0.2, size=2.0, only=some))
        edits = Edits(some, crops, grades, Timing((0.0, 1.5, None), 24.0, 1))
        path = folder / "whole.json"
        save_edits(path, edits)
        return [path.read_bytes(), json.dumps(json.loads(path.read_text())).encode()]

    def use(self) -> bool:
        edits, _ = load_edits(self.path).fitted(self._scene)
        scene = EditedScene(self._scene, edits)
        for time in (0.0, 0.4, 1.0):
            assert np.isfinite(draw(scene.at(time), plain_camera(), (0.0, 0.0, 0.0)).rgb).all()
        return True


# By name: how a file ends, what makes undamaged ones, and whether a library that may end its process reads it.
FORMATS: dict[str, tuple[str, Callable[[ScenePlayer, Path], list[bytes]], bool]] = {
    "usdc": (".usdc", usd, True),
    "usda": (".usda", lambda scene, folder: usd(scene, folder, "whole.usda"), True),
    "usdz": (".usdz", packed_usd, True),
    "foreign usd": (".usda", lambda scene, _: [foreign_files.usd(scene.at_frame(2)).encode()], True),
    "spz": (".spz", spz, False),
    "glb": (".glb", lambda scene, _: [glb_bytes(scene.at_frame(2))], False),
    "gltf": (".gltf", gltf, False),
    "splat": (".splat", lambda scene, _: [foreign_files.splat(scene.at_frame(2))], False),
    "splatv": (".splatv", lambda *_: [foreign_files.splatv(foreign_files.trained())[0]], False),
    "curves": (".ply", lambda *_: [foreign_files.ply(foreign_files.trained(), "<f4")], False),
    "sog": (".sog", lambda scene, _: [foreign_files.sog(scene.at_frame(2))], True),
    "ply": (".ply", plys, False),
    "plys": (".zip", lambda scene, _: [foreign_files.zipped(scene, kind) for kind in (0, zipfile.ZIP_DEFLATED)], False),
}
KINDS: dict[str, type[Kind]] = {"edits": SavedEdits} | {
    name: type(name, (InProcess if in_process else Imports,), {"suffix": suffix, "made": staticmethod(made)})
    for name, (suffix, made, in_process) in FORMATS.items()
}
