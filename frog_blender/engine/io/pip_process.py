"""Runs pip, and ends it when the parent process ends, which closes this process's input.

    python -I pip_process.py WHEEL ARGUMENTS...

WHEEL is a file with pip in it, or "" for the installed one. Whatever ends the parent closes the input, even a crash,
and with it pip ends at once. Nothing of the package is imported here.
"""

import os
import runpy
import sys
import threading


def _end_with_parent() -> None:
    """Standard input ends when the parent does, however that ended."""
    while os.read(0, 1024):  # not sys.stdin, whose lock would outlive the interpreter
        pass
    os._exit(1)


def main() -> None:
    wheel, *arguments = sys.argv[1:]
    if wheel:
        sys.path.insert(0, wheel)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    sys.argv = ["pip", *arguments]
    runpy.run_module("pip", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
