"""Options and settings of a recipe as somebody gives them: by name, as NAME=VALUE, in a TOML file."""

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from .errors import FrogError, UsageError, brief, found_instead, told_as
from .io.regular_file import read_text
from .options import OPTIONS, TrainingOptions
from .recipes import Recipe
from .setting import Kind, check, meanings_of, nearest, parsed, plain

_LARGEST = 2**20  # bytes of a file


def kind_of_setting(name: str) -> Kind:
    """What an option or a setting of a recipe takes; FrogError, with the nearest one, for a name that is neither."""
    known = {**meanings_of(Recipe), **OPTIONS}
    if name not in known:
        raise FrogError(f"There is no option or setting {brief(repr(name))}{nearest(name, tuple(known))}")
    return known[name].kind


@told_as(UsageError)
def training_options(values: Mapping[str, Any]) -> TrainingOptions:
    """Options by name, checked. A recipe of one's own, and one that follows a paper, keep their capacity unless another
    is given.

    Raises:
        FrogError: for a name that none has, with the nearest one, and for a value that an option does not take.
    """
    for name in values:
        if name not in OPTIONS:
            raise FrogError(f"A training has no option {brief(repr(name))}{nearest(name, tuple(OPTIONS))}")
    chosen = values.get("recipe")
    own = {"capacity": chosen.capacity} if isinstance(chosen, Recipe) else {}
    if isinstance(chosen, str) and chosen.endswith("-exact"):
        own = {"capacity": "fixed"}
    return TrainingOptions(**{**own, **values})


def given(values: Mapping[str, Any]) -> dict[str, Any]:
    """Options as ``TrainingOptions`` takes them, of options and settings of a recipe by name, whose own may stand by
    themselves under "settings" as well. FrogError for names that are neither."""
    options: dict[str, Any] = {}
    settings: dict[str, Any] = {}
    for name, value in values.items():
        check(name, plain(value), kind_of_setting(name))
        if name == "settings":
            settings |= value or {}
        elif name in OPTIONS:
            options[name] = value
        else:
            settings[name] = value
    return options | ({"settings": settings} if settings else {})


@told_as(UsageError)
def given_texts(texts: Iterable[str]) -> dict[str, Any]:
    """The same of NAME=VALUE; FrogError for other texts."""
    values: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise FrogError(f"{brief(repr(text))} is no NAME=VALUE, such as network_rate=1e-3.")
        values[name.strip()] = parsed(name.strip(), value.strip(), kind_of_setting(name.strip()))
    return given(values)


@told_as(UsageError)
def given_file(path: Path) -> dict[str, Any]:
    """The same of a TOML file; FrogError where it is none, or says something else."""
    what = "a TOML file of options"
    content = read_text(path, what, _LARGEST)
    try:
        values = tomllib.loads(content)
    except (ValueError, RecursionError) as error:
        raise found_instead(path, f"text that is no TOML ({error})", what) from error
    try:
        return given(values)
    except FrogError as error:
        raise FrogError(f"{path}: {error}") from error


def joined(*parts: Mapping[str, Any]) -> dict[str, Any]:
    """What several places gave, the later before the earlier; settings of a recipe each by itself."""
    settings = {name: value for part in parts for name, value in (part.get("settings") or {}).items()}
    options = {name: value for part in parts for name, value in part.items()}
    return options | ({"settings": settings} if settings else {})
