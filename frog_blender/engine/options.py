"""The one table of a training's options: command line, Python API, panel, checkpoints and the
pages take names, ranges, defaults and help from here. Imports neither torch nor bpy."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum, auto
from types import MappingProxyType
from typing import Any

from .capture.masking import MaskSettings, chroma_key
from .capture.readers.readings import LAYOUTS
from .errors import FrogError
from .recipes import RECIPES, Recipe, recipe
from .registry import METHODS
from .setting import MEANING, Choice, Field, Kind, Meaning, Name, Number, OrNone, check, plain, text_of

_MOST_CAMERAS, _MOST_OFFSET = 10_000, 1e6


class Resume(Enum):
    """What becomes of an option where a training is resumed."""

    KEPT = auto()
    """The training goes on with what it began with; what is given beside is ignored, and it says so."""
    ANEW = auto()
    """What is given counts; otherwise what it began with."""
    FREE = auto()
    """It is of this process: no checkpoint knows it."""


@dataclass(frozen=True)
class Option(Meaning):
    """One option.

    Attributes:
        name: in Python and in files.
        default: None where something else decides.
        unset: what decides where it is None.
        placeholder: what stands for a value in help; N for whole numbers where nothing else is said.
        flag_name: on the command line, where that is another: what is given one by one.
        label: in the panel; the name, where nothing else is said.
        panel_name: of the panel's property, where that is another.
        panel_unit: that property's unit, in the option's.
        items: of a choice: a label and a meaning for each value.
        resume: see ``Resume``.
        not_in_panel: why the Train panel does not have it; "" where it does.
    """

    name: str = ""
    default: Any = None  # of the option's own type
    unset: str = ""
    placeholder: str = ""
    flag_name: str = ""
    label: str = ""
    panel_name: str = ""
    panel_unit: float = 1.0
    items: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    resume: Resume = Resume.KEPT
    not_in_panel: str = ""

    @property
    def flag(self) -> str:
        """On the command line."""
        return f"--{(self.flag_name or self.name).replace('_', '-')}"

    @property
    def described(self) -> str:
        """What it is and what it is where it is not given, as part of a sentence."""
        values = "; ".join(f"{name}: {meaning}" for name, (_, meaning) in self.items.items())
        help = f"{self.help} ({values})" if values else self.help
        return help if self.is_switch else f"{help}; default: {self.unset or text_of(self.default)}"

    @property
    def is_switch(self) -> bool:
        """Whether it is on or off."""
        return isinstance(self.default, bool)

    @property
    def plain_kind(self) -> Kind:
        """What it takes where it is not None."""
        return self.kind.kind if isinstance(self.kind, OrNone) else self.kind


@dataclass(frozen=True)
class Key(Kind):
    """A chroma key as ``masking.chroma_key`` reads it."""

    expected = "a colour and a tolerance, such as green or #00b140,0.4"

    def accepts(self, value: object) -> bool:
        try:
            return isinstance(value, str) and bool(chroma_key(value))
        except FrogError:
            return False


@dataclass(frozen=True)
class RecipeChoice(Choice):
    """The name of a recipe; in Python a recipe as well."""

    def accepts(self, value: object) -> bool:
        return isinstance(value, Recipe) or super().accepts(value)


@dataclass(frozen=True)
class PixelOffsets(Kind):
    """Pixels (x, y) by camera, as ``open_capture`` takes them."""

    expected = "CAMERA=DX,DY such as cam01=8,0"

    def accepts(self, value: object) -> bool:
        return isinstance(value, dict) and len(value) <= _MOST_CAMERAS and all(map(_is_offset, value.values()))

    def parse(self, text: str) -> dict[str, tuple[float, ...]]:
        """Of several cameras, with blanks between them."""
        return self.parse_all(text.split())

    def parse_all(self, texts: Iterable[str]) -> dict[str, tuple[float, ...]]:
        """Of several CAMERA=DX,DY; ValueError for other texts."""
        pairs = [text.split("=") for text in texts]
        return {camera: tuple(float(pixels) for pixels in pair.split(",")) for camera, pair in pairs}


def _is_offset(value: object) -> bool:
    pixels = Number(-_MOST_OFFSET, _MOST_OFFSET)
    return isinstance(value, tuple) and len(value) == 2 and all(map(pixels.accepts, value))


@dataclass(frozen=True)
class RecipeSettings(Kind):
    """Settings of a recipe by name, which itself says of each what it takes."""

    expected = "settings of a recipe by name"

    def accepts(self, value: object) -> bool:
        return isinstance(value, dict) and all(isinstance(name, str) for name in value)


def _option(default: object, kind: Kind, help: str, **more: Any) -> Field:
    """A dataclass field that is an option."""
    return field(default=default, metadata={MEANING: Option(kind, help, default=default, **more)})


@dataclass(frozen=True, kw_only=True)
class JobOptions:
    """Options of a training besides its recipe's."""

    method: str = _option("frog", Choice(lambda: tuple(METHODS)), "how motion is modelled")
    steps: int | None = _option(
        None,
        OrNone(Number(1, 10**12, whole=True)),
        "training steps",
        unset="as many as the recipe needs",
        resume=Resume.ANEW,
    )
    seconds: float | None = _option(
        None,
        OrNone(Number(1e-9, 1e12)),
        "time to train for, without reading images and saving",
        unset="a number of steps",
        placeholder="SECONDS",
        label="Minutes",
        panel_name="minutes",
        panel_unit=60.0,
        resume=Resume.ANEW,
    )
    seed: int = _option(0, Number(0, 2**32 - 1, whole=True), "of everything random")
    scale: float | None = _option(
        None,
        OrNone(Number(1e-4, 16)),
        "image size factor, such as 0.5",
        unset="at most 1600 pixels a side",
        placeholder="FACTOR",
        label="Image Scale",
        panel_name="image_scale",
    )
    holdout_frames: int | None = _option(
        None,
        OrNone(Number(2, 10**6, whole=True, or_zero=True)),
        "leave every K-th frame out, to measure quality on it; 0: none",
        unset="what the capture's layout says",
        placeholder="K",
        label="Hold Out Every",
    )
    max_gaussians: int | None = _option(
        None,
        OrNone(Number(1, 10**7, whole=True)),
        "Gaussians of the scene at most",
        unset="as many as the recipe allows",
        label="Largest Number",
    )
    max_bytes: int | None = _option(
        None,
        OrNone(Number(1, 2**50, whole=True)),
        "size of the .frog at most, in bytes; with automatic capacity and a packed file",
        unset="any size",
        label="Megabytes",
        panel_name="max_megabytes",
        panel_unit=1e6,
        resume=Resume.ANEW,
    )
    lossless: bool = _option(False, Choice((True, False)), "write every number as it is, not packed")
    masks: str = _option(
        "auto",
        Choice(("auto", "off")),
        "which pixels of the images are learned",
        items={
            "auto": ("From the Folder", "only the subject of images with alpha or masks"),
            "off": ("None", "whole images, whatever masks there are"),
        },
    )
    key: str | None = _option(
        None,
        OrNone(Key()),
        "backdrop that is not part of the subject: green, blue or #00b140; tolerance from 0 to 0.95, usually 0.4",
        unset="none",
        placeholder="COLOUR[,TOLERANCE]",
        label="Key Colour",
        panel_name="key_color",
    )
    pixel_offsets: Mapping[str, tuple[float, float]] | None = _option(
        None,
        OrNone(PixelOffsets()),
        "pixel of the calibrated image at a cropped video's upper left corner",
        unset="none",
        placeholder="CAMERA=DX,DY",
        flag_name="pixel_offset",
    )
    layout: str = _option(
        "auto",
        Choice(LAYOUTS),
        "what the names of images say, where they can be read in several ways",
        items={
            "auto": ("Automatic", "as poses, lenses and words in the names tell"),
            "cameras": ("Cameras First", "folders, or what stands first in a name, are cameras"),
            "moments": ("Moments First", "folders, or what stands first in a name, are moments"),
            "moving": ("One Moving Camera", "all images are of one camera, one after the other"),
            "one-moment": ("One Moment", "each image is of a camera of its own, all at once"),
        },
    )
    device: str = _option(
        "auto",
        Choice(("auto", "cpu", "cuda")),
        "what computes the training",
        items={
            "auto": ("Automatic", "a GPU on which torch and FRoG's kernels work, else the CPU"),
            "cpu": ("CPU", "all cores of the CPU"),
            "cuda": ("CUDA", "the NVIDIA GPU; needs a torch with CUDA"),
        },
        resume=Resume.FREE,
    )
    save_every: float = _option(
        180.0,
        Number(0, 1e9),
        "time between checkpoints: what a killed training loses at most",
        placeholder="SECONDS",
        resume=Resume.FREE,
    )
    preview_camera: str | None = _option(
        None,
        OrNone(Name(1000)),
        "camera whose view is shown during training",
        unset="the first held-out camera",
        placeholder="NAME",
        label="Preview",
        resume=Resume.FREE,
    )
    overwrite: bool = _option(
        False,
        Choice((True, False)),
        "replace a scene that is there, once the new one is whole",
        resume=Resume.FREE,
        not_in_panel="a training from the panel writes a file of its own, with a number where there is one already",
    )
    resume: bool = _option(
        False,
        Choice((True, False)),
        "go on from the checkpoint beside the .frog, with its options; only lengths, max_bytes, device, save_every and "
        "preview_camera may be given anew",
        resume=Resume.FREE,
        not_in_panel="the buttons Resume and Train Longer are for it",
    )

    def __post_init__(self) -> None:
        for declared in fields(self):
            if MEANING in declared.metadata:
                value = plain(getattr(self, declared.name))
                check(declared.name, value, declared.metadata[MEANING].kind)
                object.__setattr__(self, declared.name, value)

    @property
    def mask_settings(self) -> MaskSettings:
        """Of the masks and the key."""
        return MaskSettings(self.masks != "off", self.key)


@dataclass(frozen=True, kw_only=True)
class TrainingOptions(JobOptions):
    """All options of a training."""

    recipe: str | Recipe = _option(  # noqa: RUF009  # it gives a dataclass field
        "standard",
        RecipeChoice(tuple(RECIPES)),
        "length of the training and size of the model",
        label="Quality",
        items={
            "draft": ("Quick Look (Draft)", "a first look: at least 3,000 steps, a minute or two on a CPU"),
            "standard": (
                "Good (Standard)",
                "the usual choice: at least 10,000 steps, three to ten minutes on a CPU, longer for long captures",
            ),
            "paper-exact": ("Final (Paper)", "the FRoG paper's: 80,000 steps of a larger model, many hours"),
            "hypernerf-exact": ("Paper, HyperNeRF", "the paper's for one moving camera: 60,000 steps"),
            "technicolor-exact": ("Paper, Technicolor", "the paper's for its shortest captures: 100,000 steps"),
        },
    )
    capacity: str = _option(
        "auto",
        Choice(("auto", "fixed")),
        "how much the model of a scene may hold",
        items={
            "auto": ("Automatic", "no more than the scene needs: static parts get no motion, files stay small"),
            "fixed": ("Fixed", "every Gaussian can move, and nothing is compressed"),
        },
    )
    settings: Mapping[str, Any] | None = _option(
        None,
        OrNone(RecipeSettings()),
        "settings of the recipe, of which `frog recipes` tells",
        unset="none",
        placeholder="NAME=VALUE",
        flag_name="set",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.chosen_recipe()

    def chosen_recipe(self) -> Recipe:
        """The recipe of that name with what the other options change of it, before any budget."""
        return recipe(self.recipe, **{"capacity": self.capacity, **(self.settings or {})})


def _table() -> dict[str, Option]:
    """By name, those of the recipe first."""
    own = [declared for declared in fields(TrainingOptions) if declared.name not in JobOptions.__dataclass_fields__]
    ordered = (*own[:1], *fields(JobOptions)[:3], *own[1:], *fields(JobOptions)[3:])
    return {declared.name: _named(declared.metadata[MEANING], declared.name) for declared in ordered}


def _named(option: Option, name: str) -> Option:
    """With what its name and its kind say."""
    is_whole = isinstance(option.plain_kind, Number) and option.plain_kind.whole
    placeholder = option.placeholder or ("N" if is_whole else "")
    return replace(option, name=name, label=option.label or name.replace("_", " ").title(), placeholder=placeholder)


OPTIONS: Mapping[str, Option] = MappingProxyType(_table())
"""Every option of a training, by name."""


def panel_options() -> list[Option]:
    """Those that the Train panel has."""
    return [option for option in OPTIONS.values() if not option.not_in_panel]
