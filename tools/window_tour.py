"""A walk through the add-on in a real Blender window, from a capture to an image with other objects, with a screenshot
of each step: it shows that all of it works there, and makes the guide's images.

    BLENDER_USER_RESOURCES=OUT/user blender --factory-startup --window-geometry 0 0 1280 720 \\
        --python tools/window_tour.py -- OUT [--capture FOLDER] [--steps N] [--requests FOLDER]
        --python tools/window_tour.py -- OUT --videos FOLDER [--environment FOLDER] [--requests FOLDER]

The add-on is put as an extension into BLENDER_USER_RESOURCES, which must name a folder of its own: nothing of the
user's Blender is touched. Blender's Python needs torch and OpenCV to train. OUT gets 01_capture.png and so on.

With ``--videos`` the walk is another one, unbroken: raw videos are dropped into Blender's default scene, calibrated,
synchronized, trained, imported and scrubbed, with the settings that are there and nothing typed. FOLDER is copied into
OUT. ``--environment`` is a folder with pycolmap, where Blender's Python lacks it.

``--requests FOLDER`` is for screens that Blender cannot photograph itself (virtual ones): each screenshot is then asked
for by a file FOLDER/shot-NAME.request, and taken when whoever makes it deletes that file.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import sys
import time
import traceback
from collections.abc import Generator, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import addon_utils
import bpy
from mathutils import Euler

ROOT = Path(__file__).resolve().parents[1]
ADDON = "bl_ext.user_default.frog_blender"
PATIENCE = 1800.0  # seconds for any one thing that is waited for
SETTLE = 1.5  # seconds until a window has drawn what was changed


class Tour:
    """The steps, as a generator that yields seconds to wait, between which Blender's window lives."""

    def __init__(self, out: Path, capture: Path, steps: int, requests: Path | None) -> None:
        self.out, self.capture, self.step_count, self.requests = out, capture, steps, requests
        self.scene_file = out / f"{capture.name}.frog"

    def run_from_videos(self, videos: Path, environment: str) -> Iterator[float]:
        """From films as cameras leave them to a scene that one looks around in."""
        footage = self.out / videos.name
        shutil.rmtree(footage, ignore_errors=True)
        footage.mkdir()
        films = [Path(shutil.copy(film, footage)) for film in sorted(videos.glob("*.mp4"))]
        install()
        if environment:
            sys.path.append(environment)
        yield SETTLE
        yield from self.drop(footage, films)
        yield from self.calibrate()
        yield from self.train_as_found()
        yield from self.scrub({"26_scrubbed": 0.3, "27_scrubbed": 0.8})

    def drop(self, folder: Path, films: list[Path]) -> Iterator[float]:
        """What Blender calls when files are dropped into the viewport and there is one importer for them."""
        with override(view()):
            files = [{"name": film.name} for film in films]
            if bpy.ops.frog.drop_videos("INVOKE_DEFAULT", directory=f"{folder}/", files=files) == {"CANCELLED"}:
                raise SystemExit("The drop was refused.")
        yield from wait(lambda: bool(bpy.context.scene.frog.capture_folder))  # read beside the window
        yield 2 * SETTLE
        yield from self.shot("21_dropped")

    def calibrate(self) -> Iterator[float]:
        kind = import_module(f"{ADDON}.tasks.calibration").CalibrationTask
        with override(view()):
            expect(bpy.ops.frog.calibrate("INVOKE_DEFAULT"), "Calibrate Cameras")
        task = kind.current()
        yield from wait(lambda: not task.is_running or task.standing.fraction > 0.3)
        yield from self.shot("22_calibrating")
        yield from wait(lambda: not task.is_running)
        if task.error or task.result is None:
            raise SystemExit(f"Calibration ended with: {task.error or 'no cameras'}")
        yield SETTLE
        yield from self.shot("23_calibrated")

    def train_as_found(self) -> Iterator[float]:
        """With the panel's settings, of which the recipe alone is chosen."""
        kind = import_module(f"{ADDON}.tasks.training").TrainingTask
        bpy.context.scene.frog.recipe = "draft"
        with override(view()):
            expect(bpy.ops.frog.train("INVOKE_DEFAULT"), "Train FRoG")
        task = kind.current()
        yield from wait(
            lambda: not task.is_running or (task.state.preview is not None and task.standing.fraction > 0.5)
        )
        yield from self.shot("24_training")
        result = yield from trained(task)
        yield 3 * SETTLE
        yield from self.shot("25_imported")
        show(result)
        yield 3 * SETTLE
        yield from self.shot("25_shown")

    def scrub(self, shares: dict[str, float]) -> Iterator[float]:
        """At shares of the timeline."""
        scene = bpy.context.scene
        for name, share in shares.items():
            scene.frame_set(scene.frame_start + round(share * (scene.frame_end - scene.frame_start)))
            yield 3 * SETTLE  # the sharp image comes when nothing moves
            yield from self.shot(name)

    def run(self) -> Iterator[float]:
        install()
        clear()
        yield SETTLE
        overlay = view().spaces.active.overlay
        overlay.show_relationship_lines = overlay.show_cursor = False
        while close_one():  # more room for the viewport and its sidebar
            yield 0.2
        yield SETTLE
        yield from self.preferences()
        yield from self.inspect()
        yield from self.train()
        yield from self.look_around()
        yield from self.clips()
        yield from self.among_objects()

    def preferences(self) -> Iterator[float]:
        """As on a machine without torch, where its button is."""
        torch = sys.modules.get("torch")
        sys.modules["torch"] = None  # type: ignore[assignment]  # what Python takes for "cannot be imported"
        bpy.context.preferences.system.use_online_access = True  # the button's condition; nothing presses it
        area = view()
        area.ui_type = "PREFERENCES"
        bpy.context.preferences.active_section = "ADDONS"
        bpy.context.window_manager.addon_search = "FRoG"
        with override(area):
            if not addon_utils.modules_refresh() and not expanded():
                bpy.ops.preferences.addon_expand(module=ADDON)
        yield SETTLE
        yield from self.shot("10_preferences")
        area.ui_type = "VIEW_3D"
        bpy.context.preferences.system.use_online_access = False
        del sys.modules["torch"]
        if torch is not None:
            sys.modules["torch"] = torch
        yield SETTLE

    def inspect(self) -> Iterator[float]:
        settings = bpy.context.scene.frog
        sidebar()
        settings.capture_folder = str(self.capture)
        settings.output_path = str(self.scene_file)
        settings.recipe, settings.steps = "draft", self.step_count
        reading = import_module(f"{ADDON}.ui.capture_reading")
        yield from wait(lambda: not reading.is_reading(settings.capture_folder))
        yield SETTLE
        sidebar()
        yield SETTLE
        yield from self.shot("01_capture")

    def train(self) -> Iterator[float]:
        kind = import_module(f"{ADDON}.tasks.training").TrainingTask
        with override(view()):
            expect(bpy.ops.frog.train(), "Train FRoG")
        task = kind.current()
        yield from wait(lambda: not task.is_running or task.state.step > 0.6 * self.step_count)
        yield from wait(lambda: not task.is_running or task.state.preview is not None)
        yield SETTLE
        yield from self.shot("02_training")
        result = yield from trained(task)
        yield SETTLE
        scroll(280)  # the settings out of sight, the report in their place
        yield SETTLE
        yield from self.shot("03_trained")
        show(result)
        yield SETTLE

    def look_around(self) -> Iterator[float]:
        """The imported scene from beside its cameras, in the rendered viewport, at two frames."""
        with override(view()):
            expect(bpy.ops.frog.align_to_floor(), "Align to Floor")
        orbit()
        space = view().spaces.active
        space.shading.type, space.overlay.show_extras = "RENDERED", False  # cameras stand before the scene
        scroll(9999)
        yield from self.scrub({"04_rendered_viewport": 0.1, "05_scrubbed": 0.7})

    def clips(self) -> Iterator[float]:
        """Through a camera, with its video before half of what it sees."""
        scene, obj = bpy.context.scene, gaussians()
        scene.camera = import_module(f"{ADDON}.scene_import.capture_objects").cameras_of(obj)[0]
        with override(view()):
            expect(bpy.ops.frog.add_clips(), "Show Clips")
        space = view().spaces.active
        space.shading.type, space.overlay.show_extras = "SOLID", True
        space.region_3d.view_perspective = "CAMERA"
        obj.hide_set(True)
        with override(view()):
            bpy.ops.view3d.view_center_camera()
        yield 2 * SETTLE
        yield from self.shot("06_clip")
        obj.hide_set(False)

    def among_objects(self) -> Iterator[float]:
        """A monkey half inside the splats, drawn by the graphics card; one image of both."""
        bpy.context.scene.frog.viewport_drawing = "CARD"
        orbit()
        view().spaces.active.overlay.show_extras = False
        shading = view().spaces.active.shading
        shading.type, shading.color_type = "SOLID", "MATERIAL"
        with override(view()):
            bpy.ops.mesh.primitive_monkey_add(size=1.0, location=(0.2, 0.15, 0.75))
            monkey = bpy.context.object
            bpy.ops.object.shade_smooth()
            bpy.ops.object.light_add(type="AREA", location=(-2.0, -3.0, 4.0), rotation=(math.radians(40), 0, -0.5))
            bpy.context.object.data.energy, bpy.context.object.data.size = 400.0, 3.0
            monkey.data.materials.append(golden())
            bpy.ops.object.select_all(action="DESELECT")
            bpy.context.scene.render.resolution_percentage = 200
            expect(bpy.ops.frog.compose(engine="CYCLES"), "Render With My Objects")
        scene = bpy.context.scene
        scene.cycles.samples, scene.cycles.device = 32, "CPU"
        yield 6 * SETTLE
        yield from self.shot("08_mesh_among_splats")
        bpy.context.preferences.view.render_display_type = "SCREEN"
        done: list[bool] = []
        bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
        bpy.app.handlers.render_cancel.append(lambda *_: done.append(False))
        with override(view()):
            bpy.ops.render.render("INVOKE_DEFAULT")
        yield from wait(lambda: bool(done))
        if not done[0]:
            raise SystemExit("The render was cancelled.")
        yield 2 * SETTLE
        yield from self.shot("09_render")

    def shot(self, name: str) -> Iterator[float]:
        """An image of the window as it is."""
        for area in bpy.context.window_manager.windows[0].screen.areas:
            area.tag_redraw()
        yield SETTLE
        if self.requests is not None:
            request = self.requests / f"shot-{name}.request"
            request.write_text("")
            yield from wait(lambda: not request.exists())
        else:
            with override(bpy.context.window_manager.windows[0].screen.areas[0]):
                bpy.ops.screen.screenshot(filepath=str(self.out / f"{name}.png"))
        print(f"tour: {name}", flush=True)


def install() -> None:
    """Make this checkout an extension of the throw-away Blender, and switch it on."""
    resources = os.environ.get("BLENDER_USER_RESOURCES")
    if not resources:
        raise SystemExit("Set BLENDER_USER_RESOURCES to a folder of its own: the tour installs the add-on there.")
    folder = Path(resources) / "extensions" / "user_default" / "frog_blender"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ROOT / "frog_blender", folder, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "blender_manifest.toml", folder)
    if addon_utils.enable(ADDON, default_set=True) is None:
        raise SystemExit("The add-on could not be enabled.")


def clear() -> None:
    """An empty scene."""
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)


def close_one() -> bool:
    """Close an area beside the viewport; True if there was one."""
    for area in bpy.context.window_manager.windows[0].screen.areas:
        if area.type in ("OUTLINER", "PROPERTIES"):
            with override(area):
                bpy.ops.screen.area_close()
            return True
    return False


def view() -> Any:
    """The largest area: the 3D viewport, unless the tour made it something else."""
    return max(bpy.context.window_manager.windows[0].screen.areas, key=lambda area: area.width * area.height)


def override(area: Any) -> Any:
    """A context in which operators run as if called from an area."""
    window = bpy.context.window_manager.windows[0]
    region = next(region for region in area.regions if region.type == "WINDOW")
    return bpy.context.temp_override(window=window, screen=window.screen, area=area, region=region)


def orbit() -> None:
    """Look at the aligned capture from in front, from the left and above."""
    region = view().spaces.active.region_3d
    region.view_perspective = "PERSP"
    region.view_rotation = Euler((math.radians(74), 0.0, math.radians(-14))).to_quaternion()
    region.view_location, region.view_distance = (0.2, 0.2, 0.85), 5.6


def sidebar() -> None:
    """Show the sidebar, with our tab in front once it was drawn."""
    area = view()
    area.spaces.active.show_region_ui = True
    for region in area.regions:
        if region.type == "UI" and region.active_panel_category != "UNSUPPORTED":
            region.active_panel_category = "FRoG"


def show(result: Path) -> None:
    """What the panel offers after a training: *Show*, and *Set Up Scene* with all of it."""
    with override(view()):
        expect(bpy.ops.frog.show_result(filepath=str(result)), "Show")
        expect(bpy.ops.frog.set_up_scene(), "Set Up Scene")


def scroll(lines: int) -> None:
    """Scroll the sidebar down, or up below zero."""
    area = view()
    region = next(region for region in area.regions if region.type == "UI")
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area, region=region):
        bpy.ops.view2d.pan(deltax=0, deltay=-lines)


def expanded() -> bool:
    """True if the add-on's preferences are unfolded already."""
    return any(
        module.__name__ == ADDON and info["show_expanded"]
        for module in addon_utils.modules()
        for info in [addon_utils.module_bl_info(module)]
    )


def gaussians() -> Any:
    """The imported capture's Gaussians."""
    playback = import_module(f"{ADDON}.timeline.playback")
    return next(playback.captures(bpy.context.scene.objects))


def golden() -> Any:
    material = bpy.data.materials.new("Gold")
    material.use_nodes, material.diffuse_color = True, (0.9, 0.55, 0.12, 1.0)
    shader = material.node_tree.nodes["Principled BSDF"].inputs
    shader["Base Color"].default_value, shader["Metallic"].default_value = (0.9, 0.55, 0.12, 1.0), 0.9
    shader["Roughness"].default_value = 0.35
    return material


def expect(result: set[str], what: str) -> None:
    if result != {"FINISHED"}:
        raise SystemExit(f"{what} ended with {result}.")


def wait(condition: Any) -> Iterator[float]:
    """Yields until something is so; ends the tour after PATIENCE."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > deadline:
            raise SystemExit("The tour waited in vain.")
        yield 0.1


def trained(task: Any) -> Generator[float, None, Path]:
    """Yields until a training has ended; its scene."""
    yield from wait(lambda: not task.is_running)
    if task.error or task.state.result is None:
        raise SystemExit(f"Training ended with: {task.error or 'no scene'}")
    return Path(task.state.result)


def drive(steps: Iterator[float]) -> float | None:
    """The timer: one step, then Blender draws and answers; whatever goes wrong ends Blender with a status."""
    try:
        return next(steps)
    except StopIteration:
        print("tour: done", flush=True)
        bpy.ops.wm.quit_blender()
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    return None


def main() -> None:
    parser = argparse.ArgumentParser(prog="window_tour.py", description="The add-on in a window, step by step.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--capture", type=Path, default=ROOT / "examples" / "captures" / "room")
    parser.add_argument("--steps", type=int, default=3000, help="of the training")
    parser.add_argument("--requests", type=Path, help="where screenshots are asked for, see above")
    parser.add_argument("--videos", type=Path, help="raw ones, for the walk from them")
    parser.add_argument("--environment", default="", help="a folder with packages that Blender's Python lacks")
    options = parser.parse_args(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else [])
    if bpy.app.background:
        raise SystemExit("The tour is one of a window: start Blender without -b.")
    options.out.mkdir(parents=True, exist_ok=True)
    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.view.ui_scale = 0.9  # panels and viewport both fit into the guide's images
    tour = Tour(options.out.resolve(), options.capture.resolve(), options.steps, options.requests)
    steps = tour.run_from_videos(options.videos.resolve(), options.environment) if options.videos else tour.run()
    bpy.app.timers.register(lambda: drive(steps), first_interval=SETTLE)


main()
