"""``frog``: parse, call the engine, print."""

INTERRUPTED = 130
"""The exit status of a command that was asked to end, as shells give it for Ctrl-C."""
