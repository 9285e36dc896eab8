"""``frog``: the engine on the command line. The exit status is 0 only if the command succeeded."""

from __future__ import annotations

import argparse
import errno
import io
import sys
from collections.abc import Sequence
from typing import NoReturn

from ..engine.errors import FrogError
from ..engine.notices import as_sentences
from ..engine.registry import COMMANDS
from .cache_command import add_cache_parser
from .calibrate import add_calibrate_parser
from .demo_command import add_demo_parser
from .eval_command import add_eval_parser
from .export_command import add_export_parser
from .extras import unusable
from .import_command import add_import_parser
from .info_command import add_info_parser
from .printing import complain
from .render_command import add_render_parser
from .stopping import leaving_cleanly
from .train_command import add_recipes_parser, add_train_parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command and returns its exit status; an error is one sentence on standard error."""
    _escape_unprintable()
    as_sentences()
    options = _parser().parse_args(arguments)
    try:
        with leaving_cleanly():
            return int(options.run(options))
    except FrogError as error:
        complain(error)
    except KeyboardInterrupt:
        complain("interrupted.")
    except MemoryError as error:
        complain(f"out of memory ({error}).")
    except ImportError as error:
        complain(unusable(error))
    except BrokenPipeError:
        return 1
    except OSError as error:
        if error.errno == errno.ENOMEM:
            complain(f"out of memory ({error.strerror}).")
            return 1
        where = f"{error.filename}: the file or folder" if error.filename else "A file or folder"
        complain(f"{where} could not be used ({error.strerror or error}).")
    return 1


def _escape_unprintable() -> None:
    """Prints characters that the console's encoding lacks as escapes: names of files may hold any."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


class _PrintVersion(argparse.Action):
    """Looks the version up when asked for it: reading what is installed takes longer than parsing the arguments."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"frog {version('frog-blender')}")
        except PackageNotFoundError:
            parser.error("frog_blender runs without being installed, so its version is not known.")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="frog", description="Dynamic Gaussian scenes: train, evaluate, render.")
    parser.add_argument("--version", action=_PrintVersion, nargs=0, help="print the version of frog_blender")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    add_train_parser(commands)
    add_recipes_parser(commands)
    add_info_parser(commands)
    add_calibrate_parser(commands)
    add_eval_parser(commands)
    add_render_parser(commands)
    add_export_parser(commands)
    add_import_parser(commands)
    add_cache_parser(commands)
    add_demo_parser(commands)
    for name in COMMANDS:
        try:
            COMMANDS[name](commands)
        except FrogError as error:  # of a package that is not ours: the other commands work
            complain(error)
    return parser
