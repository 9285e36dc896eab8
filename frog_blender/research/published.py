"""The papers' own figures, to be shown beside ours. They were measured on the papers' machines.

They are the tables of FRoG (arXiv 2603.20857), and what other papers report under their own protocols. Sizes are in
megabytes (10^6 bytes where the papers do not say), training times in minutes.
"""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """A row of a printed table; None where nothing is printed.

    Attributes:
        title: the method as it is printed.
        psnr, ssim, lpips: averages over a protocol's scenes; LPIPS with AlexNet.
        megabytes, train_minutes, fps: storage, training time and frames a second, on the paper's machine.
        note: what sets the row apart.
    """

    title: str
    psnr: float
    ssim: float | None = None
    lpips: float | None = None
    megabytes: float | None = None
    train_minutes: float | None = None
    fps: float | None = None
    note: str = ""


N3DV = (
    Published("Mix Voxels", 30.30, 0.918, 0.127, 512, 88, 1.01),
    Published("K-Planes", 30.86, 0.939, 0.096, 309, 93, 0.15),
    Published("D3DGS", 28.27, 0.917, 0.156, 75, 137, 20.29),
    Published("ST-GS", 28.94, 0.920, 0.078, 49, 265, 124, note="points of the first frame only"),
    Published("Swift4D", 30.05, 0.931, 0.055, 116, 48, 138.00),
    Published("4DGS", 30.30, 0.933, 0.069, 3600, 463, 54.36),
    Published("4DGaussians", 30.19, 0.917, 0.061, 53, 73, 78.28),
    Published("E-D3DGS", 30.79, 0.937, 0.051, 73, 161, 40.52),
    Published("FRoG", 31.01, 0.941, 0.050, 69, 116, 91.13),
)
"""FRoG's table on N3DV; storage, time and FPS on flame_salmon_frag1."""

_BROOM = "storage, time and FPS on broom with an RTX 3090"
_RTX_3090 = "storage, time and FPS with an RTX 3090"
HYPERNERF = (
    Published("HyperNeRF", 22.29, 0.598, 0.153, 15, 1965, note=f"FPS below 1; {_BROOM}"),
    Published("TiNeuVox", 24.20, 0.616, 0.393, 48, 30, 1, note=_BROOM),
    Published("FRoG", 26.31, 0.721, 0.199, 37, 57, 146.50, note=_BROOM),
    Published("DN-4DGS", 25.59, 0.691, None, 68, 72, 20, note=_RTX_3090),
    Published("FRoG", 26.31, 0.721, 0.199, 51, 88, 110.45, note=_RTX_3090),
    Published("D3DGS", 22.40, 0.598, 0.275, 195, 114, 11.54),
    Published("4DGaussians", 25.10, 0.688, 0.271, 71, 20, 100.41),
    Published("E-D3DGS", 25.92, 0.716, 0.197, 53, 110, 78.45),
    Published("FRoG", 26.31, 0.721, 0.187, 51, 81, 125.91),
)
"""FRoG's table on HyperNeRF, an RTX A6000 unless noted; its LPIPS differs between its own rows (0.187 and 0.199)."""

_PAINTER = "storage, time and FPS on Painter with an RTX 3090"
TECHNICOLOR = (
    Published("DyNeRF", 31.80, None, 0.140, 0.6, None, 0.02, note=_PAINTER),
    Published("HyperReel", 32.32, 0.899, 0.118, 289, 165, 0.91, note=_PAINTER),
    Published("FRoG", 33.28, 0.907, 0.105, 43, 111, 109.10, note=_PAINTER),
    Published("4DGS", 29.54, 0.873, 0.109),
    Published("4DGaussians", 29.62, 0.844, 0.176, 85, 27, 49.81),
    Published("E-D3DGS", 33.08, 0.902, 0.110, 55, 155, 71.72),
    Published("FRoG", 33.28, 0.907, 0.105, 58, 137, 110.15),
)
"""FRoG's table on Technicolor, an RTX A6000 unless noted."""


N3DV_FUSION = (
    Published("Coarse", 30.44, 0.930, 0.059, 57, 111, 102.95),
    Published("Fine", 30.38, 0.927, 0.062, 59, 109, 103.35),
    Published("Concat", 30.64, 0.932, 0.056, 58, 116, 92.03),
    Published("Add", 30.55, 0.930, 0.057, 59, 113, 92.57),
    Published("Attention", 30.74, 0.935, 0.053, 61, 125, 69.62),
    Published("Dual", 30.79, 0.937, 0.051, 60, 142, 49.60),
    Published("Product", 30.76, 0.937, 0.053, 58, 111, 101.78),
    Published("Product + canonical sampling", 30.86, 0.939, 0.052, 60, 113, 98.87),
    Published("Product + canonical sampling + opacity reduction", 31.01, 0.941, 0.050, 59, 111, 100.62),
)
"""FRoG's ablation on N3DV, averages over its scenes."""

N3DV_SHARPNESS = (
    Published("k = 0", 30.86, 0.939, 0.052, note="the strategy is off, not the formula with k = 0"),
    Published("k = 1", 30.89, 0.940, 0.052),
    Published("k = 5", 30.93, 0.940, 0.051),
    Published("k = 10", 31.01, 0.941, 0.050),
    Published("k = 20", 30.80, 0.935, 0.055),
)
"""FRoG's table of the opacity reduction's k, on N3DV."""

HYPERNERF_SAMPLING = (
    Published("w/o Sampling", 25.96, 0.717, 0.194),
    Published("Inverse Deform", 26.08, 0.718, 0.192),
    Published("Ours", 26.31, 0.721, 0.187),
)
"""FRoG's table of sampling strategies, on HyperNeRF."""

DNERF_LEGO = (Published("D3DGS", 33.07, note="arXiv 2309.13101: 800 x 800, 40,000 steps, the validation split"),)
"""What is published on D-NeRF's lego for its validation split."""


def markdown(rows: Iterable[Published]) -> str:
    """A table in the papers' layout."""
    lines = ["| | PSNR | SSIM | LPIPS | storage, MB | training | FPS | |", "|---|" + "---:|" * 6 + "---|"]
    for row in rows:
        minutes = row.train_minutes
        figures = ((row.psnr, ".2f"), (row.ssim, ".3f"), (row.lpips, ".3f"), (row.megabytes, "g"))
        cells = [row.title, *("-" if value is None else format(value, form) for value, form in figures)]
        cells.append("-" if minutes is None else f"{int(minutes // 60)} h {minutes % 60:02.0f} min")
        cells += ["-" if row.fps is None else f"{row.fps:g}", row.note]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
