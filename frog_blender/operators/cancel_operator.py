"""Operators that cancel what runs in the background."""

from __future__ import annotations

import bpy

from ..tasks.background_task import BackgroundTask


class CancelsTask:
    """A base next to ``bpy.types.Operator``."""

    @staticmethod
    def task() -> BackgroundTask | None:
        """What is cancelled: running, or the last one that ran."""
        raise NotImplementedError

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        task = cls.task()
        return task is not None and task.is_running

    def execute(self, _context: bpy.types.Context) -> set[str]:
        task = self.task()
        if task is not None:
            task.cancel()
        return {"FINISHED"}
