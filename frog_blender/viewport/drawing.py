"""Draws the splats of all visible captures after a viewport's own content, as far as its depth lets them be seen: in
one order, so that captures may stand in each other.

A viewport keeps its last image of splats. The same view of the same captures at the same time, with nothing changed in
the scene, is that image once more.
"""

import time
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np
from bpy.app import handlers as on

from .. import addon_state, app_handlers, point_cloud, reported_once
from ..app_handlers import later, not_later
from ..cameras import view_camera
from ..engine.capture.camera import Camera
from ..engine.errors import FrogError
from ..redrawing import open_regions, viewports
from ..render.collect_instances import check_placement, visible_captures
from ..render.viewport import focal_ratio
from ..scene_import.scene_setup import start_cube
from ..timeline import playback
from . import hiding
from .card import Canvas, GraphicsCard, Layer
from .clouds import Clouds, TooManySplats, starts_of, texels_of
from .look import Looks
from .order import OrderRequest, Part, Sorter
from .picture import STILL_AFTER, Picture, Shown
from .projection import SplatView, view_of
from .views import clear_picture, is_frog_picture

_SOON = 0.01  # seconds until an order of many splats is asked for again
_SLOW_SHADINGS, _LOOK_AGAIN = ("MATERIAL", "RENDERED"), 0.5


Source = Callable[[bpy.types.Scene], Shown | None]
"""Gives what viewports show of a scene instead of its captures, None for nothing; called at every redraw."""


class ViewportSplats:
    """All of it.

    Attributes:
        handler: of Blender, which draws.
        card: None until something is drawn, and where it cannot.
        problem: why points are shown instead of splats, a sentence; empty where nothing is wrong.
        changes: counts what may have changed in a scene.
        matched: the changes after which points were last compared with what viewports show, and the scene.
        pictures: by region.
        drawn: images that were drawn anew.
        source: what is shown instead of captures.
    """

    def __init__(self) -> None:
        self.handler: Any = None
        self.card: GraphicsCard | None = None
        self.problem = ""
        self.clouds, self.sorter = Clouds(), Sorter()
        self.colors = Looks(lambda: later(_make_tables))
        self.changes, self.matched = 0, (-1, 0)
        self.pictures: dict[int, Picture] = {}
        self.drawn = 0
        self.source: Source = lambda _scene: None


def state() -> ViewportSplats:
    """What is kept while the add-on is on."""
    return addon_state.get(ViewportSplats)


def is_wanted(scene: bpy.types.Scene) -> bool:
    """Whether a scene's viewports show splats by the graphics card."""
    choice = scene.frog.viewport_drawing
    return is_possible() and choice != "POINTS" and (choice == "CARD" or not point_cloud.draws_splats())


def is_possible() -> bool:
    """Whether the graphics card draws here: what viewports show instead of captures as well, whatever draws these."""
    return not (bpy.app.background or state().problem)


def problem(scene: bpy.types.Scene) -> str:
    """Why a scene's viewports show points although the user's settings say splats; "" where they do not."""
    return state().problem if scene.frog.viewport_drawing != "POINTS" else ""


def changed() -> None:
    """Draws viewports again: what a source gives is another."""
    _on_change()
    viewports()


def _instead(scene: bpy.types.Scene) -> list[Shown]:
    shown = state().source(scene) if is_possible() else None
    return [] if shown is None else [shown]


def is_replaced(scene: bpy.types.Scene) -> bool:
    """Whether viewports show something else instead of a scene's captures."""
    return bool(_instead(scene))


def _draws(scene: bpy.types.Scene, space: bpy.types.SpaceView3D) -> bool:
    """Whether splats are drawn in this viewport: the FROG engine's own image has them already."""
    return is_wanted(scene) and not is_frog_picture(scene, space)


def _draw() -> None:
    """Blender's handler."""
    context = bpy.context
    try:
        scene, splats = context.scene, state()
        clear_picture(scene, context.space_data)
        if splats.matched != (matched := (splats.changes, scene.as_pointer())):
            splats.matched = matched
            if _mismatched(scene):  # also where FROG's own image shows the splats
                later(apply)
        if not (_instead(scene) or (_draws(scene, context.space_data) and playback.captures_in(scene))):
            return
        draw_in(context)
    except TooManySplats as error:
        _show_points(f"{error} Points are shown. Hide some captures, and choose In Viewports again.")
    except (FrogError, MemoryError) as error:
        reported_once.message(str(error) or "There is not enough memory to draw the splats.")
    except Exception as error:
        reported_once.unexpected("drawing splats", error)
        _show_points("The graphics card cannot draw splats here. Points are shown.")


def _show_points(sentence: str) -> None:
    """Shows points from now on, and why."""
    reported_once.message(sentence)
    state().problem = sentence
    later(apply)


def draw_in(context: bpy.types.Context) -> None:
    """Draws into the region of a context, whose framebuffer is bound."""
    splats, region = state(), context.region
    depsgraph = context.evaluated_depsgraph_get()
    if splats.card is None:
        splats.card = GraphicsCard()
    image = splats.pictures.setdefault(region.as_pointer(), Picture())
    if image.looked_at != (looked_at := _looked_at(splats, context)):
        captures = _shown(depsgraph, context.space_data) if _draws(context.scene, context.space_data) else []
        image.shown = _instead(context.scene) or captures
        image.looked_at = looked_at
        open_now = {region.as_pointer() for region in open_regions()} | {region.as_pointer()}
        splats.pictures = {pointer: kept for pointer, kept in splats.pictures.items() if pointer in open_now}
    if not image.shown:
        return
    drawn = splats.drawn
    _update(splats, image, context, depsgraph)
    splats.card.lay_over(image.canvas, splats.colors.of(context.scene, splats.card))
    if splats.drawn > drawn:
        image.pace.ended_at = time.perf_counter()  # laying over may wait for what was drawn
    if not splats.sorter.worker.is_idle:
        later(viewports, _SOON)
    elif image.step > 1:
        later(viewports, STILL_AFTER + 0.05)


def _looked_at(splats: ViewportSplats, context: bpy.types.Context) -> tuple[Any, ...]:
    """What determines which captures a viewport shows, and what they show."""
    scene, space = context.scene, context.space_data
    visible = *hiding.shown_kinds(space), space.local_view is None, _draws(scene, space)
    shown = is_replaced(scene), scene.frame_current_final
    return splats.changes, *shown, visible, scene.as_pointer(), context.view_layer.name


def _update(splats: ViewportSplats, image: Picture, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
    """Draws a viewport's image anew, if anything in it is not as it was."""
    view, space, region = context.region_data, context.space_data, context.region
    matrices, ratio = (view.view_matrix, view.window_matrix), focal_ratio(depsgraph, view, space)
    key = (
        *(np.array(matrix).tobytes() for matrix in matrices),
        *(region.width, region.height, ratio, image.looked_at),
        *(space.shading.type, through := hiding.seen_through(space.shading), space.overlay.show_overlays),
    )
    now, step = time.perf_counter(), image.step
    if image.key != key:
        step = image.pace.changed(now)
    elif step > 1 and image.pace.is_still(now):
        step = 1
    elif image.is_final and not _has_new_depth(image, space.shading.type, now):
        return
    size = max(1, -(-region.width // step)), max(1, -(-region.height // step))
    camera = view_camera(*matrices, *size, ratio)
    seen = [(capture, view_of(camera, capture.matrix, *matrices)) for capture in image.shown]
    request = _request(region.as_pointer(), seen)
    order = splats.sorter.order(request)
    if image.key == key and image.canvas.size == size and order is image.order and not image.is_final:
        return  # what is waited for is not there
    card = splats.card
    assert card is not None
    layers = []
    for (shown, view), start in zip(seen, order.starts, strict=True):
        scene = shown.time.scene
        textures = splats.clouds.of(scene, card).at(shown.time)
        layers.append(Layer(textures, view, scene.count, start, scene.header.low_pass))
    if order is not image.order:
        image.order_texture = card.texture(texels_of(order.numbers, 1))
    if image.canvas is None or image.canvas.size != size:
        image.canvas = Canvas(size)
        later(viewports, _SOON)  # while textures are made, what else is drawn into the viewport may be lost
    elif not card.has_room(layers):
        later(viewports, _SOON)
    depth, behind = _depth_before(card, image, context, camera, seen[0][1]), (0.0, 0.0, 0.0, 0.0)
    if depth is None and is_replaced(context.scene):  # covers other captures, the cube and the grid, which stay there
        red, green, blue = map(float, image.shown[0].time.scene.header.background)
        behind = red, green, blue, 1.0
    card.draw(image.canvas, layers, image.order_texture, len(order.numbers), depth, through, behind=behind)
    image.key, image.step, image.order = key, step, order
    image.is_final = step == 1 and order.key == request.key
    splats.clouds.keep_only(other.time.scene.token for drawn in splats.pictures.values() for other in drawn.shown)
    splats.drawn += 1


def _shown(depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D) -> list[Shown]:
    """The visible captures and what they show; those that cannot be shown are told once and left out."""
    captures = []
    for obj, evaluated, matrix in visible_captures(depsgraph, space):
        if obj.mode == "EDIT":
            continue
        try:
            check_placement(matrix, obj.name)
            time_shown = playback.displayed(obj, depsgraph.scene.frame_current_final, evaluated)
        except FrogError as error:
            reported_once.message(str(error))
            continue
        captures.append(Shown(time_shown, matrix))
    return captures


def _request(region: int, seen: list[tuple[Shown, SplatView]]) -> OrderRequest:
    """The one order of all captures' splats for a viewport."""
    starts = starts_of([shown.time.scene.count for shown, _ in seen])
    parts, key = [], []
    for (shown, view), start in zip(seen, starts, strict=True):
        scene = shown.time.scene
        parts.append(Part(scene.column("means", shown.time.part()), view.plane, start))
        key.append((*shown.time.key, view.plane))
    return OrderRequest(region, tuple(key), tuple(parts))


def _has_new_depth(image: Picture, shading: str, now: float) -> bool:
    """Whether something else lies before the splats since they were drawn, in viewports of engines that take a while to
    show what there is. There it looks now and then, as long as those engines draw.
    """
    if image.depth is None or shading not in _SLOW_SHADINGS:
        return False
    if now - image.checked_at < _LOOK_AGAIN:
        later(viewports, _LOOK_AGAIN)
        return False
    image.checked_at = now
    return not np.array_equal(hiding.drawn_depth(), image.depth)


def _depth_before(
    card: GraphicsCard, image: Picture, context: bpy.types.Context, camera: Camera, view: SplatView
) -> Any:
    """The texture of the depth of what hides splats, None for nothing. While the viewport's framebuffer is bound."""
    image.depth, image.checked_at = None, time.perf_counter()
    scene, space = context.scene, context.space_data
    has_others = not is_frog_picture(scene, space) and hiding.has_others(context)
    if has_others and (start_cube(scene) is not None or hiding.is_drawn_without_depth(scene, space)):
        depth = image.surfaces.depth(context, image.looked_at, camera, view)
    else:
        image.surfaces = hiding.Surfaces()
        depth = image.depth = hiding.drawn_depth() if has_others else None
    return None if depth is None else card.depth(depth)


def choose(_settings: Any, _context: bpy.types.Context) -> None:
    """What a scene's setting was changed to is tried, whatever failed before."""
    state().problem = ""
    apply()


def apply() -> None:
    """Hides the points of captures where viewports show splats, before which they would lie; shows the others."""
    for scene in bpy.data.scenes:
        for obj in _mismatched(scene):
            point_cloud.draw_in("viewport", obj, not point_cloud.is_drawn_in("viewport", obj))
    viewports()


def _mismatched(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The captures of a scene, but for those of another file, whose points are hidden or shown and are not to be."""
    own = (obj for obj in playback.captures_in(scene) if obj.library is None)
    is_hidden = is_replaced(scene) or is_wanted(scene)
    return [obj for obj in own if point_cloud.is_drawn_in("viewport", obj) == is_hidden]


def _make_tables() -> None:
    """Makes the tables of colors that viewports lack, and draws these again."""
    state().colors.make()
    viewports()


def _on_change(*_: Any) -> None:
    """What a viewport shows may have changed."""
    state().changes += 1


def _on_load(*_: Any) -> None:
    """Nothing of the file before is shown again."""
    splats = state()
    splats.changes += 1
    splats.problem = ""
    splats.pictures.clear()
    splats.clouds.keep_only(())
    splats.sorter.forget()
    if splats.card is not None:
        splats.card.free()


_HANDLERS: app_handlers.Handlers = [
    *((functions, _on_change) for functions in (on.depsgraph_update_post, on.frame_change_post)),
    *((functions, _on_change) for functions in (on.undo_post, on.redo_post)),
    (on.load_post, _on_load),
]


def register() -> None:
    if bpy.app.background:  # nothing is drawn, and there may be no graphics
        return
    app_handlers.add(_HANDLERS)
    state().handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_VIEW")


def unregister() -> None:
    splats = state()
    splats.sorter.worker.stop()
    not_later(viewports, apply, _make_tables)
    if splats.handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(splats.handler, "WINDOW")
        splats.handler = None
        app_handlers.remove(_HANDLERS)
