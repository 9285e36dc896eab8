"""Packages that not everybody has: one that is missing is told from one that is there and cannot be loaded."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import FrogError, brief

_PACKAGES = {"pxr": "usd-core"}  # of modules by other names


def is_missing(error: ImportError) -> bool:
    """No such package is installed. Otherwise it is, and could not be loaded: then installing it again is no help."""
    return isinstance(error, ModuleNotFoundError)


def not_loaded(error: ImportError, package: str = "") -> str:
    """A sentence, without its end, about a package that is there: which, and what the system said.

    Args:
        package: its name, where that is known.
    """
    which = f"The Python package {known!r}" if (known := package or _package(error)) else "A Python package"
    said = brief(error).rstrip(".")
    return f"{which} is installed but could not be loaded ({said}); the usual reason is too little free memory"


@contextmanager
def importing(package: str, otherwise: str) -> Iterator[None]:
    """A block that imports a package: FrogError with the sentence ``otherwise`` where it is missing, or another one
    where it cannot be loaded."""
    try:
        yield
    except ImportError as error:
        raise FrogError(otherwise if is_missing(error) else f"{not_loaded(error, package)}.") from error


def needed_package(path: Path, error: ImportError) -> FrogError:
    """The sentence about a file that cannot be read or written without a package."""
    if not is_missing(error):
        return FrogError(f"{path}: {not_loaded(error)}.")
    module = _package(error)
    return FrogError(f"{path}: the Python package {_PACKAGES.get(module, module)!r}, which it needs, is not installed.")


def _package(error: ImportError) -> str:
    """The outermost package; "" where the error does not tell. Of torch/_C.so it knows the name "_C" and the path."""
    if error.path and str(error.name).startswith("_"):
        return Path(error.path).parent.name
    return str(error.name or "").split(".")[0]
