"""Cameras from raw footage: films of standing cameras, or one of a moving camera, to poses and lenses.

``pipeline`` runs the stages. Everything that calls pycolmap runs in a child process (``child``).
"""
