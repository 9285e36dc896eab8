"""Calibrate Cameras: raw videos become a capture, in the background; by the points that were clicked in each camera's
image, if nothing else helps.
"""

# mypy: disable-error-code="valid-type"

import os
from pathlib import Path

import bpy
import numpy as np

from ..engine.capture.calibration.pipeline import Outcome
from ..engine.capture.readers.footage import is_recording
from ..engine.capture.synchronization.films import Film, find_films
from ..engine.capture.video import decode
from ..engine.errors import FrogError
from ..engine.whole_progress import Standing
from ..properties import switch
from ..tasks.calibration import CalibrationTask
from ..ui import capture_summary, points_overlay, report_images, torch_environment
from ..ui.clicked_points import ENDING, FILE, ClickedPoints, points_of
from .bases import FrogOperator, TaskOperator


class FROG_OT_calibrate(FrogOperator, bpy.types.Operator):
    """Find where the cameras stood and when each began to film, in the background. No file that is there is changed"""

    bl_label = "Calibrate Cameras"

    are_standing: switch("All Stand", "All cameras stand, whatever moves before them", options={"SKIP_SAVE"})

    @classmethod
    def problem(cls, _context: bpy.types.Context) -> str:
        return "A calibration is already running." if CalibrationTask.is_any_running() else ""

    def act(self, context: bpy.types.Context) -> None:
        begin_calibration(context.scene, layout="standing" if self.are_standing else context.scene.frog.layout)


class FROG_OT_cancel_calibration(TaskOperator, bpy.types.Operator):
    """Stop the calibration. Stages that are done are kept, so that the next one continues there"""

    kind = CalibrationTask


def begin_calibration(scene: bpy.types.Scene, points: str = "", layout: str = "auto") -> None:
    """Starts the calibration of a scene's capture; by a file of points in its folder if one is named."""
    folder = footage_folder(scene.frog.capture_folder)
    needed = torch_environment.calibration_needed()
    if needed:
        raise FrogError(needed)
    task = CaptureCalibration(folder, folder / points if points else None, layout)
    task.on_finished = task.open
    task.begin()


def footage_folder(stored: str) -> Path:
    """The folder of the panel's setting; FrogError if there is none."""
    if not stored:
        raise FrogError("No capture is selected. Choose the folder with the videos to calibrate.")
    folder = Path(bpy.path.abspath(stored))
    if not os.path.isdir(folder) and not is_recording(folder):  # false, not an error, without permission
        raise FrogError(f"{folder}: found no such folder, expected one with a video of each camera.")
    return folder


class CaptureCalibration(CalibrationTask):
    """A calibration, and then the capture that it made of a folder of footage.

    The capture is read on the worker thread, because small videos are decoded for that.
    """

    summary = capture_summary.CaptureSummary()
    stamp: object = None
    """Of the folder, from before it was read."""

    def work(self) -> Outcome:
        outcome = super().work()
        self.tell_whole(Standing("Opening the capture", 1.0, 0.0))
        self.stamp, self.summary = capture_summary.stamp(str(self.folder)), capture_summary.read(self.folder)
        return outcome

    def open(self, _outcome: Outcome) -> None:
        """Shows the capture in every scene that names it, and draws its synchronization."""
        for scene in bpy.data.scenes:
            stored = scene.frog.capture_folder
            named = bpy.path.abspath(stored) if stored else ""
            if named and Path(os.path.normpath(named)) == Path(os.path.normpath(self.folder)):
                capture_summary.store(named, self.summary, self.stamp)
                report_images.show(self.folder, self.summary.capture is not None)


class FROG_OT_click_points(FrogOperator, bpy.types.Operator):
    """Click the same 16 points in each camera's image: corners near and far, not all on one plane. Each click is \
saved beside the videos"""

    bl_label = "Click Points"

    _films: tuple[Film, ...] = ()
    _points: ClickedPoints | None = None
    _path = Path()
    _area = 0  # a pointer: areas may end
    _former = ""  # what the area was
    _shown = -1  # place of the camera whose image is shown
    _is_fitted = False

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return "" if context.scene.frog.capture_folder else "No capture is selected."

    def act(self, _context: bpy.types.Context) -> str:
        raise FrogError("Points are clicked in a window, found none.")

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if context.area is None or bpy.app.background:
            return self.execute(context)
        torch_environment.add_environment()  # may have OpenCV, which reads videos
        try:
            folder = footage_folder(context.scene.frog.capture_folder)
            self._path = folder / FILE
            self._films = tuple(find_films(folder))
            self._points = points_of(self._path, self._films)
            image = image_of(self._films[self._points.camera])
        except FrogError as error:
            return self.failed(error)
        self._area, self._former = context.area.as_pointer(), context.area.ui_type
        context.area.ui_type = "IMAGE_EDITOR"
        points_overlay.begin(self._points)
        self._show(context.area, image)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        area, points = self._found_area(context), self._points
        if points is None or area is None or area.type != "IMAGE_EDITOR":
            return self._end(None)
        region = next(region for region in area.regions if region.type == "WINDOW")
        if not self._is_fitted and points_overlay.is_drawn():
            self._is_fitted = True
            with context.temp_override(area=area, region=region):
                bpy.ops.image.view_all(fit_view=True)
        if not _is_over(region, event) or event.value != "PRESS":
            return {"PASS_THROUGH"}
        if event.type in ENDING:
            return self._end(area)
        if not self._take(points, region, event):
            return {"PASS_THROUGH"}
        try:
            points.save(self._path)
            if points.camera != self._shown:
                self._show(area, image_of(self._films[points.camera]))
        except (FrogError, OSError) as error:
            self.report({"ERROR"}, str(error))
            return self._end(area)
        area.tag_redraw()
        return {"RUNNING_MODAL"}

    def _take(self, points: ClickedPoints, region: bpy.types.Region, event: bpy.types.Event) -> bool:
        """Applies a click or a key; false if it is not for us."""
        if event.type != "LEFTMOUSE":
            return points.press(event.type, event.ctrl)
        width, height = self._films[points.camera].size
        x, y = region.view2d.region_to_view(event.mouse_x - region.x, event.mouse_y - region.y)
        if 0 <= x <= 1 and 0 <= y <= 1:
            points.click((round(x * width, 2), round((1 - y) * height, 2)))
        return True

    def cancel(self, _context: bpy.types.Context) -> None:
        """Called by Blender when the window or the file is closed."""
        points_overlay.end()

    def _found_area(self, context: bpy.types.Context) -> bpy.types.Area | None:
        areas = context.screen.areas if context.screen is not None else ()
        return next((area for area in areas if area.as_pointer() == self._area), None)

    def _show(self, area: bpy.types.Area, image: bpy.types.Image) -> None:
        assert self._points is not None
        self._shown, self._is_fitted = self._points.camera, False
        area.spaces.active.image = image
        points_overlay.show(image)

    def _end(self, area: bpy.types.Area | None) -> set[str]:
        points_overlay.end()
        _remove_image()
        if area is not None:
            area.ui_type = self._former
        return {"FINISHED"}


class FROG_OT_calibrate_from_points(FrogOperator, bpy.types.Operator):
    """Find where the cameras stood by the clicked points alone, in the background. No file that is there is changed"""

    bl_label = "Calibrate from Points"

    def act(self, context: bpy.types.Context) -> None:
        begin_calibration(context.scene, FILE)


def image_of(film: Film) -> bpy.types.Image:
    """A film's first image as Blender's, in place of the one that was shown before; FrogError if there is none."""
    pixels = next(iter(decode(film.path, [0])))
    height, width = pixels.shape[:2]
    _remove_image()
    image = bpy.data.images.new(points_overlay.IMAGE, width, height)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[:, :, :3] = pixels[::-1].astype(np.float32) / 255  # Blender's rows go up
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    return image


def _remove_image() -> None:
    image = bpy.data.images.get(points_overlay.IMAGE)
    if image is not None:
        bpy.data.images.remove(image)


def _is_over(region: bpy.types.Region, event: bpy.types.Event) -> bool:
    inside_x = 0 <= event.mouse_x - region.x < region.width
    return inside_x and 0 <= event.mouse_y - region.y < region.height
