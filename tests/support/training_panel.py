"""What panels write, and background tasks in any state for them to show."""

import json
import threading
from contextlib import contextmanager
from types import SimpleNamespace

import bpy
import numpy as np
from safetensors.numpy import save_file

import frog_blender
from frog_blender.engine.training.session import events
from frog_blender.tasks.training import TrainingTask


class Written:
    """Stands in for a layout, which only a window has: keeps what is written into it."""

    def __init__(self, said=None):
        self.said = [] if said is None else said

    def label(self, text="", **_):
        self.said.append(text)

    def operator(self, name, *_, **__):
        self.said.append(name)
        return SimpleNamespace()

    def prop(self, data, name, **_):
        data.bl_rna.properties[name]  # as Blender: a name that is none is an error
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

    progress = label
    menu = operator_menu_enum = template_list = operator
    row = column = grid_flow = split = box


def panel_says(panel, part="draw", **values):
    """What a panel writes into its layout, label lines joined; None where it is not shown.

    Args:
        part: the function that draws.
        values: of the context, in place of the real ones.
    """
    layout = Written()
    context = drawing_context(**values)
    if hasattr(panel, "poll") and not panel.poll(context):
        return None
    getattr(panel, part)(SimpleNamespace(layout=layout), context)
    return " ".join(layout.said)


def drawing_context(**values):
    """What a panel is drawn with."""
    usual = {"scene": bpy.context.scene, "object": bpy.context.object, "space_data": None}
    return SimpleNamespace(**(usual | values))


def finish(task):
    """Pumps a background task until it ends, as a headless run does."""
    assert task.join(300.0)
    task.pump_all()
    assert not task.is_running
    return task


def endless(cancelled):
    """What a training says that goes on until it is told to end, and then leaves a scene."""
    while not cancelled():
        yield events.Stage("decoding", 0, 1)
        threading.Event().wait(0.005)
    yield events.Cancelled(3, "half.frog")


@contextmanager
def switched_off():
    """Inside, the add-on is disabled, and gives up all that it has remembered."""
    frog_blender.unregister()
    try:
        yield
    finally:
        frog_blender.register()


def leave_checkpoint(path, capture, progress=0.5, steps=7):
    """What a training of a capture leaves beside its scene, as far as the panel looks at it."""
    state = {"settings": {"capture": str(capture.resolve())}, "progress": progress, "step_count": steps}
    # Of another size after other steps: two may be written in one tick of the clock.
    save_file({"x": np.zeros(steps)}, f"{path}.checkpoint", metadata={"frog-checkpoint": json.dumps(state)})


def told(*said):
    """A training that has said this and is still running."""
    task = TrainingTask(lambda control: iter(said))
    for event in said:
        task.apply(event)
    task.show()
    return task
