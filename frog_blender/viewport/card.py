"""The graphics card, by Blender's gpu module: shaders, textures, and images of splats."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gpu
import numpy as np

from . import shaders
from .clouds import ROW, Texels, Textures, rows_for, texels_of
from .look import SIDE, Look
from .projection import SplatView

_FORMATS = {1: "R32F", 4: "RGBA32F"}
_PICTURE = "RGBA16F"  # 8 bits would round a hundred times where a hundred faint splats overlap


@dataclass(frozen=True, eq=False)
class Layer:
    """One capture to draw: its textures, how it is seen, the numbers of its splats (see ``starts_of``), and its
    low-pass (see GaussianArrays)."""

    textures: Textures
    view: SplatView
    count: int
    start: int
    low_pass: float


class Canvas:
    """Images of one size to draw on. Making a GPUOffScreen would end the viewport's framebuffer: whatever is drawn
    after that, the splats and Blender's texts and gizmos, would be lost until the next redraw.
    """

    def __init__(self, size: tuple[int, int], formats: Sequence[str] = (_PICTURE,)) -> None:
        self.size = size
        self.textures = tuple(gpu.types.GPUTexture(size, format=kind) for kind in formats)
        self.framebuffer = gpu.types.GPUFrameBuffer(color_slots=self.textures)


class GraphicsCard:
    """Draws splats. For the main thread, while Blender's graphics context is current."""

    def __init__(self) -> None:
        self._projection, self._splats = shaders.projection_shader(), shaders.splat_shader()
        self._picture, self._fading = shaders.picture_shader(), shaders.fading_shader()
        self._square = shaders.square(self._projection)  # all of them take the same corners
        self._projected: Canvas | None = None
        self._nothing = self.texture(texels_of(np.zeros(4), 4))
        self._no_depth = self.depth(np.ones((1, 1), np.float32))

    def texture(self, texels: Texels) -> Any:
        """A texture with that content."""
        values = gpu.types.Buffer("FLOAT", texels.values.size, texels.values)
        return gpu.types.GPUTexture(texels.size, format=_FORMATS[texels.channels], data=values)

    def depth(self, depths: np.ndarray) -> Any:
        """The texture of (H, W) float32 depths in [0, 1], rows from the bottom: what lies farther is hidden."""
        height, width = depths.shape
        return self.texture(Texels((width, height), 1, np.ascontiguousarray(depths, np.float32).reshape(-1)))

    def has_room(self, layers: Sequence[Layer]) -> bool:
        """Whether captures can be drawn without making new textures. Larger ones do: viewports that show different
        captures are drawn in turn.
        """
        return self._projected is not None and self._projected.size[1] >= _size_for(layers)[1]

    def free(self) -> None:
        """Gives back the room for captures that are drawn."""
        self._projected = None

    def draw(
        self,
        canvas: Canvas,
        layers: Sequence[Layer],
        order: Any,
        count: int,
        depth: Any = None,
        through: float = 0.0,
        *,
        behind: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> None:
        """Draws captures on a cleared image: display-referred colours times alpha.

        Args:
            layers: of one view.
            order: the texture of their splats' numbers, ``count`` of them, the farthest first.
            depth: a texture, see ``depth``.
            through: the share of what lies behind ``depth`` that is seen nevertheless.
            behind: what the image is before: nothing, or a colour that covers what the viewport has drawn.
        """
        gpu.state.depth_test_set("NONE")
        gpu.state.depth_mask_set(False)
        projected = self._project(layers)
        with canvas.framebuffer.bind():
            framebuffer = gpu.state.active_framebuffer_get()
            framebuffer.clear(color=behind)
            if not count:
                return
            hiding = self._no_depth if depth is None else depth
            if through > 0 and depth is not None:
                self._draw_splats(layers[0].view, projected, order, count, hiding, is_hidden=True)
                self._fade(through)  # all of them together: many faint splats that are faded each cover as much
            self._draw_splats(layers[0].view, projected, order, count, hiding, is_hidden=False)
            gpu.state.blend_set("NONE")

    def _draw_splats(
        self, view: SplatView, projected: Canvas, order: Any, count: int, depth: Any, *, is_hidden: bool
    ) -> None:
        """Draws the splats that lie behind a depth, or the others."""
        gpu.state.blend_set("ALPHA_PREMULT")
        shader = self._splats
        shader.bind()
        shader.uniform_float("screen", [*map(float, view.size), float(is_hidden)])
        for name, texture in zip(shaders.SPLATS, projected.textures, strict=True):
            shader.uniform_sampler(name, texture)
        shader.uniform_sampler("order", order)
        shader.uniform_sampler("scene_depth", depth)
        self._square.draw_instanced(shader, instance_count=count)

    def _fade(self, share: float) -> None:
        """Leaves a share of what is drawn."""
        gpu.state.blend_set("MULTIPLY")
        self._fading.bind()
        self._fading.uniform_float("share", share)
        self._square.draw(self._fading)

    def _project(self, layers: Sequence[Layer]) -> Canvas:
        """The textures ``shaders.SPLATS`` of captures; they are good until the next ones are projected."""
        if self._projected is None or not self.has_room(layers):
            self._projected = None  # before there are two
            self._projected = Canvas(_size_for(layers), ["RGBA32F"] * len(shaders.SPLATS))
        with self._projected.framebuffer.bind():
            gpu.state.blend_set("NONE")
            for layer in layers:
                if layer.count:
                    self._project_layer(layer, self._projected.size[1])
        return self._projected

    def _project_layer(self, layer: Layer, rows: int) -> None:
        shader, view, textures = self._projection, layer.view, layer.textures
        shader.bind()
        for name, row in zip(("to_right", "to_down", "to_front"), view.to_camera.tolist(), strict=False):
            shader.uniform_float(name, row)
        shader.uniform_float("lens", view.lens)
        shader.uniform_float("clip", view.clip)
        shader.uniform_float("eye", [*view.eye.tolist(), float(textures.sh_count)])
        shader.uniform_float("screen", [*map(float, view.size), float(textures.rows), layer.low_pass])
        first, some = layer.start // ROW, -(-layer.count // ROW)
        shader.uniform_float("rows", [float(first), float(some), float(rows), float(layer.count)])
        for name in shaders.TEXTURES:
            still = textures.still.get(name, self._nothing)
            shader.uniform_sampler(f"{name}_still", still)
            shader.uniform_sampler(f"{name}_moving", textures.moving.get(name, still))
        self._square.draw(shader)

    def lay_over(self, canvas: Canvas, shown: Look) -> None:
        """Lays a drawn image over the whole of what is bound, at whatever size, as a scene shows colors."""
        gpu.state.blend_set("ALPHA_PREMULT")
        gpu.state.depth_test_set("NONE")
        gpu.state.depth_mask_set(False)
        shader, side = self._picture, 0 if shown.table is None else SIDE
        shader.bind()
        shader.uniform_float("look", (shown.factor, shown.exponent, float(side)))
        shader.uniform_sampler("picture", canvas.textures[0])
        shader.uniform_sampler("colors", self._nothing if shown.table is None else shown.table)
        self._square.draw(shader)
        gpu.state.blend_set("NONE")


def _size_for(layers: Sequence[Layer]) -> tuple[int, int]:
    """Width and height of the textures in which captures are projected."""
    return ROW, rows_for(max((layer.start + layer.count for layer in layers), default=0))
