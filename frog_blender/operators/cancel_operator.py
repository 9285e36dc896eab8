"""Operators that cancel what runs in the background."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..tasks.background_task import BackgroundTask


class CancelsTask:
    """A base next to ``bpy.types.Operator``."""

    kind: ClassVar[type[BackgroundTask]]
    """Of what is cancelled."""

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return cls.kind.is_any_running()

    def execute(self, _context: bpy.types.Context) -> set[str]:
        task = self.kind.current()
        if task is not None:
            task.cancel()
        return {"FINISHED"}
