"""A capture of what a Blender scene shows: a rig of cameras around a box, rendered by a Blender beside this one."""
