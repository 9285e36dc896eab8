"""What there is to compile: the kernels' source texts, their specialisations and the compiler's options."""

from dataclasses import dataclass
from pathlib import Path

KERNELS = Path(__file__).parent / "kernels"
SHARED = Path(__file__).parents[1] / "native" / "src" / "shared"

# No fused operations where forward and backward, or counting and listing, must round alike in different kernels.
_EXACT = ("-fmad=false",)
# Blending says itself where it fuses; quick division and square root, no denormals.
_QUICK = ("-ftz=true", "-prec-div=false", "-prec-sqrt=false")

_OPTIONS = {
    "project": _EXACT,
    "scan": _EXACT,
    "emit": _EXACT,
    "sort": _EXACT,
    "blend": _QUICK,
    "blend_backward": _QUICK,
    "project_backward": _EXACT,
}
_FIELD = {"EMBEDDING": ("32", "48", "64"), "OUTPUTS": ("16", "64")}
CHOICES: dict[str, dict[str, tuple[str, ...]]] = {
    "project": {"SH_COUNT": ("1", "4", "9", "16")},
    "scan": {},
    "emit": {},
    "sort": {},
    "blend": {"DEPTH": ("0", "1"), "WEIGHTS": ("0", "1")},
    "blend_backward": {},
    "project_backward": {"SH_COUNT": ("1", "4", "9", "16"), "POSE": ("0", "1")},
    "loss": {"SSIM": ("0", "1")},
    "loss_backward": {},
    "observe": {},
    "adam": {},
    "smooth": {},
    "windows": {},
    "field": _FIELD,
    "field_backward": _FIELD,
    "field_sums": {},
    "field_table": {},
}


@dataclass(frozen=True)
class Kernel:
    """One kernel compiled for one set of constants.

    Attributes:
        name: of the function, and of its file without ``.cu``.
        constants: (name, value) pairs, given to the compiler as ``-DNAME=VALUE``.
    """

    name: str
    constants: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        return f"{self.name}({', '.join(f'{name}={value}' for name, value in self.constants)})"

    @property
    def path(self) -> Path:
        """The file that holds it."""
        return KERNELS / f"{self.name}.cu"

    @property
    def source(self) -> str:
        """The text of that file."""
        return self.path.read_text(encoding="utf-8")

    @property
    def headers(self) -> dict[str, str]:
        """Texts by the names under which it may include them."""
        paths = [*sorted(SHARED.glob("*.h")), *sorted(KERNELS.glob("*.cuh"))]
        return {path.name: path.read_text(encoding="utf-8") for path in paths}

    @property
    def options(self) -> tuple[str, ...]:
        """For the compiler, without the architecture."""
        definitions = (f"-D{name}={value}" for name, value in self.constants)
        return ("-std=c++17", *_OPTIONS.get(self.name, ()), *definitions)


def kernel(name: str, **constants: object) -> Kernel:
    """The kernel ``name`` for these constants, such as ``kernel("blend", DEPTH=True, WEIGHTS=False)``.

    KeyError or ValueError when there is no such kernel, constant or value.
    """
    choices = CHOICES[name]
    values = {key: str(int(value)) if isinstance(value, bool) else str(value) for key, value in constants.items()}
    if values.keys() != choices.keys() or any(value not in choices[key] for key, value in values.items()):
        raise ValueError(f"{name} takes {choices}, not {values}")
    return Kernel(name, tuple((key, values[key]) for key in choices))
