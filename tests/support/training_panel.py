"""A layout that keeps what a panel writes, and trainings in any state for the panel to show."""

from __future__ import annotations

from types import SimpleNamespace

from frog_blender.tasks.training import TrainingTask


class Written:
    """Stands in for a layout, which only a window has: keeps what is written into it."""

    def __init__(self, said=None):
        self.said = [] if said is None else said

    def label(self, text="", icon="NONE"):
        self.said.append(text)

    def progress(self, factor, text):
        self.said.append(text)

    def operator(self, name, text=None, icon="NONE", emboss=True):
        self.said.append(name)
        return SimpleNamespace()

    def operator_menu_enum(self, name, _enum, **_):
        self.said.append(name)

    def prop(self, data, name, **_):
        data.bl_rna.properties[name]  # as Blender: a name that is none is an error
        self.said.append(name)

    def template_list(self, kind, *_, **__):
        self.said.append(kind)

    def menu(self, name, **_):
        self.said.append(name)

    def separator(self):
        """Nothing is said."""

    def prop_enum(self, data, name, value, **_):
        assert value in data.bl_rna.properties[name].enum_items
        self.said.append(f"{name}={value}")

    def template_icon(self, icon_value, scale):
        self.said.append("image")

    def box(self, **_):
        return Written(self.said)

    row = column = grid_flow = split = box


def told(*said):
    """A training that has said this and is still running."""
    task = TrainingTask(lambda control: iter(said))
    for event in said:
        task.apply(event)
    task.show()
    return task
