"""Captures among the user's objects: a scene of captures follows the user's scene, and the compositor overlays its
image.
"""
