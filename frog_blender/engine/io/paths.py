"""Paths that a file says, which may come from anybody."""

from __future__ import annotations


def is_network_path(path: str) -> bool:
    r"""True for a path by which Windows would call another computer or speak to a device.

    Windows takes strokes of either kind for the same: ``\\server\share``, ``//server/share`` and both mixtures begin
    with two, as ``\\?\UNC\server\share`` and ``\\.\pipe\name`` do; ``\??\UNC\server\share`` does not. The question is
    the same on every system, so that a scene is treated alike by all.
    """
    return path.replace("/", "\\").startswith(("\\\\", "\\??\\"))
