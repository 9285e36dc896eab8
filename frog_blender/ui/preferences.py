"""The add-on's preferences: the size of the playback cache and, where it trains, with what."""

# mypy: disable-error-code="valid-type"

import bpy
import rna_keymap_ui

from .. import __package__ as base_package
from .. import edition
from ..properties import whole
from ..timeline import playback_cache
from .selection_tools import KEYMAP, user_keys

if edition.TRAINS:
    from .torch_environment import TrainingPreferences
else:

    class TrainingPreferences:  # type: ignore[no-redef]
        """The player trains nothing."""


class FROG_AP_preferences(TrainingPreferences, bpy.types.AddonPreferences):
    """Shown in Edit > Preferences > Add-ons."""

    bl_idname = base_package

    cache_megabytes: whole(
        "Playback Cache (MB)",
        "Memory for frames of captures. The least recently shown frames are dropped first",
        playback_cache.DEFAULT_MEGABYTES,
        min=0,
        soft_max=65_536,
        update=lambda settings, _context: playback_cache.set_limit(settings.cache_megabytes),
    )

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        header, keys = layout.panel("frog_selection_keys", default_closed=True)
        header.label(text="Keys of the Selection Tools")
        configuration = context.window_manager.keyconfigs.user
        for item in user_keys(context) if keys is not None else ():
            keymap = configuration.keymaps[KEYMAP]
            rna_keymap_ui.draw_kmi(["ADDON", "USER", "DEFAULT"], configuration, keymap, item, keys, 0)
        layout.use_property_split = True
        layout.prop(self, "cache_megabytes")
        layout.label(text=playback_cache.summary(), icon="MEMORY")
        if edition.TRAINS:
            self.draw_environment(layout)


def register() -> None:
    addon = bpy.context.preferences.addons.get(base_package)  # None where a script registers it
    if addon is not None and addon.preferences is not None:
        playback_cache.set_limit(addon.preferences.cache_megabytes)
