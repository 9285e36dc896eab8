"""What the command line says at the end of a training."""

from pathlib import Path

import pytest

from frog_blender.cli.progress import show
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.output_paths import checkpoint_path


@pytest.mark.parametrize(
    ("place", "checkpoint", "said"),
    [
        ("out/x.frog", True, "kept in {place}; --resume goes on."),
        ("out/x.frog", False, "kept in {place}."),
        ("rescued/x.frog", True, "kept in {place}; --resume goes on from {checkpoint}."),
        ("rescued/x.frog", False, "kept in {place}."),
        (None, False, "nothing was written."),
    ],
)
def test_a_cancelled_training_says_what_can_be_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str | None, checkpoint: bool, said: str
) -> None:
    """A scene that its disk did not take lies elsewhere; a checkpoint lies beside the output, or nowhere."""
    output = tmp_path / "out" / "x.frog"
    output.parent.mkdir()
    if checkpoint:
        checkpoint_path(output).write_bytes(b"")
    path = str(tmp_path / place) if place else None
    assert not show(iter([events.Cancelled(9, path)]), output)
    sentence = said.format(place=path, checkpoint=checkpoint_path(output))
    assert capsys.readouterr().err.rstrip().endswith(f"cancelled at step 9, {sentence}")
