"""``frog``: parse, call the engine, print."""
