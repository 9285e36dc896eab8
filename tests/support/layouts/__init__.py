"""Writers of captures in the layouts of other programs, true to their formats, of ``filmed_scene``."""
