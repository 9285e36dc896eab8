"""``frog train`` as one of several processes that ``torchrun`` has started."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

from .printing import complain
from .stopping import stopping
from .streams import printing_may_fail

if TYPE_CHECKING:
    from ..engine.training.session.job import TrainingJob


def train_together(job: TrainingJob) -> int:
    """Trains with the other processes; returns the exit status. Rank 0 alone tells of the training."""
    with printing_may_fail(), stopping() as asked:
        from ..engine.training.optimize.view_pass import PeerLost
        from ..engine.training.session.processes import joined
        from ..engine.training.session.run import run_training
        from .progress import show

        with joined(job.device) as processes:
            try:
                stream = run_training(job, asked, peers=processes)
                if processes.rank == 0:
                    return 0 if show(stream, job.output) else 1
                for _ in stream:
                    pass
                return 0  # also when asked to stop: torchrun ends rank 0, which still saves, where another one fails
            except PeerLost as lost:
                complain(lost)
                # torch's threads wait on for a process that hangs, and would hold this one at its end.
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(1)
