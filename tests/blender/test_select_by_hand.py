"""A brush, a lasso and a box in a viewport select what Blender finds there of the capture, once for all times."""

import json
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Quaternion, Vector
from support.blender_windows import in_place_of, viewport
from support.small_scenes import cropped, rig_of_three, write_scene
from support.undo_steps import check_undo_and_redo

from frog_blender import addon_state, point_cloud
from frog_blender.engine.editing.gestures import drawn
from frog_blender.operators import select_by_hand
from frog_blender.scene_import.capture_objects import active_capture
from frog_blender.timeline import edits, playback
from frog_blender.ui import crop_frames, selection_tools
from frog_blender.ui.gesture_overlay import GestureOverlay
from frog_blender.ui.overlay import distance_to

COUNT = 300
EVERYTHING = [(-5000.0, -5000.0), (9000.0, 9000.0)]
LASSO = [(300.0, 200.0), (1200.0, 300.0), (900.0, 800.0), (700.0, 350.0), (400.0, 700.0)]


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path / "scene.frog", rig_of_three(), count=COUNT)


@pytest.fixture
def capture(empty, capture):
    root = capture.parent
    root.rotation_mode = "QUATERNION"
    root.rotation_quaternion, root.scale, root.location = Quaternion((0.8, 0.3, -0.4, 0.2)), (5.0,) * 3, (0.5, 1.0, 0.2)
    empty.frame_set(4)
    return capture


def is_drawing():
    return bool(addon_state.get(GestureOverlay).handlers)


def stroke(path, **settings):
    """Draws along places in pixels from the lower left corner; what is selected then."""
    with bpy.context.temp_override(**viewport()):
        places = [{"name": "", "loc": place, "time": 0.0} for place in path]
        assert bpy.ops.frog.select_by_hand(path=places, **settings) == {"FINISHED"}
    return selected()


def selected():
    marks = edits.marks_of(active_capture(bpy.context).frog_edits.selection)
    return np.zeros(COUNT, bool) if marks is None else marks.chosen()


def places_of(obj, frame):
    """(N, 2) where Blender says that the centres of what an object shows are in the viewport; NaN for what is too faint
    to be drawn."""
    where, gaussians = viewport(), playback.scene_time(obj, frame).gaussians()
    region, view = where["region"], where["space_data"].region_3d
    pixels = [location_3d_to_region_2d(region, view, obj.matrix_world @ Vector(mean)) for mean in gaussians.means]
    places = np.array([(np.nan, np.nan) if pixel is None else tuple(pixel) for pixel in pixels])
    places[gaussians.opacities <= 1 / 255] = np.nan
    return places


def assert_selected(obj, chosen, inside):
    """That those are selected of what an object shows."""
    rows = playback.scene_time(obj, 4).scene.rows
    shown = chosen if rows is None else chosen[rows]
    np.testing.assert_array_equal(shown, inside)
    assert chosen.sum() == shown.sum(), "what is not shown is not selected"


def test_each_shape_selects_what_blender_finds_there(capture):
    places = places_of(capture, 4)
    chosen = stroke([(1000.0, 300.0), (5.0, 5.0), (400.0, 700.0)], shape="BOX")  # from its first to its last corner
    assert_selected(capture, chosen, ((places >= (400, 300)) & (places <= (1000, 700))).all(1))
    assert 10 < chosen.sum() < COUNT - 10
    chosen = stroke([(700.0, 450.0)], shape="BRUSH", radius=150)
    assert_selected(capture, chosen, np.linalg.norm(places - (700.0, 450.0), axis=1) < 150)
    assert chosen.any()
    screen = SimpleNamespace(rows=np.arange(len(places)), places=np.nan_to_num(places, nan=1e9).T.astype(np.float32))
    chosen = stroke(LASSO, shape="LASSO")
    np.testing.assert_array_equal(chosen, drawn("LASSO", screen, LASSO, 0).hit)
    assert 10 < chosen.sum() < COUNT - 10


def test_what_is_edited_away_or_hidden_is_not_selected(capture):
    bpy.ops.frog.select_gaussians(by="SIZE", size=0.42)
    bpy.ops.frog.hide_gaussians()
    cropped(capture, "SPHERE", 0.6)
    opacities = playback.scene_time(capture, 4).gaussians().opacities
    assert (opacities == 0).any() and len(opacities) < COUNT
    assert_selected(capture, stroke(EVERYTHING, shape="BOX"), opacities > 1 / 255)
    capture.frog_edits.use = False
    assert stroke(EVERYTHING, shape="BOX").sum() > np.count_nonzero(opacities)


def test_a_lower_density_selects_what_it_does_not_show_as_well(capture):
    before = stroke(EVERYTHING, shape="BOX")
    capture.frog.density = 30
    assert point_cloud.count(capture) < COUNT / 2
    np.testing.assert_array_equal(stroke(EVERYTHING, shape="BOX"), before)


def test_modes_and_one_mark_for_every_frame(empty, capture):
    left, right = [(0.0, 0.0), (800.0, 2000.0)], [(600.0, 0.0), (3000.0, 2000.0)]
    one, other = stroke(left, shape="BOX"), stroke(right, shape="BOX")
    np.testing.assert_array_equal(stroke(left, shape="BOX", mode="EXTEND"), one | other)
    np.testing.assert_array_equal(stroke(right, shape="BOX", mode="SUBTRACT"), one & ~other)
    np.testing.assert_array_equal(stroke(right, shape="BOX", mode="EXTEND"), one | other)
    np.testing.assert_array_equal(stroke(left, shape="BOX", mode="INTERSECT"), one)
    bpy.ops.frog.hide_gaussians()
    for frame in (1, 7):
        empty.frame_set(frame)
        assert point_cloud.count(capture) == np.count_nonzero(~one)
        np.testing.assert_array_equal(playback.displayed(capture, frame).scene.rows, np.flatnonzero(~one))


def test_only_the_visible_are_fewer(capture):
    all_of_them = stroke(EVERYTHING, shape="BOX")
    visible = stroke(EVERYTHING, shape="BOX", only_visible=True)
    assert 0 < visible.sum() < all_of_them.sum() and not (visible & ~all_of_them).any()


def test_undo_and_redo_of_strokes_are_exact(capture):
    def state():
        settings = active_capture(bpy.context).frog_edits
        kept = [(marks.count, marks.scene, marks.bits) for marks in (settings.selection, settings.hidden)]
        return kept, point_cloud.read(active_capture(bpy.context))["position"].tobytes()

    steps = (
        lambda: stroke(LASSO, shape="LASSO"),
        lambda: stroke([(700.0, 400.0), (900.0, 500.0)], radius=90, mode="EXTEND"),
        lambda: bpy.ops.frog.grow_selection(distance=0.3),
        lambda: bpy.ops.frog.grow_selection(distance=0.2, shrink=True),
        lambda: bpy.ops.frog.hide_gaussians(),
        lambda: bpy.ops.frog.add_crop(shape="BOX"),
        lambda: stroke([(0.0, 0.0), (700.0, 900.0)], shape="BOX"),
        lambda: bpy.ops.frog.select_gaussians_all(action="INVERT"),
        lambda: bpy.ops.frog.restore_gaussians(),
    )
    assert len({json.dumps(kept) for kept, _ in check_undo_and_redo(steps, state)}) > 6


def test_why_not_is_said(empty, capture):
    assert not bpy.ops.frog.select_by_hand.poll(), "there is no viewport here"
    for name in ("hide_gaussians", "restore_gaussians", "grow_selection", "add_grade"):
        assert not getattr(bpy.ops.frog, name).poll(), "nothing is selected, nothing is hidden"
    stroke(LASSO, shape="LASSO")
    assert bpy.ops.frog.hide_gaussians.poll() and bpy.ops.frog.grow_selection.poll() and bpy.ops.frog.add_grade.poll()
    bpy.ops.frog.hide_gaussians()
    assert bpy.ops.frog.restore_gaussians.poll()
    with bpy.context.temp_override(**viewport()):
        assert bpy.ops.frog.select_by_hand.poll()
        with pytest.raises(RuntimeError, match="no path of the mouse"):
            bpy.ops.frog.select_by_hand()
        capture.hide_set(True)
        with pytest.raises(RuntimeError, match="hidden in this viewport"):
            bpy.ops.frog.select_by_hand(path=[{"name": "", "loc": (1.0, 1.0), "time": 0.0}])


class Mouse:
    """Begins a gesture as a window does, goes on with it, and keeps what it ``said``."""

    def __init__(self):
        self.said = []

    def press(self, x, y, **settings):
        self.pressed = self._event("LEFTMOUSE", "PRESS", x, y)
        with bpy.context.temp_override(**viewport()):
            return bpy.ops.frog.select_by_hand(**settings)

    def go_on(self, x, y, kind="MOUSEMOVE", value="NOTHING"):
        with bpy.context.temp_override(**viewport()):
            return self.operator.modal(bpy.context, self._event(kind, value, x, y))

    def _event(self, kind, value, x, y):
        return SimpleNamespace(type=kind, value=value, mouse_region_x=x, mouse_region_y=y)


@pytest.fixture
def mouse(capture):
    """Draws with the operator: without a path it begins at the mouse, which no test has."""
    mouse, operator = Mouse(), select_by_hand.FROG_OT_select_by_hand

    class Drawing(operator):
        bl_idname, bl_label, __doc__ = operator.bl_idname, operator.bl_label, operator.__doc__

        def execute(self, context):
            if len(self.path):
                return super().execute(context)
            mouse.operator = self
            return self.invoke(context, mouse.pressed)

        def act(self, context):
            mouse.said.append(super().act(context))

        def failed(self, error):
            mouse.said.append(str(error))
            return {"CANCELLED"}

    with in_place_of(operator, Drawing):
        yield mouse


@pytest.mark.parametrize("shape", ["BRUSH", "LASSO", "BOX"])
def test_the_mouse_draws_what_a_script_does(mouse, shape):
    places = [(300, 200), (1200, 300), (900, 800), (400, 700)]
    assert mouse.press(*places[0], shape=shape, radius=60) == {"RUNNING_MODAL"} and is_drawing()
    for point in places[1:]:
        assert mouse.go_on(*point) == {"RUNNING_MODAL"}
        assert not selected().any(), "until the button is released"
    assert mouse.go_on(*places[-1], "LEFTMOUSE", "RELEASE") == {"FINISHED"} and not is_drawing()
    drawn_by_mouse = selected()
    assert f"{drawn_by_mouse.sum()} of {COUNT}" in mouse.said[0] and drawn_by_mouse.any()
    path = [tuple(point.loc) for point in mouse.operator.path]
    assert path[0] == (300.5, 200.5)
    bpy.ops.frog.select_gaussians_all(action="NONE")
    np.testing.assert_array_equal(stroke(path, shape=shape, radius=60), drawn_by_mouse)


@pytest.mark.parametrize("shape", ["BRUSH", "LASSO", "BOX"])
def test_a_click_on_a_crop_s_frame_selects_it(capture, mouse, shape):
    crops = []
    for kind, place in (("BOX", (-6.0, 0.0, 0.0)), ("SPHERE", (6.0, 0.0, 0.0)), ("OBJECT", (0.0, 0.0, 5.0))):
        if kind == "OBJECT":
            bpy.ops.mesh.primitive_cone_add()
        assert bpy.ops.frog.add_crop(shape=kind) == {"FINISHED"}
        crops.append(capture.frog_edits.crops[-1].object)
        crops[-1].parent, crops[-1].scale, crops[-1].location = None, (1.0, 2.0, 0.5), place
        crops[-1].matrix_parent_inverse.identity()
    bpy.context.view_layer.update()
    region, view = (viewport()[name] for name in ("region", "space_data"))
    for crop in crops:
        bpy.ops.object.select_all(action="DESELECT")
        lines, faces = crop_frames.shape_of(crop)
        assert lines.shape[1:] == (2, 3) and faces.shape[1:] == (3, 3)
        low, high = crop_frames.bounds_of(crop)
        for points in (lines, faces):
            np.testing.assert_allclose([points.min((0, 1)), points.max((0, 1))], [low, high], atol=0.01)
        middle = crop.matrix_world @ Vector(lines[0].mean(0))
        x, y = map(round, location_3d_to_region_2d(region, view.region_3d, middle))
        mouse.press(x, y, shape=shape, radius=60)
        assert mouse.go_on(x + 1, y, "LEFTMOUSE", "RELEASE") == {"CANCELLED"} and not is_drawing()
        assert bpy.context.selected_objects == [crop] and bpy.context.object == crop and not selected().any()
        mouse.press(x, y, shape=shape, radius=60)
        mouse.go_on(x + 90, y + 70)
        mouse.go_on(x + 90, y - 70)
        assert mouse.go_on(x + 90, y, "LEFTMOUSE", "RELEASE") == {"FINISHED"}, "a gesture that begins there"
        with bpy.context.temp_override(**viewport()):
            assert crop_frames.crop_at(bpy.context, 5, 5) is None


def test_handles_stand_on_the_sides_of_the_active_crop(capture):
    bpy.ops.frog.add_crop(shape="BOX")
    crop = bpy.context.object
    with bpy.context.temp_override(**viewport()):
        assert crop_frames.FROG_GGT_crop_sides.poll(bpy.context)
        for axis, here, across in crop_frames.handles_of(crop):
            local = crop.matrix_world.inverted() @ here
            assert abs(abs(local[axis]) - 1) < 1e-4 and local.length == pytest.approx(1, abs=1e-4)
            assert (crop.matrix_world.inverted() @ across + local).length < 1e-3
        capture.select_set(True)
        assert not crop_frames.FROG_GGT_crop_sides.poll(bpy.context), "it would be scaled as well"


def test_lines_behind_the_eye_are_cut_off():
    """A box around the eye, which looks along its axes: what is seen are the four far edges and parts of four more."""
    matrix = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, -0.1], [0, 0, -1, 0]])
    context = SimpleNamespace(
        region_data=SimpleNamespace(perspective_matrix=matrix), region=SimpleNamespace(width=200, height=100)
    )
    lines = np.array([[[-1.0, -1, -1], [1, -1, -1]], [[1, 1, -1], [1, 1, 1]], [[-1, 1, 1], [1, 1, 1]]])
    seen = crop_frames._on_screen(lines, context)
    assert len(seen) == 2 and np.isfinite(seen).all()
    np.testing.assert_allclose(seen[0], [[0, 0], [200, 0]])
    np.testing.assert_allclose(seen[1, 0], [200, 100])
    assert (seen[1, 1] > [1000, 500]).all() and distance_to(seen, np.array([100.0, 7.0])).min() == pytest.approx(7)


def test_escape_leaves_everything_as_it_was(capture, mouse):
    before = stroke(LASSO, shape="LASSO")
    mouse.press(500, 500)
    mouse.go_on(900, 500)
    assert mouse.go_on(900, 500, "ESC", "PRESS") == {"CANCELLED"} and not is_drawing()
    np.testing.assert_array_equal(selected(), before)
    capture.hide_set(True)
    assert mouse.press(500, 500) == {"CANCELLED"} and "hidden in this viewport" in mouse.said[-1]


def test_a_training_that_ends_during_a_gesture_is_not_marked_by_it(empty, capture, path, mouse):
    mouse.press(700, 450, radius=500)
    write_scene(path, rig_of_three(), count=COUNT // 2, seed=3)
    empty.frame_set(5)
    assert mouse.go_on(700, 450, "LEFTMOUSE", "RELEASE") == {"CANCELLED"} and not is_drawing()
    assert "another training" in mouse.said[-1] and edits.marks_of(capture.frog_edits.selection) is None


def test_a_gesture_that_fails_leaves_no_drawing(mouse):
    mouse.press(700, 450)
    event = SimpleNamespace(type="MOUSEMOVE", mouse_region_x=705, mouse_region_y=450)
    assert bpy.context.area is None, "as in a window that is closed"
    assert mouse.operator.modal(bpy.context, event) == {"RUNNING_MODAL"} and is_drawing()
    with pytest.raises(AttributeError):
        mouse.operator.modal(bpy.context, SimpleNamespace(type="MOUSEMOVE"))
    assert not is_drawing()


@pytest.fixture
def with_tool(request, capture):
    """A viewport in which a tool that selects Gaussians is active, as its keys find it."""
    with bpy.context.temp_override(**viewport()):
        bpy.ops.wm.tool_set_by_id(name=getattr(request, "param", selection_tools.BRUSH))
        yield bpy.context.workspace.tools.from_space_view3d_mode("OBJECT")
        bpy.ops.wm.tool_set_by_id(name="builtin.select_box")


def pressed(kind, **held):
    """What a key of the tools does: as Blender looks for it, among those whose operator can be called."""
    keys = bpy.context.window_manager.keyconfigs.addon.keymaps[selection_tools.KEYMAP].keymap_items
    state = {"value": "PRESS", "shift": False, "ctrl": False, "alt": False} | held
    for item in keys:
        group, name = item.idname.split(".")
        operator = getattr(getattr(bpy.ops, group), name)
        if item.type == kind and all(getattr(item, what) == value for what, value in state.items()) and operator.poll():
            set_here = item.properties.items()
            return operator(**{name: getattr(item.properties, name) for name, _ in set_here})
    return {"PASS_THROUGH"}


HIDING = [("X", {}), ("DEL", {}), ("H", {}), ("X", {"shift": True}), ("DEL", {"shift": True}), ("H", {"shift": True})]


@pytest.mark.parametrize(("key", "held"), HIDING)
def test_keys_hide_the_selected_or_say_why_not(with_tool, capture, key, held):
    objects = set(bpy.data.objects)
    assert pressed(key, **held) == {"CANCELLED"}, "nothing is selected, and Blender's own key must not be reached"
    chosen = stroke(LASSO, shape="LASSO")
    assert pressed(key, **held) == {"FINISHED"}
    is_others = key == "H" and bool(held)
    hidden = edits.marks_of(capture.frog_edits.hidden).chosen()
    np.testing.assert_array_equal(hidden, ~chosen if is_others else chosen)
    stroke(EVERYTHING, shape="BOX")
    capture.frog_edits.selection.bits = capture.frog_edits.hidden.bits  # some of them are selected, as by a criterion
    assert pressed("H", alt=True) == {"FINISHED"} and edits.marks_of(capture.frog_edits.hidden) is None
    assert pressed("H", alt=True) == {"CANCELLED"}, "nothing is hidden"
    assert set(bpy.data.objects) == objects and capture.visible_get()


@pytest.mark.parametrize("with_tool", list(selection_tools.SHAPES), indirect=True)
def test_keys_select_and_leave_the_tool(with_tool, capture):
    assert with_tool.idname in selection_tools.SHAPES
    assert pressed("A") == {"FINISHED"} and selected().all()
    assert pressed("A", alt=True) == {"FINISHED"} and not selected().any()
    some = stroke([(700.0, 450.0)], shape="BRUSH", radius=150)
    assert pressed("I", ctrl=True) == {"FINISHED"}
    np.testing.assert_array_equal(selected(), ~some)
    for kind, held in (("A", {"value": "DOUBLE_CLICK"}), ("I", {"ctrl": True})):
        pressed(kind, **held)
    assert selected().all()
    stroke([(700.0, 450.0)], shape="BRUSH", radius=150)
    sizes = [some.sum()]
    for kind, held in (("PLUS", {}), ("EQUAL", {}), ("NUMPAD_PLUS", {"ctrl": True}), ("EQUAL", {"shift": True})):
        assert pressed(kind, **held) == {"FINISHED"}
        sizes.append(selected().sum())
    assert sizes == sorted(sizes) and sizes[-1] > sizes[0]
    for kind, held in (("MINUS", {}), ("NUMPAD_MINUS", {"ctrl": True})):
        assert pressed(kind, **held) == {"FINISHED"}
    assert selected().sum() < sizes[-1]
    assert pressed("ESC") == {"FINISHED"}
    assert bpy.context.workspace.tools.from_space_view3d_mode("OBJECT").idname == "builtin.select_box"
    assert not bpy.ops.frog.restore_gaussians.poll(), "nothing is hidden: outside of the tools H stays Blender's"


def test_a_key_with_no_capture_chosen_deletes_no_object(with_tool, capture):
    bpy.ops.import_scene.frog(filepath=str(playback.file_of(capture)))
    bpy.context.view_layer.objects.active = None
    assert active_capture(bpy.context) is None, "one of two"
    assert pressed("X") == pressed("A") == {"CANCELLED"}


def test_the_user_sees_each_key_once(with_tool):
    keys = bpy.context.window_manager.keyconfigs.addon.keymaps[selection_tools.KEYMAP].keymap_items
    events = [(item.type, item.value, item.shift, item.ctrl, item.alt) for item in keys]
    assert len(set(events)) == len(events)
    shown = []
    layout = SimpleNamespace(template_event_from_keymap_item=lambda item, text: shown.append((text, item.type)))
    bpy.context.window_manager.keyconfigs.update()
    selection_tools.draw_keys(layout, bpy.context)
    assert shown == [(action.label, action.keys[0].split()[-1]) for action in selection_tools.ACTIONS]


def test_tools_are_in_the_toolbar_and_the_brush_grows(capture):
    with bpy.context.temp_override(**viewport()):
        tools = bpy.context.workspace.tools
        for tool in (selection_tools.LASSO, selection_tools.BOX):
            assert bpy.ops.wm.tool_set_by_id(name=tool) == {"FINISHED"}
            assert tools.from_space_view3d_mode("OBJECT").idname == tool
            assert not bpy.ops.frog.resize_selection_brush.poll()
        assert bpy.ops.wm.tool_set_by_id(name=selection_tools.BRUSH) == {"FINISHED"}
        settings = tools.from_space_view3d_mode("OBJECT").operator_properties(selection_tools.HAND)
        assert settings.radius == 25
        assert bpy.ops.frog.resize_selection_brush(factor=2.0) == {"FINISHED"} and settings.radius == 50
        settings.radius = 2
        for factor, expected in ((0.8, 1), (0.8, 1), (1.25, 2), (1.25, 3)):
            bpy.ops.frog.resize_selection_brush(factor=factor)
            assert settings.radius == expected
        bpy.ops.wm.tool_set_by_id(name="builtin.select_box")


def test_faces_of_crops_leave_black_dark():
    light = 1 - (1 - crop_frames._FACES[3]) ** 2  # of the near face and the far one, which are laid over linear colours
    assert 0.08 < 1.055 * light ** (1 / 2.4) - 0.055 < 0.2, "what lies behind is seen as it is"
