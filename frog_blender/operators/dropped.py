"""What importers of files have in common that can be dropped into a window."""

from pathlib import Path
from typing import Any

from bpy_extras.io_utils import ImportHelper


class OpensDroppedFile(ImportHelper):
    """A dropped file brings its path along and needs no file browser."""

    def invoke(self, context: Any, event: Any) -> set[str]:
        if self.filepath and Path(self.filepath).is_file():
            return self.invoke_popup(context)
        return super().invoke(context, event)


class DropsIntoViews:
    """For file handlers: where scenes are seen and listed."""

    @classmethod
    def poll_drop(cls, context: Any) -> bool:
        return context.area is not None and context.area.type in {"VIEW_3D", "OUTLINER"}
