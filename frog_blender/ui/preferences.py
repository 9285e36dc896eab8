"""The add-on's preferences: where torch is, for training, and how much memory playing may take."""

# mypy: disable-error-code="valid-type"

import importlib.util
import sys
from pathlib import Path
from typing import Any

import bpy
from bpy.props import IntProperty, StringProperty

from .. import __package__ as base_package
from ..engine.errors import FrogError
from ..timeline import playback_cache
from ..torch_install import task
from ..torch_install.folders import installed
from ..torch_install.installer import SIZES


def _on_cache_limit(settings: Any, _context: Any) -> None:
    playback_cache.set_limit(settings.cache_megabytes)


class FROG_AP_preferences(bpy.types.AddonPreferences):
    """Shown in Edit > Preferences > Add-ons."""

    bl_idname = base_package

    torch_path: StringProperty(
        name="Python Environment with torch",
        description="A virtual environment, or a site-packages folder, of Blender's own Python version that has torch",
        subtype="DIR_PATH",
    )

    package_index: StringProperty(
        name="Package Index",
        description="Address of the index that Install torch asks, such as PyTorch's own for the CPU or a version of "
        'CUDA (see "Get Started" on its site); empty for pip\'s usual one',
    )

    cache_megabytes: IntProperty(
        name="Playback Cache (MB)",
        description="Memory for frames of captures that were or will be shown; the least recently shown go first",
        default=playback_cache.DEFAULT_MEGABYTES,
        min=0,
        soft_max=65_536,
        update=_on_cache_limit,
    )

    def draw(self, _context: Any) -> None:
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "cache_megabytes")
        layout.prop(self, "torch_path")
        layout.label(text=torch_needed() or "torch is found: training is possible.", icon="INFO")
        layout.label(text="Opening, scrubbing and rendering a finished .frog needs no torch.")
        if torch_needed():
            layout.prop(self, "package_index")
            draw_installation(layout)


def draw_installation(layout: Any) -> None:
    """The button that installs torch, and how its work stands."""
    current = task.current()
    if current is not None and current.running:
        layout.label(text=current.line[:100], icon="IMPORT")
        layout.operator("frog.cancel_installation", icon="CANCEL")
        return
    if current is not None and current.error:
        layout.label(text=current.error, icon="ERROR")
    layout.operator("frog.install_torch", icon="IMPORT")
    layout.label(text=f"Downloads {SIZES}.")


def _preferences() -> Any:
    """This add-on's, None where Blender has none of it: when it is registered by hand."""
    addon = bpy.context.preferences.addons.get(base_package)
    return addon.preferences if addon is not None else None


def package_index() -> str:
    """Address of the index that pip is to ask; an empty string for its usual one."""
    preferences = _preferences()
    return preferences.package_index.strip() if preferences is not None else ""


def use_installation(folder: Path) -> None:
    """Names a folder that an installation has filled in the preferences, and makes its packages importable."""
    preferences = _preferences()
    if preferences is not None:
        preferences.torch_path = str(folder)
    add_folder(folder)


def torch_path() -> str:
    """The folder named in the preferences, or the one that *Install torch* filled; else an empty string."""
    preferences = _preferences()
    named = preferences.torch_path if preferences is not None else ""
    place = task.folder()
    if named and Path(bpy.path.abspath(named)).parent != place.parent:
        return str(named)
    found = installed(place)  # preferences that were not saved name an older one, or none
    return str(found) if found is not None else str(named)


def torch_needed() -> str:
    """What training still needs, as a sentence, or an empty string when torch can be imported.  Imports nothing."""
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    if _is_importable():
        return ""
    folder = torch_path()
    if not folder:
        return (
            f"Training needs torch: install it in the add-on's preferences, or name an environment of Python {python} "
            "there that has it."
        )
    try:
        site_packages(Path(bpy.path.abspath(folder)))
    except FrogError as error:
        return str(error)
    return ""


def make_torch_importable() -> None:
    """Make the environment named in the preferences importable; FrogError if training still lacks torch."""
    add_environment()
    needed = torch_needed()
    if needed:
        raise FrogError(needed)


def add_environment() -> None:
    """Append the environment named in the preferences to ``sys.path``, if Blender has no torch and it is one."""
    if _is_importable() or not torch_path():
        return
    try:
        add_folder(site_packages(Path(bpy.path.abspath(torch_path()))))
    except FrogError:
        return  # the panel and ``torch_needed`` say why


def add_folder(folder: Path) -> None:
    """Makes the packages in a folder importable."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))  # appended, so that Blender's own packages win
        importlib.invalidate_caches()


def site_packages(folder: Path) -> Path:
    """The folder with torch in an environment of this Python version, or FrogError."""
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    choices = [folder, folder / "lib" / f"python{python}" / "site-packages", folder / "Lib" / "site-packages"]
    for choice in choices:
        if (choice / "torch" / "__init__.py").is_file():
            return choice
    others = sorted(path.parent.parent.name for path in folder.glob("lib/python*/site-packages/torch"))
    found = f"torch for {', '.join(others)}" if others else "no torch"
    raise FrogError(f"{folder}: found {found}, expected an environment of Python {python} with torch.")


def _is_importable() -> bool:
    try:
        return importlib.util.find_spec("torch") is not None
    except ValueError:  # what find_spec raises for a module that was blocked
        return False


_register_classes, unregister = bpy.utils.register_classes_factory((FROG_AP_preferences,))


def register() -> None:
    _register_classes()
    preferences = _preferences()
    if preferences is not None:
        playback_cache.set_limit(preferences.cache_megabytes)
