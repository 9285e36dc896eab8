"""The graphics card, by Blender's gpu module: shaders, textures, and images of splats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from . import shaders
from .layout import Texels, texels_of
from .look import SIDE

if TYPE_CHECKING:
    from .clouds import Textures
    from .look import Look
    from .projection import SplatView

_FORMATS = {1: "R32F", 4: "RGBA32F"}
_PICTURE = "RGBA16F"  # 8 bits would round a hundred times where a hundred faint splats overlap


@dataclass(frozen=True, eq=False)
class Layer:
    """One capture to draw: its textures, how it is seen, and the order of its splats."""

    textures: Textures
    view: SplatView
    order: Any  # a GPUTexture
    count: int


class Canvas:
    """An image to draw on. Making a GPUOffScreen would end the viewport's framebuffer: whatever is drawn after that,
    the splats and Blender's texts and gizmos, would be lost until the next redraw.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        import gpu

        self.texture_color = gpu.types.GPUTexture(size, format=_PICTURE)
        self._framebuffer = gpu.types.GPUFrameBuffer(color_slots=(self.texture_color,))

    def bind(self) -> Any:
        """A context in which it is drawn on."""
        return self._framebuffer.bind()


class GraphicsCard:
    """Draws splats. For the main thread, while Blender's graphics context is current."""

    def __init__(self) -> None:
        self._splats = shaders.splat_shader()
        self._picture = shaders.picture_shader()
        self._quad, self._whole = shaders.square(self._splats), shaders.square(self._picture)
        self._nothing = self.texture(texels_of(np.zeros(4), 4))
        self._no_depth = self.depth(np.ones((1, 1), np.float32))

    def texture(self, texels: Texels) -> Any:
        """A texture with that content."""
        import gpu

        buffer = gpu.types.Buffer("FLOAT", texels.values.size, texels.values)
        return gpu.types.GPUTexture(texels.size, format=_FORMATS[texels.channels], data=buffer)

    def order(self, indices: np.ndarray) -> Any:
        """The texture of an order of splats."""
        return self.texture(texels_of(indices, 1))

    def depth(self, depths: np.ndarray) -> Any:
        """The texture of (H, W) float32 depths in [0, 1], rows from the bottom: what lies farther is hidden."""
        import gpu

        values = np.ascontiguousarray(depths, np.float32).reshape(-1)
        buffer = gpu.types.Buffer("FLOAT", values.size, values)
        return gpu.types.GPUTexture(depths.shape[::-1], format="R32F", data=buffer)

    def canvas(self, size: tuple[int, int]) -> Canvas:
        """An image to draw on, of that width and height."""
        return Canvas(size)

    def draw(self, canvas: Canvas, layers: Sequence[Layer], depth: Any = None) -> None:
        """Draws captures, the farthest first, on a cleared image: display-referred colours times alpha."""
        import gpu

        with canvas.bind():
            framebuffer = gpu.state.active_framebuffer_get()
            framebuffer.clear(color=(0.0, 0.0, 0.0, 0.0))
            gpu.state.blend_set("ALPHA_PREMULT")
            gpu.state.depth_test_set("NONE")
            gpu.state.depth_mask_set(False)
            for layer in layers:
                if layer.count:
                    self._draw_layer(layer, self._no_depth if depth is None else depth)
            gpu.state.blend_set("NONE")

    def _draw_layer(self, layer: Layer, depth: Any) -> None:
        from mathutils import Matrix

        shader, view, textures = self._splats, layer.view, layer.textures
        shader.bind()
        shader.uniform_float("to_camera", Matrix(view.to_camera.tolist()))
        shader.uniform_float("lens", view.lens)
        shader.uniform_float("clip", view.clip)
        shader.uniform_float("eye", [*view.eye.tolist(), float(textures.sh_count)])
        shader.uniform_float("screen", [*map(float, view.size), float(textures.rows), 0.0])
        for name in shaders.TEXTURES:
            still = textures.still.get(name, self._nothing)
            shader.uniform_sampler(f"{name}_still", still)
            shader.uniform_sampler(f"{name}_moving", textures.moving.get(name, still))
        shader.uniform_sampler("order", layer.order)
        shader.uniform_sampler("scene_depth", depth)
        self._quad.draw_instanced(shader, instance_count=layer.count)

    def lay_over(self, canvas: Canvas, look: Look) -> None:
        """Lays a drawn image over the whole of what is bound, at whatever size, as a scene shows colors."""
        import gpu

        gpu.state.blend_set("ALPHA_PREMULT")
        gpu.state.depth_test_set("NONE")
        gpu.state.depth_mask_set(False)
        self._picture.bind()
        side = 0 if look.table is None else SIDE
        self._picture.uniform_float("look", (look.factor, look.exponent, float(side)))
        self._picture.uniform_sampler("picture", canvas.texture_color)
        self._picture.uniform_sampler("colors", self._nothing if look.table is None else look.table)
        self._whole.draw(self._picture)
        gpu.state.blend_set("NONE")
