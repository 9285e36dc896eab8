"""A training beside Blender's main thread, and what the panel shows of it."""
