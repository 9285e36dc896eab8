"""What lies on the graphics card of each scene: put there once, and of a frame what changes alone.

The card is whatever makes a texture of texels: tests count what goes to it.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from .layout import Texels, moving_textures, still_textures

if TYPE_CHECKING:
    from ..engine.playback.player import ScenePlayer
    from ..timeline.playback_cache import SceneTime

_TIMES_KEPT = 3  # of a scene: duplicates may show others, and playback goes on before the card has drawn


class Card(Protocol):
    """Makes textures."""

    def texture(self, texels: Texels) -> Any:  # Any: a gpu.types.GPUTexture, of which nothing here knows more
        """A texture with that content."""
        ...


@dataclass(frozen=True, eq=False)
class Textures:
    """What the shader reads of a scene at one time.

    Attributes:
        still, moving: by the names in ``layout.CHANNELS``; what a scene has nothing of is lacking.
        rows: Gaussians of which ``moving`` has rows.
        sh_count: coefficients of the colours.
    """

    still: dict[str, Any]
    moving: dict[str, Any]
    rows: int
    sh_count: int


class Cloud:
    """One scene on the card."""

    def __init__(self, scene: ScenePlayer, card: Card) -> None:
        self._scene, self._card = scene, card
        self._still = self._uploaded(still_textures(scene))
        self._moving: OrderedDict[float, dict[str, Any]] = OrderedDict()

    def at(self, shown: SceneTime) -> Textures:
        """The textures at a time; uploads what changes in time, unless that time is there."""
        scene = self._scene
        if not scene.changing:
            return self._textures({})
        moving = self._moving.get(shown.time)
        if moving is None:
            moving = self._uploaded(moving_textures(scene, shown.part()))
            self._moving[shown.time] = moving
        self._moving.move_to_end(shown.time)
        while len(self._moving) > _TIMES_KEPT:
            self._moving.popitem(last=False)
        return self._textures(moving)

    def _textures(self, moving: dict[str, Any]) -> Textures:
        return Textures(self._still, moving, self._scene.num_dynamic, (self._scene.sh_degree + 1) ** 2)

    def _uploaded(self, textures: dict[str, Texels]) -> dict[str, Any]:
        return {name: self._card.texture(texels) for name, texels in textures.items()}


class Clouds:
    """The scenes on the card, by their tokens."""

    def __init__(self) -> None:
        self._clouds: dict[str, Cloud] = {}

    def of(self, scene: ScenePlayer, card: Card) -> Cloud:
        """A scene's, put there if it is not."""
        if scene.token not in self._clouds:
            self._clouds[scene.token] = Cloud(scene, card)
        return self._clouds[scene.token]

    def keep_only(self, tokens: Iterable[str]) -> None:
        """Drops the others: a file may have been trained anew."""
        wanted = set(tokens)
        self._clouds = {token: cloud for token, cloud in self._clouds.items() if token in wanted}

    def __len__(self) -> int:
        return len(self._clouds)
