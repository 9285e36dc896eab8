"""``frog``: parse, call the engine, print; one file a command."""
