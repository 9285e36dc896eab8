"""What trains: the environment with torch and pycolmap. Where it is, what is missing of it, and its part of the
preferences.
"""

# Blender reads properties from annotations, which to a type checker or a linter are not types.
# mypy: disable-error-code="valid-type"

import importlib.util
import sys
from pathlib import Path

import bpy

from .. import __package__ as base_package
from ..engine.errors import FrogError
from ..properties import text
from ..tasks import installation
from ..tasks.installation import Installation
from ..tasks.package_folders import CALIBRATION, TORCH, installed
from ..tasks.packages import NO_TORCH, SIZES, has_pycolmap_wheel, suitable_build
from .sidebar_panel import wrapped_label

_PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"


class TrainingPreferences:
    """A base of the add-on's preferences."""

    torch_path: text(
        "Python Environment with torch",
        "A virtual environment or site-packages folder with torch, for the Python version of this Blender",
        subtype="DIR_PATH",
    )
    package_index: text(
        "Package Index",
        "URL of a further package index for Install torch, such as PyTorch's own for the CPU or a CUDA version (see "
        '"Get Started" on its site). Empty for pip\'s default alone',
    )

    def draw_environment(self, layout: bpy.types.UILayout) -> None:
        """Draws which torch there is, and the buttons that install and remove it."""
        layout.prop(self, "torch_path")
        layout.label(text=torch_needed() or "torch is available: training is possible.", icon="INFO")
        layout.label(text="Opening, scrubbing and rendering a .frog file does not need torch.")
        if installed(installation.folder()) is not None:
            layout.operator("frog.remove_torch", icon="TRASH")
        if torch_needed():
            layout.prop(self, "package_index")
            draw_torch_installation(layout)
        elif calibration_needed():
            layout.label(text=calibration_needed(), icon="INFO")
            draw_calibration_installation(layout)


def draw_torch_installation(layout: bpy.types.UILayout) -> None:
    """Draws the button that installs torch, with its size and what it waits for, or the running installation."""
    if _draw_running(layout):
        return
    _draw_download(
        layout, "frog.install_torch", f"Downloads {SIZES[suitable_build()]} for this computer. It asks first."
    )


def draw_calibration_installation(layout: bpy.types.UILayout) -> None:
    """Draws the button that installs what calibration needs, and the progress of an installation."""
    if not _draw_running(layout) and has_pycolmap_wheel():
        _draw_download(layout, "frog.install_calibration", f"Downloads {SIZES[NO_TORCH]}.")


def _draw_download(layout: bpy.types.UILayout, operator: str, what: str) -> None:
    """Draws a button that downloads, and what; or why it is grey."""
    layout.operator(operator, icon="IMPORT")
    is_allowed, needed = bpy.app.online_access, "Allow Online Access first: Preferences > System > Network."
    wrapped_label(layout, what if is_allowed else needed, icon="NONE" if is_allowed else "INFO")


def _draw_running(layout: bpy.types.UILayout) -> bool:
    """Draws the running installation and returns whether there is one; draws the error of one that failed."""
    current = Installation.current()
    if current is None:
        return False
    if current.is_running:
        layout.label(text=current.progress.stage[:100], icon="IMPORT")
        layout.operator("frog.cancel_installation", icon="CANCEL")
    elif current.error:
        layout.label(text=current.error, icon="ERROR")
    return current.is_running


def preference(name: str) -> str:
    """A text of this add-on's preferences; an empty one where a script registered it."""
    addon = bpy.context.preferences.addons.get(base_package)
    return getattr(addon.preferences, name) if addon is not None else ""


def package_index() -> str:
    """URL of pip's package index; an empty string for the default."""
    return preference("package_index").strip()


def use_installation(folder: Path) -> None:
    """Makes the packages of an installation importable, in place of an environment that the preferences name."""
    addon = bpy.context.preferences.addons.get(base_package)
    if addon is not None:
        addon.preferences.torch_path = ""
    add_folder(folder)


def forget_installation() -> None:
    """Makes what *Install torch* had installed no longer importable."""
    parent = installation.folder().parent
    ours = [path for path in sys.path if Path(path).parent == parent and Path(path).name.startswith(TORCH)]
    sys.path[:] = [path for path in sys.path if path not in ours]
    importlib.invalidate_caches()


def torch_path() -> str:
    """The folder set in the preferences, or that of *Install torch*; otherwise an empty string."""
    return preference("torch_path") or str(installed(installation.folder()) or "")


def torch_needed() -> str:
    """What is missing for training, as a sentence; an empty string if torch can be imported. Imports nothing."""
    if _is_importable():
        return ""
    folder = torch_path()
    if not folder:
        return (
            f"Training needs torch. Install it, or choose an environment of Python {_PYTHON} that has it in the "
            "add-on's preferences."
        )
    try:
        site_packages(Path(bpy.path.abspath(folder)))
    except FrogError as error:
        return str(error)
    return ""


def calibration_needed() -> str:
    """What is missing for calibration, as a sentence; an empty string if nothing is. Imports nothing."""
    add_environment()
    if not _is_importable("cv2"):
        return "Calibrating cameras needs OpenCV and pycolmap. Install them here, or with torch in the preferences."
    if _is_importable("pycolmap"):
        return ""
    if has_pycolmap_wheel():
        return "Calibrating cameras needs pycolmap. Install it here, or with torch in the preferences."
    return (
        "Cameras cannot be calibrated on this computer: there is no pycolmap for Intel Macs and for Linux on ARM. "
        "Calibrate the videos on another one and bring cameras_opencv.json along."
    )


def lacks_films() -> bool:
    """Whether torch is there, and not what reads films, which *Install torch* brings besides. Imports neither."""
    return not torch_needed() and not all(map(_is_importable, ("av", "zstandard")))


def make_torch_importable() -> None:
    """Make the environment set in the preferences importable; FrogError if training still lacks torch."""
    add_environment()
    if needed := torch_needed():
        raise FrogError(needed)


def add_environment() -> None:
    """Append the environments of torch and of pycolmap to ``sys.path``, where they are not importable yet."""
    packages = installed(installation.folder(CALIBRATION))
    if packages is not None and not _is_importable("pycolmap"):
        add_folder(packages)
    if _is_importable() or not torch_path():
        return
    try:
        add_folder(site_packages(Path(bpy.path.abspath(torch_path()))))
    except FrogError:
        return  # ``torch_needed`` explains it


def add_folder(folder: Path) -> None:
    """Makes the packages in a folder importable."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))  # appended, so that Blender's own packages win
        importlib.invalidate_caches()


def site_packages(folder: Path) -> Path:
    """The folder with torch in an environment of this Python version, or FrogError."""
    choices = [folder, folder / "lib" / f"python{_PYTHON}" / "site-packages", folder / "Lib" / "site-packages"]
    for choice in choices:
        if (choice / "torch" / "__init__.py").is_file():
            return choice
    others = sorted(path.parent.parent.name for path in folder.glob("lib/python*/site-packages/torch"))
    torch = f"torch for {', '.join(others)}" if others else "no torch"
    raise FrogError(f"{folder}: found {torch}, expected an environment of Python {_PYTHON} with torch.")


def _is_importable(package: str = "torch") -> bool:
    return importlib.util.find_spec(package) is not None
