"""The papers' protocols as data: scenes, their frames and cameras, image sizes, and the papers' tables.

They are FRoG's (arXiv 2603.20857, datasets and tables), which follow E-D3DGS (JeongminB/E-D3DGS, README and script).
``protocols`` opens a dataset's folder by them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from . import published
from .published import Published


@dataclass(frozen=True)
class Part:
    """Consecutive frames of a scene that are a capture of their own.

    Attributes:
        name: in tables.
        first: the first frame: of the video from 0; for Technicolor the number in the images' names.
        count: frames; None for all.
    """

    name: str
    first: int = 0
    count: int | None = None


@dataclass(frozen=True)
class Scene:
    """A scene of a dataset.

    Attributes:
        folders: names that its folder may have; letter case, punctuation and a leading "vrig" do not count.
        parts: the captures that are made of it.
        without: cameras that are left out of training and evaluation; a name that ends with / stands for all of a
            folder.
    """

    folders: tuple[str, ...]
    parts: tuple[Part, ...]
    without: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Protocol:
    """A paper's evaluation.

    Attributes:
        name, title: for commands and for people.
        format: of its captures, see ``readers.detect``.
        recipe: the recipe that follows the paper's settings.
        scenes: in the order of tables.
        image_width: pixels that images are reduced to.
        held_out: what is held out, in words.
        cost_scenes: captures on which storage, time and FPS are measured; all where empty.
        table: the paper's main table; ``ablations`` its others; ``elsewhere`` other papers' figures.
    """

    name: str
    title: str
    format: str
    recipe: str
    scenes: tuple[Scene, ...]
    image_width: int
    held_out: str
    cost_scenes: tuple[str, ...] = ()
    table: tuple[Published, ...] = ()
    ablations: Mapping[str, tuple[Published, ...]] = field(default_factory=dict)
    elsewhere: tuple[Published, ...] = ()

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of its captures; an average weighs each of them alike."""
        return tuple(part.name for scene in self.scenes for part in scene.parts)


def _n3dv(name: str, without: frozenset[str] = frozenset()) -> Scene:
    return Scene((name,), (Part(name, 0, 300),), without)


N3DV = Protocol(
    name="n3dv",
    title="N3DV (Neural 3D Video)",
    format="n3dv",
    recipe="paper",
    scenes=(
        # Its camera 13 (the thirteenth by name) runs out of step with the others: Neural_3D_Video issue 5.
        _n3dv("coffee_martini", frozenset({"cam13"})),
        _n3dv("cook_spinach"),
        _n3dv("cut_roasted_beef"),
        Scene(
            ("flame_salmon_1", "flame_salmon"),
            tuple(Part(f"flame_salmon_frag{i + 1}", 300 * i, 300) for i in range(4)),
        ),
        _n3dv("flame_steak"),
        _n3dv("sear_steak"),
    ),
    image_width=1352,
    held_out="the first camera (cam00)",
    cost_scenes=("flame_salmon_frag1",),
    table=published.N3DV,
    ablations={"fusion": published.N3DV_FUSION, "k": published.N3DV_SHARPNESS},
    elsewhere=published.N3DV_ELSEWHERE,
)

HYPERNERF = Protocol(
    name="hypernerf",
    title="HyperNeRF (vrig)",
    format="hypernerf",
    recipe="hypernerf",
    scenes=(
        Scene(("vrig-3dprinter",), (Part("3dprinter"),)),
        Scene(("vrig-peel-banana", "banana"), (Part("peel-banana"),)),
        Scene(("broom2", "vrig-broom"), (Part("broom"),)),
        Scene(("vrig-chicken",), (Part("chicken"),)),
    ),
    image_width=536,  # rgb/2x
    held_out="the rig's other camera at every frame (val_ids)",
    table=published.HYPERNERF,
    ablations={"sampling": published.HYPERNERF_SAMPLING},
)

TECHNICOLOR = Protocol(
    name="technicolor",
    title="Technicolor light field",
    format="technicolor",
    recipe="technicolor",
    scenes=tuple(
        Scene(names, (Part(names[0], first, 50),))
        for names, first in (
            (("Birthday",), 151),
            (("Fabien",), 51),
            (("Painter",), 100),
            (("Theater", "Theatre"), 51),
            (("Train", "Trains"), 151),
        )
    ),
    image_width=2048,
    # FRoG writes "second row, second column"; it counts from 0, as every implementation does.
    held_out="row 2, column 2 of the grid, counted from 0 (cam10)",
    table=published.TECHNICOLOR,
    elsewhere=published.TECHNICOLOR_ELSEWHERE,
)

DNERF = Protocol(
    name="dnerf",
    title="D-NeRF",
    format="transforms",
    recipe="standard",
    # Its test images show another shovel than its training images (Deformable-3DGS, README).
    scenes=(Scene(("lego", "dnerf_lego"), (Part("lego"),), frozenset({"test/"})),),
    image_width=800,
    held_out="the validation split",
    elsewhere=published.DNERF_LEGO,
)

PROTOCOLS: dict[str, Protocol] = {protocol.name: protocol for protocol in (N3DV, HYPERNERF, TECHNICOLOR, DNERF)}
