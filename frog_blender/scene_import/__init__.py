"""A .frog file -> objects in a Blender scene, all or nothing."""
