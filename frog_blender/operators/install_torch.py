"""Install torch, or what calibration needs. Nothing is downloaded without a click and without Online Access."""

# mypy: disable-error-code="valid-type"

import textwrap

import bpy

from ..engine.errors import FrogError
from ..engine.training.session.time_estimate import has_nvidia_gpu
from ..properties import choice, text
from ..tasks import installation
from ..tasks.installation import Installation
from ..tasks.package_folders import CALIBRATION, installed, remove
from ..tasks.packages import (
    CPU,
    CUDA,
    NO_TORCH,
    PYCOLMAP,
    SIZES,
    has_pycolmap_wheel,
    index_needed,
    served_build,
    suitable_build,
)
from ..tasks.training import TrainingTask
from ..ui import torch_environment
from .bases import ConfirmedOperator, TaskOperator

BUILDS = {CPU: "CPU only", CUDA: "NVIDIA GPU (CUDA)"}
"""Builds of torch, in words."""


class _Downloads(ConfirmedOperator):
    """Base of operators that download, where the user allows it."""

    @classmethod
    def problem(cls, _context: bpy.types.Context) -> str:
        if not bpy.app.online_access:
            return "Enable Online Access in Preferences > System first."
        return "An installation is already running." if Installation.is_any_running() else ""


class FROG_OT_install_torch(_Downloads, bpy.types.Operator):
    """Download torch, OpenCV and pycolmap into a separate folder. Blender itself is not changed"""

    bl_label = "Install torch"

    build: choice(
        "Build",
        "Which torch is downloaded",
        (
            (CPU, "CPU Only", f"Trains on the processor: {SIZES[CPU]}"),
            (CUDA, "NVIDIA GPU (CUDA)", f"Trains on an NVIDIA graphics card as well: {SIZES[CUDA]}"),
        ),
        served_build(),
        options={"SKIP_SAVE"},
    )
    index: text(
        "Package Index", "Address of PyTorch's own index. Empty for that in the preferences", options={"SKIP_SAVE"}
    )

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if not self.properties.is_property_set("build"):
            self.build = suitable_build()
        self.index = self.index or torch_environment.package_index()
        asks = context.window_manager.invoke_props_dialog
        return asks(self, width=420, title="Install torch", confirm_text="Download")

    def draw(self, _context: bpy.types.Context) -> None:
        layout = self.layout
        layout.label(text=f"{'An' if has_nvidia_gpu() else 'No'} NVIDIA graphics card was found on this computer.")
        for build in (CPU, CUDA):
            layout.prop_enum(self, "build", build, text=f"{BUILDS[build]}: {SIZES[build]}")
        needed = index_needed(self.build)
        if needed:
            for line in textwrap.wrap(needed, 65):
                layout.label(text=line)
            layout.prop(self, "index")
        layout.label(text=f"OpenCV and pycolmap {PYCOLMAP} come with it.")

    def act(self, _context: bpy.types.Context) -> None:
        index = self.index.strip() or torch_environment.package_index()
        if index_needed(self.build) and not index:
            raise FrogError(f"{index_needed(self.build)} Nothing was downloaded.")
        # Besides pip's own, which alone has the other packages.
        arguments = ["--extra-index-url", index] if index else []
        is_chosen = self.properties.is_property_set("build")  # else it depends on the index
        build, done = self.build if is_chosen else CPU, torch_environment.use_installation
        Installation(installation.folder(), build, arguments, done).begin()


class FROG_OT_remove_torch(ConfirmedOperator, bpy.types.Operator):
    """Remove what Install torch downloaded. Training needs it again; playing and rendering do not"""

    bl_label = "Remove torch"

    @classmethod
    def problem(cls, _context: bpy.types.Context) -> str:
        if installed(installation.folder()) is None:
            return "Install torch has installed nothing here."
        is_busy = Installation.is_any_running() or TrainingTask.is_any_running()
        return "Wait until the training or the installation has ended." if is_busy else ""

    def act(self, _context: bpy.types.Context) -> str:
        is_gone = remove(installation.folder())
        torch_environment.forget_installation()
        return "" if is_gone else "torch is in use. It is removed when Blender starts the next time."


class FROG_OT_install_calibration(_Downloads, bpy.types.Operator):
    """Download pycolmap and OpenCV, which calibration needs, into a separate folder. Blender itself is not changed"""

    bl_label = "Install pycolmap"
    question = f"This downloads pycolmap {PYCOLMAP} and OpenCV, {SIZES[NO_TORCH]}."

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return super().problem(context) if has_pycolmap_wheel() else "There is no pycolmap for this kind of computer."

    def act(self, _context: bpy.types.Context) -> None:
        folder, done = installation.folder(CALIBRATION), torch_environment.add_folder
        Installation(folder, NO_TORCH, (), done).begin()  # from pip's own index: PyTorch's has no pycolmap


class FROG_OT_cancel_installation(TaskOperator, bpy.types.Operator):
    """Stop the download and discard what was downloaded so far"""

    kind = Installation
