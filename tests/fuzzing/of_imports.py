"""Damaged and lying files of other programs, imported and played.

What a library of others reads is read in a process of its own, as in use, only that it is forked from this one, which
has loaded the library.
"""

from __future__ import annotations

import json
import os
import zipfile
import zlib
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
from frog_blender.engine.interchange.imports import import_scene
from frog_blender.engine.interchange.ply import splat_bytes
from frog_blender.engine.interchange.take import SceneTake
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from fuzzing.worker import Kind, limit_time


class Imports(Kind):
    """Files that become a scene, which plays.

    Attributes:
        suffix: of the files.
    """

    suffix: str

    def __init__(self, folder: Path) -> None:
        self.target, self._scene = folder / "made.frog", partly_static(folder)
        self.keep(folder / f"mutated{self.suffix}", *self.made(folder))

    def made(self, folder: Path) -> list[bytes]:
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
        reader, writer = os.pipe()
        child = os.fork()
        if not child:
            limit_time(self.seconds)  # its own: it must not outlive the file
            try:
                devnull = os.open(os.devnull, os.O_WRONLY)
                os.dup2(devnull, 1)
                os.dup2(devnull, 2)
                request = {"source": str(self.path), "target": str(self.target), "compact": False}
                try:
                    answer = imports.convert(request, lambda *_: None)
                except FrogError as error:
                    answer = {"error": str(error)}
                os.write(writer, json.dumps(answer).encode())
                os._exit(0)
            finally:
                os._exit(1)
        os.close(writer)
        with os.fdopen(reader, "rb") as pipe:
            content = pipe.read()
        _, status = os.waitpid(child, 0)
        answer = json.loads(content) if content else {"error": f"it ended with status {status}"}
        if "error" in answer:
            raise FrogError(answer["error"])


class BinaryUsd(InProcess):
    suffix = ".usdc"

    def made(self, folder: Path) -> list[bytes]:
        from frog_blender.engine.interchange.usd_export import write_usd

        path, contents = folder / f"whole{self.suffix}", []
        for full in (False, True):
            list(write_usd(path, SceneTake(self._scene, "x", range(3)), full_precision=full))
            contents.append(path.read_bytes())
        return contents


class TextUsd(BinaryUsd):
    suffix = ".usda"


class PackedUsd(InProcess):
    suffix = ".usdz"

    def made(self, folder: Path) -> list[bytes]:
        from pxr import UsdUtils

        from frog_blender.engine.interchange.usd_export import write_usd

        inner, path = folder / "whole.usdc", folder / "whole.usdz"
        list(write_usd(inner, SceneTake(self._scene, "x", range(3))))
        assert UsdUtils.CreateNewUsdzPackage(str(inner), str(path))
        return [path.read_bytes()]


class ForeignUsd(InProcess):
    """As other programs write it: prims that are moved, shared, time-sampled in some attributes, and cameras."""

    suffix = ".usda"

    def made(self, folder: Path) -> list[bytes]:
        return [foreign_files.usd(self._scene.at_frame(2)).encode()]


class Spz(Imports):
    suffix = ".spz"

    def made(self, folder: Path) -> list[bytes]:
        from frog_blender.engine.interchange.spz import write_spz

        path = folder / "whole.spz"
        write_spz(path, self._scene.at_frame(2))
        packed = path.read_bytes()
        write_spz(path, self._scene.at_frame(2), version=4)
        return [packed, zlib.decompress(packed, 31), path.read_bytes(), path.read_bytes()]


class Gltf(Imports):
    suffix = ".glb"

    def made(self, folder: Path) -> list[bytes]:
        from frog_blender.engine.interchange.gltf import write_glb

        path = folder / "whole.glb"
        write_glb(path, self._scene.at_frame(2))
        return [path.read_bytes()]


class TextGltf(Imports):
    """With a buffer in the text, and one in a file beside it."""

    suffix = ".gltf"

    def made(self, folder: Path) -> list[bytes]:
        beside, buffer = foreign_files.gltf(folder, self._scene.at_frame(2), "beside.bin")
        (folder / "beside.bin").write_bytes(buffer)
        within, _ = foreign_files.gltf(folder, self._scene.at_frame(2), None)
        return [within.encode(), beside.encode()]


class Splat(Imports):
    suffix = ".splat"

    def made(self, folder: Path) -> list[bytes]:
        return [foreign_files.splat(self._scene.at_frame(2))]


class Ksplat(Imports):
    suffix = ".ksplat"

    def made(self, folder: Path) -> list[bytes]:
        return [foreign_files.ksplat(self._scene.at_frame(2), level) for level in (0, 1, 2)]


class Sog(InProcess):
    suffix = ".sog"

    def made(self, folder: Path) -> list[bytes]:
        return [foreign_files.sog(self._scene.at_frame(2))]


class Ply(Imports):
    suffix = ".ply"

    def made(self, folder: Path) -> list[bytes]:
        gaussians = self._scene.at_frame(2)
        return [splat_bytes(gaussians), foreign_files.double_ply(gaussians)]


class SavedEdits(Imports):
    """Edits, which a scene plays with."""

    suffix = ".json"

    def made(self, folder: Path) -> list[bytes]:
        count, box = self._scene.count, tuple(np.eye(4).ravel().tolist())
        some = Marks.of(self._scene, np.arange(count) % 3 == 0)
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


class Plys(Imports):
    suffix = ".zip"

    def made(self, folder: Path) -> list[bytes]:
        return [
            foreign_files.zipped(self._scene, compression) for compression in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        ]


KINDS: dict[str, type[Kind]] = {
    "usdc": BinaryUsd,
    "usda": TextUsd,
    "spz": Spz,
    "glb": Gltf,
    "splat": Splat,
    "ksplat": Ksplat,
    "sog": Sog,
    "ply": Ply,
    "plys": Plys,
    "usdz": PackedUsd,
    "foreign usd": ForeignUsd,
    "gltf": TextGltf,
    "edits": SavedEdits,
}
