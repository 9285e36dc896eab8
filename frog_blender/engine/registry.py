"""What others may add, by name: methods and the rest of what a training, a reader or an evaluation picks by a name.

A name is found among the built-in ones, then among those that this process registered, then among the entry points of
installed packages. What a name stands for is imported when it is first asked for. See docs/extending.md.
"""

import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from traceback import walk_tb
from typing import Any, Generic, TypeVar

from .arrays import SceneArrays
from .errors import FrogError, GuestFailed, UsageError, reason
from .notices import say

T = TypeVar("T")
Settings = TypeVar("Settings")
Reference = str | Callable[..., Any]
"""A function, or where it is: "package.module:name". Written so, the module is imported when it is called."""

_OURS, _REGISTERED = "of this program", "which was registered"
_NAME = re.compile(r"[a-z0-9][a-z0-9_.-]{0,63}")


class Registry(Generic[T]):
    """Things of one kind by name.

    Args:
        kind: what one of them is called in a sentence.
        group: of the entry points of packages that offer some.
        members: attributes that each must have.
        built_in: ours: the things themselves, or where they are, from this package on: ".module:name", or ".module" for
            a module itself.
    """

    def __init__(self, kind: str, group: str, members: tuple[str, ...], built_in: Mapping[str, T | str]) -> None:
        self.kind, self.group, self._members = kind, group, members
        self._known: dict[str, tuple[T | str, str]] = {name: (thing, _OURS) for name, thing in built_in.items()}
        self._loaded: dict[str, T] = {}
        self._offers: dict[str, list[EntryPoint]] = {}
        self._searched: tuple[str, ...] | None = None  # sys.path, when the entry points were looked for

    def register(self, name: str, thing: T | str) -> None:
        """Adds one for this process.

        Args:
            thing: itself, or where it is: "package.module:name".

        Raises:
            FrogError: the name is taken, or is none.
        """
        if not _NAME.fullmatch(name):
            raise FrogError(f"The name {name!r} of a {self.kind}, expected lower-case letters, digits, _, . and -.")
        if name in self._known:
            raise FrogError(f"There is a {self.kind} {name!r} already, expected another name.")
        if not isinstance(thing, str):
            self._check(name, thing, _REGISTERED)
        self._known[name] = thing, _REGISTERED

    def unregister(self, name: str) -> None:
        """Takes back what ``register`` added; FrogError where it added none of that name."""
        registered = {known: thing for known, (thing, whose) in self._known.items() if whose == _REGISTERED}
        if name not in registered:
            raise FrogError(f"No {self.kind} {name!r} was registered, expected one of {_listed(registered)}.")
        del self._known[name]
        self._loaded.pop(name, None)

    def __contains__(self, name: object) -> bool:
        return name in self._known or name in self._offered()

    def __iter__(self) -> Iterator[str]:
        """Every name: ours, registered ones, then those of installed packages."""
        return iter({**self._known, **dict.fromkeys(sorted(self._offered()))})

    def __getitem__(self, name: str) -> T:
        """What a name stands for.

        Raises:
            UsageError: there is no such name.
            FrogError: what it stands for cannot be used.
        """
        if name in self._loaded:
            return self._loaded[name]
        thing, whose = self._known[name] if name in self._known else self._packaged(name)
        if isinstance(thing, str):
            thing = self._check(name, _imported(thing, f"The {self.kind} {name!r} {whose}"), whose)
        self._loaded[name] = thing
        return thing

    def is_ours(self, name: str) -> bool:
        """Whether a name is of this program, not of others'."""
        return name in self._known and self._known[name][1] == _OURS

    def _packaged(self, name: str) -> tuple[str, str]:
        points = self._offered().get(name, [])
        if not points:
            raise UsageError(f"There is no {self.kind} {name!r}; there are {_listed(self)}.")
        if len(points) > 1:
            packages = " and ".join(_package(point) for point in points)
            raise FrogError(f"The {self.kind} {name!r} is offered by {packages}, expected one package alone.")
        return points[0].value, f"of the package {_package(points[0])}"

    def _offered(self) -> dict[str, list[EntryPoint]]:
        """Entry points by name; searched again where Python looks in other folders than before."""
        path = tuple(sys.path)
        if self._searched != path:
            self._offers = {}
            for point in entry_points(group=self.group):
                if self.is_ours(point.name):
                    say(f"The package {_package(point)} offers a {self.kind} {point.name!r}: the name is taken.")
                else:
                    self._offers.setdefault(point.name, []).append(point)
            self._searched = path
        return self._offers

    def _check(self, name: str, thing: Any, whose: str) -> T:
        lacking = [member for member in self._members if not hasattr(thing, member)]
        if lacking:
            raise FrogError(
                f"The {self.kind} {name!r} {whose} is a {type(thing).__name__} without {', '.join(lacking)},"
                f" expected what docs/extending.md says of a {self.kind}."
            )
        checked: T = thing
        return checked


def _listed(names: Registry[Any] | Mapping[str, object]) -> str:
    return ", ".join(names) or "none"


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else point.module


def _imported(reference: str, what: str) -> Any:
    """What lies at "module:name", relative to this package where it begins with a dot; FrogError about ``what``."""
    module, _, name = reference.partition(":")
    if reference.startswith("."):  # ours fails as it does anywhere, for want of torch for instance
        loaded = import_module(module, __package__)
        return getattr(loaded, name) if name else loaded
    try:
        loaded = import_module(module)
        return getattr(loaded, name) if name else loaded
    except Exception as error:  # of others' code, which may fail in any way
        raise GuestFailed(f"{what} cannot be loaded: {type(error).__name__} ({reason(error)}).") from error


@dataclass(frozen=True)
class Method:
    """A way to model motion, as its training and its playback know it. The module it lies in imports no torch.

    Attributes:
        title: as people write it.
        build: makes the model before the first step, a ``SceneModel``, of a ``ModelInit``.
        play: makes what moves a finished scene's Gaussians, a ``Deformation``, of the arrays and the model's settings
            in its file; without torch where it should play in Blender. None for a method in which nothing moves.
        adapt: the recipe as this method trains it, of a ``Recipe``.
        arrays: names in a scene's file besides those of the canonical Gaussians and "network.*".
    """

    title: str
    build: Reference
    play: Reference | None = None
    adapt: Reference | None = None
    arrays: frozenset[str] = frozenset()

    def model(self, begin: Any) -> Any:
        """The model before its first step."""
        return self._function(self.build)(begin)

    def player(self, arrays: SceneArrays, model: Mapping[str, Any]) -> Any:
        """What moves a finished scene's Gaussians; None where nothing moves them."""
        if self.play is None:
            return None
        play = self._function(self.play)
        try:
            return play(arrays, model)
        except (FrogError, MemoryError):
            raise
        except Exception as error:  # of others' code, which may fail in any way
            why = f"{type(error).__name__}: {reason(error)}"
            raise GuestFailed(f"The method {self.title} cannot play what a training of it wrote ({why}).") from error

    def adapted(self, recipe: Settings) -> Settings:
        """The recipe as this method trains it."""
        if self.adapt is None:
            return recipe
        result: Settings = self._function(self.adapt)(recipe)
        return result

    def _function(self, reference: Reference) -> Callable[..., Any]:
        if not isinstance(reference, str):
            return reference
        function: Callable[..., Any] = _imported(reference, f"{reference} of the method {self.title}")
        return function


_FIELD_ARRAYS = frozenset({"embeddings", "temporal_table", "attention_weight", "attention_query"})
_FIELD_PLAYER = ".playback.deformation:DeformationPlayer"

METHODS: Registry[Method] = Registry(
    "method",
    "frog_blender.methods",
    ("title", "build", "model", "player", "adapted", "arrays"),
    {
        "frog": Method("FRoG", ".training.methods:frog", _FIELD_PLAYER, ".training.methods:embedded", _FIELD_ARRAYS),
        "ed3dgs": Method("E-D3DGS", ".training.methods:frog", _FIELD_PLAYER, ".training.methods:ed3dgs", _FIELD_ARRAYS),
        "static": Method("3DGS (static)", ".training.methods:static", adapt=".training.methods:plain"),
    },
)
"""Ways to model motion; see ``Method``."""

LOSSES: Registry[Callable[..., Any]] = Registry(
    "loss",
    "frog_blender.losses",
    ("__call__",),
    {name: f".training.optimize.losses:{name}" for name in ("l1", "square", "dssim")},
)
"""Terms of the loss: functions of a drawing and of what it should be, both torch (H, W, 3), to one number."""

DENSITY: Registry[Callable[..., Any]] = Registry(
    "density strategy",
    "frog_blender.density",
    ("__call__",),
    {"adaptive": ".training.optimize.densification:DensificationStrategy"},
)
"""Density control: makes a ``DensityStrategy`` of the Gaussians, the recipe and the scene's scale."""

_LAYOUTS = (  # in the order in which they are tried: a folder may hold what several programs wrote
    ("n3dv", "n3dv"),
    ("transforms", "transforms_json"),
    ("hypernerf", "nerfies"),
    ("technicolor", "technicolor"),
    ("calibrated_videos", "calibrated_videos"),
    ("panoptic_sports", "panoptic_sports"),
    ("immersive", "nerfies:IMMERSIVE"),
    ("easyvolcap", "easyvolcap"),
    ("multipleview", "n3dv:MULTIPLEVIEW"),
    ("colmap", "colmap"),
    ("calibration_toml", "calibration_toml"),
)
READERS: Registry[Any] = Registry(
    "reader",
    "frog_blender.readers",
    ("matches", "read"),
    {layout: f".capture.readers.{module}" for layout, module in _LAYOUTS},
)
"""Readers of captures: ``matches(folder)`` tells whether it is theirs, ``read(folder)`` makes a ``Capture`` of it."""

METRICS: Registry[Callable[..., float]] = Registry(
    "metric",
    "frog_blender.metrics",
    ("__call__",),
    {
        "psnr": ".evaluation.metrics:psnr",
        "psnr_fitted": ".evaluation.metrics:psnr_fitted",
        "ssim": ".evaluation.metrics:ssim",
        "flip": ".evaluation.metrics:flip",
        "lpips": ".evaluation.perceptual:lpips",
        "lpips_vgg": ".evaluation.perceptual:lpips_vgg",
    },
)
"""Functions of an image and of what it should be, both numpy (H, W, 3) in [0, 1], to a number."""

SINKS: Registry[Callable[[Any], object]] = Registry("sink", "frog_blender.sinks", ("__call__",), {})
"""Functions that are told every event of a training, see ``training.session.events``."""

RASTERIZERS: Registry[Callable[..., Any]] = Registry(
    "rasterizer",
    "frog_blender.rasterizers",
    ("__call__",),
    {
        "cpu": ".rasterizer.cpu:rasterize",
        "cuda": ".rasterizer.cuda:rasterize",
        "reference": ".rasterizer.reference:rasterize",
    },
)
"""What draws Gaussians differentiably, see ``rasterizer.Backend``: "cpu" and "cuda" float32 tensors that lie there,
"reference" any tensors, slowly."""

COMMANDS: Registry[Callable[[Any], None]] = Registry("command", "frog_blender.commands", ("__call__",), {})
"""Further commands of ``frog``: functions that add a parser to argparse's subparsers."""


@contextmanager
def guests_named() -> Iterator[None]:
    """Inside the block, or the function that it decorates, an error in a package's code becomes a GuestFailed that says
    where; what the system refuses, and a lack of memory, are told as anywhere."""
    try:
        yield
    except (FrogError, MemoryError, OSError):
        raise
    except Exception as error:
        kinds = (METHODS, LOSSES, DENSITY, READERS, METRICS, SINKS, RASTERIZERS, COMMANDS)
        offered = {_outermost(point.module) for kind in kinds for point in entry_points(group=kind.group)}
        for frame, line in reversed([*walk_tb(error.__traceback__)]):
            module = frame.f_globals.get("__name__", "")
            if _outermost(module) in offered - {_outermost(__name__)}:
                why = f"in line {line} ({type(error).__name__}: {reason(error)})"
                raise GuestFailed(f"The package's module {module} failed {why}.") from error
        raise


def _outermost(module: str) -> str:
    return module.partition(".")[0]
