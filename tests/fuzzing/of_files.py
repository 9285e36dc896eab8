"""``.npy``, ``.npz`` and checkpoint files."""

from pathlib import Path

import numpy as np
from support.synthetic_capture import FRAMES, HEIGHT, WIDTH, seeds, write_capture

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.seeds import Seeds, SeedSettings
from frog_blender.engine.evaluation.masks import load_masks
from frog_blender.engine.frames import seed_store
from frog_blender.engine.frames.store import FrameStore
from fuzzing.worker import Kind


class Masks(Kind):
    def __init__(self, folder: Path) -> None:
        self._capture = open_capture(write_capture(folder / "capture"))
        path, contents = folder / "masks.npz", []
        mask = np.zeros((FRAMES, HEIGHT, WIDTH), np.uint8)
        mask[:, 5:15, 20:40] = 255
        for save in (np.savez, np.savez_compressed):
            save(path, cam00=mask, cam01=mask[0] > 0)
            contents.append(path.read_bytes())
        self.keep(path, *contents)

    def use(self) -> bool:
        for name, mask in load_masks(self.path, self._capture).items():
            assert name.startswith("cam") and mask.dtype == bool and mask.shape[-2:] == (HEIGHT, WIDTH)
        return True


class KeptSeeds(Kind):
    """What the cache holds: whatever is wrong with it, the search is made again."""

    def __init__(self, folder: Path) -> None:
        self._capture = open_capture(write_capture(folder / "capture"))
        self._store = FrameStore.open(self._capture, cache_folder=folder / "cache")
        self._searches = 0
        seed_store.find_seeds = self._search  # type: ignore[assignment]
        self._seeds()
        self.keep(*self._store.folder.glob("seeds-*.npz"))

    def _search(self, *_: object) -> Seeds:
        self._searches += 1
        return seeds()

    def _seeds(self) -> object:
        return seed_store.stored_seeds(self._capture, self._store, SeedSettings(300))

    def use(self) -> bool:
        before = self._searches
        found = self._seeds()
        assert found.points.shape == found.colors.shape and np.isfinite(found.points).all() and len(found.points)
        return self._searches == before


class Checkpoints(Kind):
    """Gone on from with everything the file says, for three steps."""

    warnings = "default"

    def __init__(self, folder: Path) -> None:
        import torch

        from frog_blender.engine.recipes import recipe
        from frog_blender.engine.training.session.checkpoint import state_of, write_checkpoint
        from frog_blender.engine.training.session.job import TrainingJob
        from frog_blender.engine.training.session.output_paths import checkpoint_path

        torch.set_num_threads(1)
        self._cache = folder / "cache"
        small = {"steps": 40, "steps_per_moment": 0, "max_gaussians": 600, "seed_gaussians": 300}
        self._job = TrainingJob(write_capture(folder / "capture"), folder / "x.frog", device="cpu", resume=True)
        path, contents = checkpoint_path(self._job.output), []
        for changes, done in (({"capacity": "auto"}, 37), ({}, 12), ({"sh_degree": 2}, 25)):
            chosen = recipe("draft", **small, **changes, densify_every=0.05)
            job = TrainingJob(self._job.capture, self._job.output, recipe=chosen, device="cpu")
            trainer = self._trainer(job)
            for _ in range(done):
                trainer.step()
            write_checkpoint(path, state_of(trainer, job.stored_settings()))
            contents.append(path.read_bytes())
        self.keep(path, *contents)

    def _trainer(self, job):  # type: ignore[no-untyped-def]
        from frog_blender.engine.training.optimize.trainer import Trainer
        from frog_blender.engine.training.session.run import add_hooks, prepare_capture

        capture, _ = prepare_capture(job)
        store = FrameStore.open(capture, cache_folder=self._cache)
        most = min(job.recipe.seed_gaussians, job.recipe.max_gaussians)
        trainer = Trainer(capture, store, seeds(min(300, most)), job.recipe, job)
        add_hooks(trainer)
        return trainer

    def use(self) -> bool:
        from frog_blender.engine.training.optimize.training import TrainingDiverged
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


KINDS: dict[str, type[Kind]] = {"masks": Masks, "seeds": KeptSeeds, "checkpoints": Checkpoints}
