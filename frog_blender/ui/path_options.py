"""Options of path properties."""

PATH_OPTIONS = {"ANIMATABLE", "PATH_SUPPORTS_BLEND_RELATIVE"}  # the latter lets a path begin at the .blend's folder
