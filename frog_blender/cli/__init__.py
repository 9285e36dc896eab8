"""``frog``: parse, call the engine, print."""

DONE, FAILED, WRONG_USE, CANCELLED, REFUSED = range(5)
"""Exit statuses. After CANCELLED the same command, or ``--resume``, goes on; REFUSED are captures and footage."""
