"""Runs in the background Blender, or with the bpy module: renders the images that a request lists, one by one.

    blender --background COPY.blend --python child.py -- REQUEST.json

A script that imports nothing of the add-on, whose package has another name in every installation. It opens a copy of
the user's file, so that nothing it sets is anybody's setting. It tells of each image in a line of JSON.
"""

import contextlib
import json
import os
import shutil
import sys
import threading
import traceback

import bpy
from mathutils import Matrix

PARTIAL = ".partial.png"


def told(**values):
    """One line for the parent, which ignores all others; Blender and its engines write there as well."""
    print(json.dumps({"frog": values}), flush=True)


def end_with_parent():
    """Ends this process when the parent's end of the pipe is closed."""
    while os.read(0, 4096):  # not sys.stdin, whose lock would outlive the interpreter
        pass
    os._exit(3)


def settings_for_captures(scene, width, height):
    """Sharp RGBA images in the scene's own colours. Its view transform stays out: it is applied to splats, too."""
    render, image = scene.render, scene.render.image_settings
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.film_transparent = True
    for off in ("use_border", "use_multiview", "use_motion_blur", "use_compositing", "use_sequencer", "use_stamp"):
        setattr(render, off, False)
    render.use_persistent_data = render.use_overwrite = render.use_file_extension = True
    render.use_placeholder = False
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_mode, image.color_depth, image.compression = "PNG", "RGBA", "8", 15
    if hasattr(image, "color_management"):
        image.color_management = "FOLLOW_SCENE"
    view = scene.view_settings
    for group, name, value in (
        (scene.display_settings, "display_device", "sRGB"),
        (view, "view_transform", "Standard"),
        (view, "look", "None"),
    ):
        with contextlib.suppress(TypeError):  # a studio's own color management may lack it
            setattr(group, name, value)
    view.exposure, view.gamma, view.use_curve_mapping = 0.0, 1.0, False
    for marker in scene.timeline_markers:
        marker.camera = None  # it would choose the camera


def add_camera(scene, lens, matrix):
    """A camera without depth of field."""
    data = bpy.data.cameras.new("FRoG capture")
    for name, value in lens.items():
        setattr(data, name, value)
    camera = bpy.data.objects.new(data.name, data)
    scene.collection.objects.link(camera)
    camera.matrix_world = Matrix(matrix)
    return camera


def render_all(request):
    """Renders each image to a partial file, which then takes its name: what is there is whole."""
    scene = bpy.data.scenes[request["scene"]]
    cameras = [add_camera(scene, camera["lens"], camera["matrix"]) for camera in request["cameras"]]
    settings_for_captures(scene, *request["size"])
    frame_shown = None
    for done, (camera, frame, path) in enumerate(request["images"]):
        if frame != frame_shown:
            scene.frame_set(frame)
            frame_shown = frame
        scene.camera = cameras[camera]
        partial = os.path.splitext(path)[0] + PARTIAL
        scene.render.filepath = partial.replace("{", "{{").replace("}", "}}")  # names in braces stand for others
        bpy.ops.render.render(write_still=True, scene=scene.name)
        if not os.path.isfile(partial):
            raise RuntimeError(f"{scene.render.engine} wrote no image")
        os.replace(partial, path)
        told(done=done + 1)


def main(arguments):
    """The exit status."""
    threading.Thread(target=end_with_parent, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(5)  # the user's own Blender comes first
    try:
        with open(arguments[-1], encoding="utf-8") as file:
            request = json.load(file)
        if getattr(bpy.app, "module", False):
            bpy.ops.wm.open_mainfile(filepath=request["blend"], load_ui=False, use_scripts=request["scripts"])
        render_all(request)
    except Exception as error:
        traceback.print_exc()
        told(error=f"{error}".strip())
        return 1
    return 0


if __name__ == "__main__":
    status = main(sys.argv)
    shutil.rmtree(bpy.app.tempdir, ignore_errors=True)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)  # Blender's own way out does not always end, and everything is written
