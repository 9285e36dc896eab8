"""The papers' own figures, to be shown beside ours. They were measured on the papers' machines.

They are the tables of FRoG (arXiv 2603.20857), and what other papers report under their own protocols. Sizes are in
megabytes (10^6 bytes where the papers do not say), training times in minutes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Published:
    """A row of a printed table; None where nothing is printed.

    Attributes:
        title: the method as it is printed.
        psnr, ssim, lpips: averages over a protocol's scenes; LPIPS with AlexNet.
        megabytes, train_minutes, fps: storage, training time and frames a second, on the paper's machine.
        method: our name of the method, "" where we have none.
        settings: for ablations, the recipe's settings that the row stands for.
        note: what sets the row apart.
    """

    title: str
    psnr: float
    ssim: float | None = None
    lpips: float | None = None
    megabytes: float | None = None
    train_minutes: float | None = None
    fps: float | None = None
    method: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    note: str = ""


N3DV = (
    Published("Mix Voxels", 30.30, 0.918, 0.127, 512, 88, 1.01),
    Published("K-Planes", 30.86, 0.939, 0.096, 309, 93, 0.15),
    Published("D3DGS", 28.27, 0.917, 0.156, 75, 137, 20.29, "d3dgs"),
    Published("ST-GS", 28.94, 0.920, 0.078, 49, 265, 124, "curves", note="points of the first frame only"),
    Published("Swift4D", 30.05, 0.931, 0.055, 116, 48, 138.00),
    Published("4DGS", 30.30, 0.933, 0.069, 3600, 463, 54.36),
    Published("4DGaussians", 30.19, 0.917, 0.061, 53, 73, 78.28, "hexplane"),
    Published("E-D3DGS", 30.79, 0.937, 0.051, 73, 161, 40.52, "ed3dgs"),
    Published("FRoG", 31.01, 0.941, 0.050, 69, 116, 91.13, "frog"),
)
"""FRoG's table on N3DV; storage, time and FPS on flame_salmon_frag1."""

_BROOM = "storage, time and FPS on broom with an RTX 3090"
_RTX_3090 = "storage, time and FPS with an RTX 3090"
HYPERNERF = (
    Published("Nerfies", 22.23, None, 0.170, note=f"hours of training, FPS below 1; {_BROOM}"),
    Published("HyperNeRF", 22.29, 0.598, 0.153, 15, 1965, note=f"FPS below 1; {_BROOM}"),
    Published("TiNeuVox", 24.20, 0.616, 0.393, 48, 30, 1, note=_BROOM),
    Published("FRoG", 26.31, 0.721, 0.199, 37, 57, 146.50, "frog", note=_BROOM),
    Published("DN-4DGS", 25.59, 0.691, None, 68, 72, 20, note=_RTX_3090),
    Published("FRoG", 26.31, 0.721, 0.199, 51, 88, 110.45, "frog", note=_RTX_3090),
    Published("D3DGS", 22.40, 0.598, 0.275, 195, 114, 11.54, "d3dgs"),
    Published("4DGaussians", 25.10, 0.688, 0.271, 71, 20, 100.41, "hexplane"),
    Published("E-D3DGS", 25.92, 0.716, 0.197, 53, 110, 78.45, "ed3dgs"),
    Published("FRoG", 26.31, 0.721, 0.187, 51, 81, 125.91, "frog"),
)
"""FRoG's table on HyperNeRF, an RTX A6000 unless noted; its LPIPS differs between its own rows (0.187 and 0.199)."""

_PAINTER = "storage, time and FPS on Painter with an RTX 3090"
TECHNICOLOR = (
    Published("DyNeRF", 31.80, None, 0.140, 0.6, None, 0.02, note=_PAINTER),
    Published("HyperReel", 32.32, 0.899, 0.118, 289, 165, 0.91, note=_PAINTER),
    Published("FRoG", 33.28, 0.907, 0.105, 43, 111, 109.10, "frog", note=_PAINTER),
    Published("4DGS", 29.54, 0.873, 0.109),
    Published("4DGaussians", 29.62, 0.844, 0.176, 85, 27, 49.81, "hexplane"),
    Published("E-D3DGS", 33.08, 0.902, 0.110, 55, 155, 71.72, "ed3dgs"),
    Published("FRoG", 33.28, 0.907, 0.105, 58, 137, 110.15, "frog"),
)
"""FRoG's table on Technicolor, an RTX A6000 unless noted."""


def _fusion(name: str) -> dict[str, Any]:
    return {"fusion": name, "sampling": "off", "opacity_reduction": "off"}


N3DV_FUSION = (
    Published("Coarse", 30.44, 0.930, 0.059, 57, 111, 102.95, "frog", _fusion("coarse")),
    Published("Fine", 30.38, 0.927, 0.062, 59, 109, 103.35, "frog", _fusion("fine")),
    Published("Concat", 30.64, 0.932, 0.056, 58, 116, 92.03, "frog", _fusion("concat")),
    Published("Add", 30.55, 0.930, 0.057, 59, 113, 92.57, "frog", _fusion("add")),
    Published("Attention", 30.74, 0.935, 0.053, 61, 125, 69.62, "frog", _fusion("attention")),
    Published("Dual", 30.79, 0.937, 0.051, 60, 142, 49.60, "frog", _fusion("dual")),
    Published("Product", 30.76, 0.937, 0.053, 58, 111, 101.78, "frog", _fusion("product")),
    Published(
        "Product + canonical sampling",
        *(30.86, 0.939, 0.052, 60, 113, 98.87),
        method="frog",
        settings={"fusion": "product", "sampling": "anchors", "opacity_reduction": "off"},
    ),
    Published(
        "Product + canonical sampling + opacity reduction",
        *(31.01, 0.941, 0.050, 59, 111, 100.62),
        method="frog",
        settings={"fusion": "product", "sampling": "anchors", "opacity_reduction": "paper"},
    ),
)
"""FRoG's ablation on N3DV, averages over its scenes."""

N3DV_SHARPNESS = tuple(
    Published(
        f"k = {sharpness:g}",
        *(psnr, ssim, lpips),
        method="frog",
        settings={"opacity_reduction": "paper", "opacity_sharpness": sharpness}
        if sharpness
        else {"opacity_reduction": "off"},
        note="" if sharpness else "the strategy is off, not the formula with k = 0",
    )
    for sharpness, psnr, ssim, lpips in (
        (0.0, 30.86, 0.939, 0.052),
        (1.0, 30.89, 0.940, 0.052),
        (5.0, 30.93, 0.940, 0.051),
        (10.0, 31.01, 0.941, 0.050),
        (20.0, 30.80, 0.935, 0.055),
    )
)
"""FRoG's table of the opacity reduction's k, on N3DV."""

HYPERNERF_SAMPLING = (
    Published("w/o Sampling", 25.96, 0.717, 0.194, method="frog", settings={"sampling": "off"}),
    Published("Inverse Deform", 26.08, 0.718, 0.192, method="frog", settings={"sampling": "inverse"}),
    Published("Ours", 26.31, 0.721, 0.187, method="frog", settings={"sampling": "anchors"}),
)
"""FRoG's table of sampling strategies, on HyperNeRF."""

N3DV_ELSEWHERE = (
    Published("SharpTimeGS", 33.57, None, 0.031, note="RTX 4090, several hours of training; arXiv 2602.02989"),
    Published("FreeTimeGS", 33.19, None, 0.036, note="points matched between the cameras at every frame"),
    Published("TAD-GS", 32.42, note="arXiv 2606.23212"),
    Published("MAPo", 31.33, 0.944, 0.044, 65, 112, 75.64, note="RTX A6000; FRoG's protocol"),
    Published("Hybrid 3D-4DGS", 32.25, None, None, 273, 11.9, 208, note="RTX 4090"),
    Published("4DGS-1K", 31.88, None, None, 418, None, 805, note="RTX 3090"),
    Published("4DGS", 31.91, None, None, 2085, None, 90, note="RTX 3090, as run by 4DGS-1K"),
    Published("Multi4D", 32.30, None, None, 214.7, 72, 217, note="RTX 4090"),
    Published("Swift4D", 32.23, None, None, 120, None, 125),
    Published("Ex4DGS", 32.11, None, None, 115, 36, 121, note="RTX 4090"),
    Published("ST-GS", 32.05, None, None, 200, None, 140, "curves", note="six models of 50 frames for a scene"),
    Published("4D-RotorGS", 31.62, fps=277),
    Published("MEGA", 31.49, None, None, 25, None, 77),
    Published("Grid4D", 31.49, None, None, 146, None, 116),
    Published("E-D3DGS", 31.31, 0.945, 0.037, 35, None, 74, "ed3dgs", note="as quoted by 4DGS-1K"),
)
"""What other papers report on N3DV, with their own points: no ranking. Most near 32 dB average six scenes, of
flame_salmon the first 300 frames, and keep cam13 of coffee_martini; protocols alone differ by 0.3 to 1 dB."""

DNERF_LEGO = (
    Published("D3DGS", 33.07, method="d3dgs", note="arXiv 2309.13101: 800 x 800, 40,000 steps, the validation split"),
)
"""What is published on D-NeRF's lego for its validation split."""

TECHNICOLOR_ELSEWHERE = (
    Published("Multi4D", 34.30, fps=161),
    Published("Hybrid 3D-4DGS", 33.22, None, None, 218, 29),
    Published("E-D3DGS", 33.24, 0.907, 0.100, 77, 182, None, "ed3dgs"),
)
"""What other papers report on Technicolor, with their own points."""


def markdown(rows: Iterable[Published]) -> str:
    """A table in the papers' layout."""
    lines = ["| | PSNR | SSIM | LPIPS | storage, MB | training | FPS | |", "|---|" + "---:|" * 6 + "---|"]
    for row in rows:
        minutes = row.train_minutes
        cells = (
            row.title,
            f"{row.psnr:.2f}",
            "-" if row.ssim is None else f"{row.ssim:.3f}",
            "-" if row.lpips is None else f"{row.lpips:.3f}",
            "-" if row.megabytes is None else f"{row.megabytes:g}",
            "-" if minutes is None else f"{int(minutes // 60)} h {minutes % 60:02.0f} min",
            "-" if row.fps is None else f"{row.fps:g}",
            row.note,
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
