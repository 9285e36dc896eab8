"""The process in which pycolmap and the synchronisation run: ``python -m ...calibration.child TASK FOLDER``.

It reads ``request.json`` there and writes ``result.json``: a result, ``{"refused": sentence}`` or
``{"error": sentence}``.
Progress goes to standard output, a line of JSON each. It ends when the process that started it does.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from pathlib import Path

from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.plain_values import entries, plain_json
from .calibration import CalibrationRefused
from .child_process import REQUEST, RESULT


def main(arguments: list[str]) -> int:
    """Runs the task that the arguments name; anything but a FrogError ends the process as it is."""
    task, name = arguments
    folder = Path(name)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        request = entries(plain_json((folder / REQUEST).read_text(encoding="utf-8"), "a request"), "a request")
        if task == "standing":
            from .standing_task import standing as run
        elif task == "features":
            from .feature_task import find_features as run
        elif task == "synchronization":
            from .clock_task import clocks as run
        elif task == "scan":
            from .scan_task import scan as run
        else:
            from .moving_task import moving as run
        result = run(request, _tell)
    except CalibrationRefused as refused:
        result = {"refused": str(refused)}
    except FrogError as error:
        result = {"error": str(error)}
    write_atomically(folder / RESULT, json.dumps(result).encode())
    return 0


def _tell(stage: str, done: int, all_: int) -> None:
    print(json.dumps({"stage": stage, "done": done, "all": all_}), flush=True)


def _end_with_parent() -> None:
    """Standard input ends when the parent does, however that ended."""
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
