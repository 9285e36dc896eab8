"""A process that shares a training and writes nothing: it does its part of the steps until the first one has ended."""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
from collections.abc import Iterator
from contextlib import suppress

from ...errors import FrogError
from ..compression.schedule import CompressionFailed
from ..optimize.peers import PeerLost
from ..optimize.running_loss import TrainingDiverged
from . import events
from .events import Event
from .fallback_save import Checkpoints
from .output_paths import checkpoint_path
from .recovery import Recovery
from .roll_call import RollCall
from .session import Session


def follow(session: Session) -> Iterator[Event]:
    """Takes part in a training to its end; see ``run.run_training``."""
    trainer, cancel = session.trainer, session.cancel
    recovery = Recovery(trainer, session.job.stored_settings())
    trainer.add_hook(recovery)
    checkpoints, calls = Checkpoints(checkpoint_path(session.output), trainer.step_count), RollCall(trainer)
    try:
        while not calls.ended:
            if not calls.goes_on(not cancel.ended) or trainer.finished:
                continue  # the first one writes, and calls when it has, or if it has to go back
            try:
                trainer.step()
            except CompressionFailed as failed:
                recovery.without_milestone(trainer, failed)
                calls.went_back()
            except (TrainingDiverged, RuntimeError, MemoryError) as error:
                recovery.rollback(trainer, error)
                calls.went_back()
    except PeerLost as error:
        raise left_alone(error, session, recovery, checkpoints) from error
    finally:
        trainer.hooks.remove(recovery)
    path = str(session.output)
    if trainer.finished:
        yield events.Finished(path, trainer.step_count, trainer.seconds, None, trainer.count)
    else:
        yield events.Cancelled(trainer.step_count, path)


def left_alone(error: PeerLost, session: Session, recovery: Recovery, checkpoints: Checkpoints) -> FrogError:
    """Saves a training that lost a process, as far as it had come; returns what is to be said.

    Every process that is left does so: the first one may be the one that is lost. What they write is the same.
    """
    trainer = session.trainer
    with suppress(TrainingDiverged):  # then the last state that was good is saved
        recovery.snapshot(trainer)
    warnings = [event.message for event in checkpoints.save(recovery.last_state)]
    if warnings:
        return FrogError(f"{error} {warnings[0]}")
    step = recovery.last_state[1]["step_count"]
    path = checkpoint_path(session.output)
    return FrogError(f"{error} The training is kept in {path} up to step {step:,}; --resume goes on from there.")
