"""Points that are clicked in each camera's image: where a click goes, what a key does, and what is kept."""

import json
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from frog_blender.engine.capture.calibration.points import read_points
from frog_blender.engine.capture.synchronization.films import find_films
from frog_blender.engine.errors import FrogError
from frog_blender.operators import calibrate
from frog_blender.ui import points_overlay
from frog_blender.ui.clicked_points import FILE, ClickedPoints, points_of

film = pytest.importorskip("support.synthetic_capture")


def clicked(points, *pixels):
    for pixel in pixels:
        points.click(pixel)
    return points


def test_clicks_go_on_from_point_to_point_and_from_camera_to_camera():
    points = clicked(ClickedPoints(["a", "b"]), (1, 1), (2, 2), (3, 3))
    assert points.of("a") == [(1, 1), (2, 2), (3, 3)] and points.of("b") == [None] * 3 and points.point == 3
    points.turn(1)
    assert (points.name, points.point) == ("b", 0)
    points.click(None)
    clicked(points, (5, 5), (6, 6))
    assert points.of("b") == [None, (5, 5), (6, 6)] and (points.seen_in("a"), points.seen_in("b")) == (3, 2)
    points.turn(1)
    assert (points.name, points.point) == ("a", 3), "the next new one"
    points.turn(-1)
    assert (points.name, points.point) == ("b", 0), "what is not set yet"


def test_undo_takes_back_what_was_done_in_any_image():
    points = clicked(ClickedPoints(["a", "b"]), (1, 1), (2, 2))
    points.turn(1)
    points.click((5, 5))
    points.turn(1)
    assert points.press("Z", ctrl=True) and (points.name, points.point) == ("b", 0) and points.of("b") == [None, None]
    points.turn(-1)
    points.choose(-1)
    points.click(None)
    assert points.of("a") == [(1, 1)]
    assert points.undo() and points.of("a") == [(1, 1), (2, 2)]
    assert points.undo() and points.undo() and not points.undo() and points.count == 0


def test_what_is_saved_is_what_a_calibration_reads(raw):
    films = find_films(raw)
    points = clicked(points_of(raw / FILE, films), (1.5, 2.25), (47, 35))
    points.turn(1)
    points.click(None)
    points.click((10, 11))
    points.save(raw / FILE)
    pixels = read_points(raw / FILE, {film.name: film.size for film in films})
    assert pixels["cam00"].tolist() == [[1.5, 2.25], [47, 35]] and np.isnan(pixels["cam01"][0]).all()
    assert pixels["cam01"][1].tolist() == [10, 11] and np.isnan(pixels["cam03"]).all()
    again = points_of(raw / FILE, films)
    assert again.of("cam00") == [(1.5, 2.25), (47, 35)] and again.of("cam01") == [None, (10, 11)]
    while points.undo():
        pass
    points.save(raw / FILE)
    assert not (raw / FILE).exists(), "no points are no file"


def test_a_file_that_does_not_fit_is_left_alone(raw):
    (raw / FILE).write_text(json.dumps({"other": [[1, 1]]}))
    with pytest.raises(FrogError, match="camera other"):
        points_of(raw / FILE, find_films(raw))
    assert "other" in (raw / FILE).read_text()


def test_a_films_image_stands_upright(empty, raw):
    image = calibrate.image_of(find_films(raw)[0])
    shown = np.array(image.pixels[:]).reshape(film.HEIGHT, film.WIDTH, 4)[::-1, :, :3]
    true = film.image(film.rig()[0], 0) / 255
    assert np.abs(shown - true).mean() < np.abs(shown[::-1] - true).mean() / 2
    calibrate.image_of(find_films(raw)[1])
    assert [shown.name for shown in bpy.data.images if points_overlay.IMAGE in shown.name] == [points_overlay.IMAGE]
    calibrate._remove_image()


class Region:
    """An image editor's, in which an image of 48 x 36 pixels is drawn ten times as large."""

    type, x, y, width, height = "WINDOW", 100, 50, 480, 360

    class view2d:
        @staticmethod
        def region_to_view(x, y):
            return x / 480, y / 360


def pressed(key, x=0, y=0, ctrl=False):
    return SimpleNamespace(type=key, value="PRESS", ctrl=ctrl, mouse_x=100 + x, mouse_y=50 + y)


@pytest.fixture
def clicking(empty, raw):
    """The operator in an area, as Blender calls it."""
    films = tuple(find_films(raw))
    area = SimpleNamespace(
        type="IMAGE_EDITOR",
        ui_type="IMAGE_EDITOR",
        regions=[Region],
        as_pointer=lambda: 7,
        tag_redraw=lambda: None,
        spaces=SimpleNamespace(active=SimpleNamespace(image=None)),
    )
    operator = SimpleNamespace(
        _films=films, _points=ClickedPoints([one.name for one in films]), _path=raw / FILE, _area=7, _former="VIEW_3D"
    )
    operator._shown, operator._is_fitted, operator.area, operator.reports = 0, True, area, []
    operator.report = lambda kind, sentence: operator.reports.append(sentence)
    kind = calibrate.FROG_OT_click_points
    for name in ("_take", "_found_area", "_show", "_end"):
        setattr(operator, name, getattr(kind, name).__get__(operator))
    context = SimpleNamespace(screen=SimpleNamespace(areas=[area]))
    operator.send = lambda *given, **more: kind.modal(operator, context, pressed(*given, **more))
    return operator


def test_clicks_in_the_image_are_pixels_of_the_film(clicking, raw):
    assert clicking.send("LEFTMOUSE", 120, 270) == {"RUNNING_MODAL"}
    assert json.loads((raw / FILE).read_text())["cam00"] == [[12.0, 9.0]], "from the upper left corner, saved at once"
    assert clicking.send("LEFTMOUSE", 600, 10) == {"PASS_THROUGH"}, "beside the editor"
    assert clicking.send("WHEELUPMOUSE", 10, 10) == {"PASS_THROUGH"}, "zooms"
    assert clicking.send("TAB", 10, 10) == {"RUNNING_MODAL"} and clicking._points.name == "cam01"
    assert clicking.area.spaces.active.image == bpy.data.images[points_overlay.IMAGE]
    assert clicking.send("Z", 10, 10, ctrl=True) == {"RUNNING_MODAL"} and not (raw / FILE).exists()
    assert clicking.send("RET", 10, 10) == {"FINISHED"} and clicking.area.ui_type == "VIEW_3D"
    assert points_overlay.IMAGE not in bpy.data.images and not clicking.reports


def test_a_click_that_cannot_be_saved_ends_with_a_sentence(clicking, raw):
    clicking._path = raw / "nowhere" / "x" / FILE
    (raw / "nowhere").write_text("")
    assert clicking.send("LEFTMOUSE", 120, 270) == {"FINISHED"}
    assert len(clicking.reports) == 1 and clicking.area.ui_type == "VIEW_3D"


def test_without_a_window_it_says_so(empty, raw):
    empty.frog.capture_folder = str(raw)
    with pytest.raises(RuntimeError, match="in a window"):
        bpy.ops.frog.click_points()
