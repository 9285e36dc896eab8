"""Opens damaged and hostile bakes, ``.npy``, ``.npz`` and checkpoint files, and uses them; run by
test_damaged_files.py in a process of its own.

    python mutated_files.py KIND FOLDER COUNT SEED

Prints a JSON object: how many were refused in a sentence, how many used, the peak of memory in bytes above what
undamaged files need, and the longest time in seconds. Ends badly at the first other error, warning of numpy, crash, or
file that computes for longer than ten seconds.
"""

from __future__ import annotations

import io
import json
import random
import resource
import signal
import struct
import sys
import time
import warnings
import zipfile
from abc import ABC, abstractmethod
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from fuzzing.mutating import cut, flipped, in_the_header, lying, torn
from support.builders import plain_camera, scene_file
from support.synthetic_capture import FRAMES, HEIGHT, WIDTH, seeds, write_capture

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.engine.evaluation.masks import load_masks
from frog_blender.engine.frames.seed_store import stored_seeds
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.bake import Bake, write_bake
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import write_scene

SECONDS = 10
NUMBERS = [0.0, -0.0, np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45, 1.0, -1.0, 2.0**31, -(2.0**63), 1e300]


def with_other_numbers(content: bytes, chance: random.Random) -> bytes:
    """Some of a safetensors file's numbers, replaced by hostile ones of their type."""
    size = 8 + struct.unpack("<Q", content[:8])[0]
    header = json.loads(content[8:size])
    names = [name for name in header if name != "__metadata__"]
    changed = bytearray(content)
    kinds = {"F32": "<f4", "F64": "<f8", "I64": "<i8", "U8": "u1", "F16": "<f2", "I32": "<i4"}
    for _ in range(chance.randint(1, 3)):
        entry = header[chance.choice(names)]
        begin, end = entry["data_offsets"]
        with np.errstate(all="ignore"):
            number = np.array(chance.choice(NUMBERS)).astype(kinds[entry["dtype"]]).tobytes()
        places = range(size + begin, size + end, len(number))
        if not places:
            continue
        for _ in range(chance.choice([1, 1, 5])):
            place = chance.choice(places)
            changed[place : place + len(number)] = number
        if chance.random() < 0.2:
            changed[size + begin : size + end] = number * len(places)
    return bytes(changed)


TENSORS = [flipped, in_the_header, cut, torn, lying, lying, with_other_numbers]

TEXTS = [
    *("(4, -3)", "(2**80, 3)", "()", "(3,)", "(10**9, 17)", "(1000000000, 17)", "(0, 17)", "'", "\n", "[", "(" * 50),
    *("'|O'", "'<U9'", "'<f2'", "'|u1'", "'<c8'", "'<f16'", "'|b1'", "'<M8[s]'", "'a'", "True", "None", "0x", "{}"),
]


def lying_npy(content: bytes, chance: random.Random) -> bytes:
    """A ``.npy`` whose header says something else."""
    length = 10 + struct.unpack("<H", content[8:10])[0]
    parts = content[10:length].decode().split(" ")
    for _ in range(chance.randint(1, 2)):
        parts[chance.randrange(min(len(parts), 8))] = chance.choice(TEXTS)
    text = " ".join(parts).encode("latin1")
    return (
        content[:6]
        + bytes([chance.choice([1, 1, 1, 2, 3, 9]), 0])
        + struct.pack("<H", len(text))
        + text
        + content[length:]
    )


def numbers_of_npy(content: bytes, chance: random.Random) -> bytes:
    """A ``.npy`` with some hostile numbers."""
    array = np.load(io.BytesIO(content), allow_pickle=False).copy()
    with np.errstate(all="ignore"):
        for _ in range(chance.randint(1, 4)):
            array.flat[chance.randrange(array.size)] = np.array(chance.choice(NUMBERS)).astype(array.dtype)
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def head_flipped(content: bytes, chance: random.Random) -> bytes:
    return flipped(content, chance, 128)


ARRAYS = [flipped, head_flipped, head_flipped, cut, torn, lying_npy, lying_npy, numbers_of_npy]


def repacked(content: bytes, chance: random.Random) -> bytes:
    """An ``.npz`` that is a sound archive of unsound arrays."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = chance.choice(list(members))
    mutation = chance.choice([flipped, head_flipped, cut, torn, lying_npy])
    members[name] = mutation(members[name], chance)
    if chance.random() < 0.2:
        members[chance.choice(["other.npy", "../up.npy", "cam00", "points.npy", "\udcff.npy"])] = members.pop(name)
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", chance.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])) as archive:
        for each, member in members.items():
            archive.writestr(each.encode("utf-8", "replace").decode(), member)
    return file.getvalue()


ARCHIVES = [flipped, flipped, cut, torn, repacked, repacked, repacked]


class Kind(ABC):
    """Files of one kind.

    Attributes:
        path: where one is put.
        whole: contents of undamaged ones.
        mutations: what is done to them.
    """

    path: Path
    whole: list[bytes]
    mutations: list

    @abstractmethod
    def __init__(self, folder: Path) -> None: ...

    @abstractmethod
    def use(self) -> bool:
        """True where the file was taken for what it says; FrogError, or False, where it was not."""


class Bakes(Kind):
    """Of a scene whose fingerprint the hostile know."""

    mutations = TENSORS

    def __init__(self, folder: Path) -> None:
        self.path, self._source = folder / "x.frogbake", folder / "x.frog"
        write_scene(self._source, scene_file(200, moving=120))
        self._scene = ScenePlayer.load(self._source)
        list(write_bake(self.path, self._source, self._scene, [0.0, 0.5, 1.0]))
        self.whole = [self.path.read_bytes()]

    def use(self) -> bool:
        found = Bake(self.path, self._source, self._scene)
        try:
            for frame_time in (0.0, 0.5, 1.0):
                part = found.find(frame_time)
                if part is not None:
                    draw(self._scene.at(frame_time, part), plain_camera(), (0.0, 0.0, 0.0))
        finally:
            found.close()
        assert not found.problem
        return True


class Poses(Kind):
    """``poses_bounds.npy``, opened and decoded to see whether the capture can be worked with."""

    mutations = ARRAYS

    def __init__(self, folder: Path) -> None:
        write_capture(folder / "capture")
        self.path = folder / "capture" / "poses_bounds.npy"
        rows = np.load(self.path, allow_pickle=False)
        self.whole = [self.path.read_bytes()]
        for kind in ("<f4", ">f8"):
            np.save(self.path, rows.astype(kind))
            self.whole.append(self.path.read_bytes())

    def use(self) -> bool:
        capture = open_capture(self.path.parent)
        for camera in capture.cameras:
            camera.ray_directions(np.array([[0.5, 0.5]]))
            camera.to_json()
        return True


class Points(Kind):
    """``points.npy`` of a HyperNeRF folder."""

    mutations = ARRAYS

    def __init__(self, folder: Path) -> None:
        import cv2

        (folder / "camera").mkdir()
        (folder / "rgb" / "2x").mkdir(parents=True)
        names = [f"{index:06d}" for index in range(4)]
        lens = {"orientation": np.eye(3).tolist(), "focal_length": 60.0, "principal_point": [32, 24]}
        for index, name in enumerate(names):
            view = {**lens, "position": [0.1 * index, 0, 0], "image_size": [64, 48]}
            (folder / "camera" / f"{name}.json").write_text(json.dumps(view))
            cv2.imwrite(str(folder / "rgb" / "2x" / f"{name}.png"), np.zeros((24, 32, 3), np.uint8))
        ids = {"ids": names, "train_ids": names[::2], "val_ids": names[1::2]}
        (folder / "dataset.json").write_text(json.dumps(ids))
        (folder / "metadata.json").write_text(json.dumps({name: {"warp_id": int(name)} for name in names}))
        self.path = folder / "points.npy"
        np.save(self.path, np.random.default_rng(0).uniform([-1, -1, 3], [1, 1, 5], (80, 3)).astype(np.float32))
        self.whole = [self.path.read_bytes()]

    def use(self) -> bool:
        capture = open_capture(self.path.parent)
        assert capture.points is not None and np.isfinite(capture.points).all()
        return True


class Masks(Kind):
    mutations = ARCHIVES

    def __init__(self, folder: Path) -> None:
        self._capture = open_capture(write_capture(folder / "capture"))
        self.path, self.whole = folder / "masks.npz", []
        mask = np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8)
        mask[:, 5:15, 20:40] = 255
        for save in (np.savez, np.savez_compressed):
            save(self.path, cam00=mask, cam01=mask[0] > 0)
            self.whole.append(self.path.read_bytes())

    def use(self) -> bool:
        for name, mask in load_masks(self.path, self._capture).items():
            assert name.startswith("cam") and mask.dtype == bool and mask.shape[-2:] == (HEIGHT, WIDTH)
        return True


class KeptSeeds(Kind):
    """What the cache holds: whatever is wrong with it, the search is made again."""

    mutations = ARCHIVES

    def __init__(self, folder: Path) -> None:
        self._capture = open_capture(write_capture(folder / "capture"))
        self._store = FrameStore.open(self._capture, cache_folder=folder / "cache")
        self._searches = 0
        self._seeds()
        (self.path,) = self._store.folder.glob("seeds-*.npz")
        self.whole = [self.path.read_bytes()]

    def _search(self, *_: object, **__: object) -> object:
        self._searches += 1
        return seeds()

    def _seeds(self) -> object:
        return stored_seeds(self._capture, self._store, count_limit=300, search=self._search)

    def use(self) -> bool:
        before = self._searches
        found = self._seeds()
        assert found.points.shape == found.colors.shape and np.isfinite(found.points).all() and len(found.points)
        return self._searches == before


class Checkpoints(Kind):
    """Gone on from with everything the file says, for three steps."""

    mutations = [*TENSORS, with_other_numbers, lying, lying]

    def __init__(self, folder: Path) -> None:
        import torch

        from frog_blender.engine.recipes import recipe
        from frog_blender.engine.training.session.checkpoint import save_checkpoint
        from frog_blender.engine.training.session.job import TrainingJob
        from frog_blender.engine.training.session.output_paths import checkpoint_path

        torch.set_num_threads(1)
        self._cache = folder / "cache"
        small = {"steps": 40, "steps_per_moment": 0, "max_gaussians": 600, "seed_gaussians": 300}
        self._job = TrainingJob(write_capture(folder / "capture"), folder / "x.frog", device="cpu", resume=True)
        self.path, self.whole = checkpoint_path(self._job.output), []
        for changes, done in (({"capacity": "auto"}, 37), ({}, 12), ({"sh_degree": 2}, 25)):
            chosen = recipe("draft", **small, **changes, densify_every=0.05)
            job = TrainingJob(self._job.capture, self._job.output, recipe=chosen, device="cpu")
            trainer = self._trainer(job)
            for _ in range(done):
                trainer.step()
            save_checkpoint(self.path, trainer, job.stored_settings())
            self.whole.append(self.path.read_bytes())

    def _trainer(self, job):  # type: ignore[no-untyped-def]
        from frog_blender.engine.training.compression.schedule import compression_hooks
        from frog_blender.engine.training.optimize.trainer import Limits, Trainer
        from frog_blender.engine.training.session.run import prepare_capture

        capture, _ = prepare_capture(job.capture, job.scale, job.holdout_frames, job.pixel_offsets)
        store = FrameStore.open(capture, cache_folder=self._cache)
        most = min(job.recipe.seed_gaussians, job.recipe.max_gaussians)
        limits = Limits(job.steps or (None if job.seconds else job.recipe.steps_for(capture.frame_count)), job.seconds)
        hooks = compression_hooks(job.recipe, job.method, capture, job.seed)
        points = seeds(min(300, most))
        return Trainer(capture, store, points, job.recipe, job.method, limits, seed=job.seed, hooks=hooks)

    def use(self) -> bool:
        from frog_blender.engine.training.optimize.running_loss import TrainingDiverged
        from frog_blender.engine.training.session.checkpoint import load_checkpoint, restore_job

        job, _ = restore_job(self._job)
        trainer = self._trainer(job)
        load_checkpoint(self.path, trainer)
        try:
            for _ in range(3):
                if not trainer.finished:
                    trainer.step()
        except TrainingDiverged:
            return False
        return True


KINDS: dict[str, type[Kind]] = {
    "bakes": Bakes,
    "poses": Poses,
    "points": Points,
    "masks": Masks,
    "seeds": KeptSeeds,
    "checkpoints": Checkpoints,
}


def used(kind: Kind) -> bool:
    try:
        return kind.use()
    except FrogError as error:
        sentence = str(error)
        assert "\n" not in sentence and len(sentence) < 1000, sentence
        return False


def limit_time() -> None:
    """A file that hangs ends the process: by computing time, for the machine may be busy, and in the end by a clock."""
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.alarm(60 * SECONDS)


def peak() -> int:
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main(kinds: dict[str, type[Kind]]) -> None:
    folder, count, chance = Path(sys.argv[2]), int(sys.argv[3]), random.Random(int(sys.argv[4]))
    kind = kinds[sys.argv[1]](folder)
    if kind.mutations is not TENSORS and not isinstance(kind, Checkpoints):
        warnings.simplefilter("error")  # of numbers that are only read nothing is to be said
    for content in kind.whole:
        kind.path.write_bytes(content)
        assert used(kind)
    before, taken, longest = peak(), 0, 0.0
    for number in range(count):
        mutation = chance.choice(kind.mutations)
        content = mutation(chance.choice(kind.whole), chance)
        kind.path.write_bytes(content)
        began = time.monotonic()
        limit_time()
        try:
            taken += used(kind)
        except BaseException:
            (folder / "culprit").write_bytes(content)
            print(f"file {number}, {mutation.__name__}", file=sys.stderr)
            raise
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
        longest = max(longest, time.monotonic() - began)
    print(json.dumps({"refused": count - taken, "used": taken, "peak": peak() - before, "longest": longest}))


if __name__ == "__main__":
    main(KINDS)
