"""The commands of ``frog``, and how each ends: see ``cli.DONE`` and the other statuses."""

import argparse
import errno
import io
import sys
from collections.abc import Sequence
from traceback import format_exception
from typing import Any, NoReturn, TextIO

from ..engine.errors import CaptureRefused, FrogError, GuestFailed, UsageError, brief
from ..engine.notices import as_sentences
from ..engine.optional_imports import is_missing, not_loaded
from ..engine.registry import COMMANDS, guests_named
from . import CANCELLED, FAILED, REFUSED, WRONG_USE
from .arguments import check_there
from .calibrate import add_calibrate_parser
from .info_command import add_cache_parser, add_eval_parser, add_info_parser
from .render_command import add_export_parser, add_import_parser, add_render_parser
from .terminal import answering, complain, leaving_cleanly, log_line, printed
from .train_command import add_recipes_parser, add_train_parser

_OURS = (
    add_train_parser,
    add_recipes_parser,
    add_info_parser,
    add_calibrate_parser,
    add_eval_parser,
    add_render_parser,
    add_export_parser,
    add_import_parser,
    add_cache_parser,
)

EXTRAS = {
    "torch": ("train",),
    "cv2": ("render", "train"),
    "av": ("render", "train"),
    "PIL": ("render", "train"),
    "zstandard": ("spz", "render", "train"),
    "pycolmap": ("calibrate",),
    "tqdm": ("render", "train"),
    "matplotlib": ("chart", "pictures"),
    "flip_evaluator": ("chart",),
    "pxr": ("usd",),
    "OpenEXR": ("exr",),
    "distributed": ("cluster", "chart"),
    "cryptography": ("cluster", "chart"),
}
"""The extras of ``pyproject.toml`` that install a module, the smallest first."""


def run(arguments: Sequence[str] | None) -> int:
    """See ``main.main``."""
    _escape_unprintable()
    as_sentences()
    options = _parser().parse_args(arguments)
    with printed(getattr(options, "be_quiet", False), getattr(options, "log_file", None)):
        return _status(options)


_REASONS = {UsageError: WRONG_USE, CaptureRefused: REFUSED}


def _status(options: argparse.Namespace) -> int:
    """Does what is asked for; an error is told, and is a status."""
    try:
        with leaving_cleanly() as leaving:
            check_there(getattr(options, "reads", ()))
            with answering(options), guests_named():
                status = int(options.run(options))
            return CANCELLED if status and leaving.was_asked else status
    except FrogError as error:
        complain(error)
        if isinstance(error, GuestFailed) and error.__cause__:
            log_line("".join(format_exception(error.__cause__)))
        if leaving.was_asked:
            return CANCELLED
        return next((status for kind, status in _REASONS.items() if isinstance(error, kind)), FAILED)
    except KeyboardInterrupt:
        complain("interrupted.")
        return CANCELLED
    except UnicodeEncodeError as error:  # of a library that takes no bytes
        complain(f"{brief(error.object)}: found a name that is not UTF-8, expected one that is: rename the file.")
    except MemoryError as error:
        complain(f"out of memory ({error}).")
    except ImportError as error:
        complain(unusable(error))
    except BrokenPipeError:
        return FAILED
    except OSError as error:
        where = f"{error.filename}: the file or folder" if error.filename else "A file or folder"
        what = "out of memory" if error.errno == errno.ENOMEM else f"{where} could not be used"
        complain(f"{what} ({error.strerror or error}).")
    return FAILED


def unusable(error: ImportError) -> str:
    """One sentence about a package that could not be imported: what to install, or why it does not load."""
    if not is_missing(error):
        return f"{not_loaded(error)}."
    module = str(error.name).split(".")[0]
    extras = " or ".join(f'".[{extra}]"' for extra in EXTRAS.get(module, ()))
    advice = f"pip install {extras} brings it" if extras else "see the README for the extras to install"
    return f"the Python package {module!r} is missing; {advice}."


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
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Command)
    for add in _OURS:
        add(commands)
    for name in COMMANDS:
        try:
            with guests_named():
                COMMANDS[name](commands)
        except FrogError as error:  # of a package that is not ours: the other commands work
            complain(error)
    return parser


class _Command(argparse.ArgumentParser):
    """With the options that every command has; one of a package may have its own of these names."""

    def __init__(self, **told: Any) -> None:
        super().__init__(conflict_handler="resolve", **told)
        self.add_argument("--quiet", action="store_true", dest="be_quiet", help="results, warnings and errors alone")
        self.add_argument("--log", type=_log_file, dest="log_file", metavar="FILE", help="add what is told to a file")


def _log_file(path: str) -> TextIO:
    try:
        return open(path, "a", encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{path} cannot be written ({error.strerror})") from error
