"""Trains onto a disk that becomes read-only; run by test_fallback_save.py in a process that has mounted one for itself.

python read_only_disk.py CAPTURE DISK
"""

import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support import synthetic_capture as film

from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

capture, disk = Path(sys.argv[1]), Path(sys.argv[2])
settings = recipe("draft", steps=40, steps_per_moment=0, max_gaussians=600)
task = TrainingJob(capture, disk / "x.frog", recipe=settings, seeds=film.seeds(), save_every=0.0)
for event in run_training(task):
    if isinstance(event, events.Started):
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    if isinstance(event, events.WarningEvent):
        print(event.message)
    if isinstance(event, events.Finished):
        print("left on the disk:", sorted(path.name for path in disk.iterdir()))
        print("Finished", event.path)
