"""Images painted with numpy for the scenes of the rendered captures: every texture is a formula and a seed.

Each function returns (height, width, 3) float32, display-referred sRGB in [0, 1]; row 0 is the bottom, as in Blender.
"""

from __future__ import annotations

import numpy as np


def coordinates(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """u to the right and v upwards, both (height, width), at texel centres in (0, 1)."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return u, v


def noise(height: int, width: int, cells: int, seed: int, octaves: int = 4) -> np.ndarray:
    """(height, width) smooth noise that tiles, zero mean, about -1 .. 1; `cells` lattice cells across the width."""
    u, v = coordinates(height, width)
    total = np.zeros((height, width))
    for octave in range(octaves):
        across = cells * 2**octave
        up = max(1, round(across * height / width))
        lattice = np.random.default_rng(seed + octave).uniform(-1, 1, (up, across))
        x, y = u * across, v * up
        column, row = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = x - column, y - row
        fx, fy = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy)
        right, above = (column + 1) % across, (row + 1) % up
        lower = lattice[row, column] * (1 - fx) + lattice[row, right] * fx
        upper = lattice[above, column] * (1 - fx) + lattice[above, right] * fx
        total += (lower * (1 - fy) + upper * fy) / 2**octave
    return total


def mix(first: np.ndarray, second: tuple[float, ...] | np.ndarray, mask: np.ndarray) -> np.ndarray:
    """`first` (H, W, 3) where the mask (H, W) is 0, `second` (a colour or an image) where it is 1."""
    weight = mask.astype(float)[..., None]
    return first * (1 - weight) + np.asarray(second, dtype=float) * weight


def finish(image: np.ndarray, grain: float = 0.0, seed: int = 0) -> np.ndarray:
    """Clip to [0, 1]; `grain` adds fine noise so that flat areas still hold detail to match between views."""
    height, width = image.shape[:2]
    if grain:
        image = image + grain * noise(height, width, 24, seed, 3)[..., None]
    return np.clip(image, 0, 1).astype(np.float32)


def flat(height: int, width: int, color: tuple[float, float, float]) -> np.ndarray:
    return np.broadcast_to(np.array(color), (height, width, 3))


def bricks(seed: int = 1, rows: int = 16, columns: int = 6) -> np.ndarray:
    """A running bond: every brick has its own tone, mortar in between. Tiles."""
    size = 1024
    u, v = coordinates(size, size)
    row = np.floor(v * rows).astype(int)
    x = u * columns + 0.5 * (row % 2)
    tone = np.random.default_rng(seed).uniform(0, 1, (rows, columns))[row, np.floor(x).astype(int) % columns]
    image = mix(flat(size, size, (0.62, 0.33, 0.25)), (0.83, 0.56, 0.42), tone)
    image = image + 0.09 * noise(size, size, 24, seed)[..., None]
    mortar = (np.abs(x - np.round(x)) < 0.03) | (np.abs(v * rows - np.round(v * rows)) < 0.07)
    return finish(mix(image, (0.82, 0.79, 0.73), mortar), 0.04, seed + 9)


def planks(seed: int, color: tuple[float, float, float], count: int = 6) -> np.ndarray:
    """Wooden boards along v, with a grain of bent waves, two boards to a length. Tiles."""
    size = 1024
    u, v = coordinates(size, size)
    board = np.floor(u * count).astype(int)
    offset = np.random.default_rng(seed).uniform(0, 1, count)[board]
    along = (v + offset) % 1.0
    half = (along > 0.5).astype(int)
    tone = np.random.default_rng(seed + 1).uniform(-1, 1, (count, 2))[board, half]
    bend = noise(size, size, 3, seed + 2, 3)
    grain = np.sin(2 * np.pi * (u * count * 4 + 1.8 * bend + 3 * tone)) * 0.5 + noise(size, size, 48, seed + 3, 2) * 0.4
    image = flat(size, size, color) * (1 + 0.17 * tone + 0.11 * grain)[..., None]
    gap = (np.abs(u * count - np.round(u * count)) < 0.025) | (np.minimum(along % 0.5, 0.5 - along % 0.5) < 0.003)
    return finish(mix(image, (0.2, 0.13, 0.09), gap))


def wallpaper(base: tuple[float, float, float], wave: tuple[float, float, float], seed: int) -> np.ndarray:
    """Upright waving bands with a dot in every bay. Tiles."""
    size = 768
    u, v = coordinates(size, size)
    x = u * 6 + 0.16 * np.sin(2 * np.pi * v * 4)
    image = mix(flat(size, size, base), wave, (x % 1.0) < 0.36)
    dots = np.hypot((x % 1.0) - 0.68, ((v * 8) % 1.0) - 0.5) < 0.17
    return finish(mix(image, (0.94, 0.86, 0.6), dots), 0.06, seed)


def rug() -> np.ndarray:
    """Rings of coloured diamonds inside a checked border."""
    size = 768
    u, v = coordinates(size, size)
    reach = np.maximum(np.abs(u - 0.5), np.abs(v - 0.5)) * 2
    ring = np.floor((np.abs(u - 0.5) + np.abs(v - 0.5)) * 14).astype(int)
    palette = np.array([(0.80, 0.24, 0.20), (0.95, 0.80, 0.52), (0.16, 0.36, 0.52), (0.90, 0.56, 0.22)])
    image = palette[ring % len(palette)]
    image = mix(image, (0.13, 0.18, 0.32), ((np.floor(u * 28) + np.floor(v * 28)) % 7) == 0)
    border = (np.floor(u * 24) + np.floor(v * 24)) % 2
    frame = mix(flat(size, size, (0.16, 0.22, 0.36)), (0.93, 0.86, 0.70), border)
    return finish(mix(image, frame, reach > 0.83), 0.09, 40)


def checker(
    first: tuple[float, float, float], second: tuple[float, float, float], u_count: int, v_count: int
) -> np.ndarray:
    size = 512
    u, v = coordinates(size, size)
    return finish(mix(flat(size, size, first), second, (np.floor(u * u_count) + np.floor(v * v_count)) % 2), 0.05, 50)


def stripes(
    colors: list[tuple[float, float, float]], count: int, slant: float = 0.0, seed: int = 51, size: int = 512
) -> np.ndarray:
    """Bands along v in turn in the given colours, `slant` bands further across the width; each with its own tone."""
    u, v = coordinates(size, size)
    band = np.floor(v * count + slant * u).astype(int) % count
    tone = np.random.default_rng(seed).uniform(0.85, 1.1, count)[band]
    return finish(np.array(colors)[band % len(colors)] * tone[..., None], 0.05, seed)


def banner() -> np.ndarray:
    """Slanted stripes with a water-lily leaf in the middle and a hem."""
    size = 768
    u, v = coordinates(size, size)
    palette = np.array([(0.14, 0.30, 0.62), (0.96, 0.93, 0.84), (0.90, 0.34, 0.22), (0.97, 0.78, 0.28)])
    image = palette[np.floor((u * 1.2 + v * 1.6) * 5).astype(int) % 4]
    radius, angle = np.hypot(u - 0.5, v - 0.5), np.arctan2(v - 0.5, u - 0.5)
    leaf = (radius < 0.27) & (np.abs(angle - 0.9) > 0.25)
    image = mix(image, (0.18, 0.52, 0.26), leaf)
    image = mix(image, (0.46, 0.76, 0.38), leaf & (np.cos(angle * 14) > 0.82) & (radius > 0.05))
    hem = np.maximum(np.abs(u - 0.5), np.abs(v - 0.5)) > 0.47
    return finish(mix(image, (0.30, 0.16, 0.30), hem), 0.05, 60)


def frog_skin() -> np.ndarray:
    """The inflatable frog's body: v from the feet to the crown, u around it with the belly at u = 0.5."""
    height, width = 1024, 512
    u, v = coordinates(height, width)
    image = mix(flat(height, width, (0.27, 0.60, 0.20)), (0.45, 0.76, 0.27), np.floor(v * 14) % 2)
    image = mix(image, (0.12, 0.36, 0.15), noise(height, width, 7, 70, 2) > 0.42)
    belly = ((u - 0.5) / 0.19) ** 2 + ((v - 0.38) / 0.33) ** 2 < 1
    rings = mix(flat(height, width, (0.97, 0.90, 0.58)), (0.93, 0.66, 0.30), (v * 22) % 1.0 < 0.35)
    image = mix(image, rings, belly)
    smile = v - (0.845 + 0.9 * (u - 0.5) ** 2)
    image = mix(image, (0.50, 0.10, 0.12), (np.abs(smile) < 0.016) & (np.abs(u - 0.5) < 0.2))
    nostrils = np.hypot((np.abs(u - 0.5) - 0.03) * 1.1, v - 0.915) < 0.010
    return finish(mix(image, (0.10, 0.22, 0.10), nostrils), 0.05, 71)


def frog_arm() -> np.ndarray:
    """Rings along the arm (v from the shoulder), an orange glove at the end."""
    height, width = 512, 256
    u, v = coordinates(height, width)
    image = mix(flat(height, width, (0.24, 0.56, 0.20)), (0.90, 0.86, 0.40), (v * 9 + 0.5 * u) % 1.0 < 0.4)
    glove = mix(flat(height, width, (0.96, 0.52, 0.16)), (0.99, 0.78, 0.34), (u * 6) % 1.0 < 0.35)
    return finish(mix(image, glove, v > 0.76), 0.05, 80)


def eye() -> np.ndarray:
    """v from the back of the eye to its front: green lid, white, gold iris, black pupil."""
    height, width = 256, 64
    _, v = coordinates(height, width)
    image = mix(flat(height, width, (0.34, 0.68, 0.24)), (0.97, 0.97, 0.93), v > 0.46)
    image = mix(image, (0.93, 0.70, 0.16), v > 0.70)
    return finish(mix(image, (0.04, 0.05, 0.05), v > 0.80))


def book_spines(count: int = 16) -> np.ndarray:
    """`count` upright spines side by side, each with its own colour, bands and lettering."""
    height, width = 512, 1024
    u, v = coordinates(height, width)
    book = np.floor(u * count).astype(int)
    random = np.random.default_rng(90)
    color = np.array(
        [(0.70, 0.20, 0.18), (0.16, 0.34, 0.56), (0.88, 0.68, 0.26), (0.22, 0.48, 0.36), (0.52, 0.28, 0.50)]
    )
    image = color[np.arange(count) % len(color)][book] * random.uniform(0.75, 1.15, count)[book][..., None]
    low, high = random.uniform(0.08, 0.22, count)[book], random.uniform(0.75, 0.9, count)[book]
    image = mix(image, (0.95, 0.86, 0.60), (np.abs(v - low) < 0.025) | (np.abs(v - high) < 0.018))
    across = (u * count) % 1.0
    letters = np.random.default_rng(91).uniform(0, 1, (40, count))[np.floor(v * 40).astype(int), book] > 0.4
    written = letters & (np.abs(across - 0.5) < 0.16) & (v > 0.32) & (v < 0.66)
    return finish(mix(image, (0.96, 0.94, 0.86), written), 0.06, 92)


def landscape() -> np.ndarray:
    """The image on the wall: a low sun over rows of hills and a pond."""
    height, width = 384, 512
    u, v = coordinates(height, width)
    image = mix(flat(height, width, (0.98, 0.74, 0.42)), (0.32, 0.52, 0.78), np.clip((v - 0.35) * 1.7, 0, 1))
    image = mix(image, (1.0, 0.93, 0.66), np.hypot((u - 0.66) * 1.33, v - 0.66) < 0.12)
    for index, color in enumerate([(0.48, 0.42, 0.60), (0.30, 0.44, 0.46), (0.16, 0.36, 0.28)]):
        ridge = 0.56 - 0.13 * index + 0.07 * np.sin(2 * np.pi * u * (1.5 + index) + 2 * index)
        image = mix(image, color, v < ridge)
    ripples = 0.5 + 0.5 * np.sin(90 * v + 3 * np.sin(14 * u))
    pond = mix(flat(height, width, (0.24, 0.46, 0.62)), (0.80, 0.80, 0.72), ripples > 0.75)
    return finish(mix(image, pond, v < 0.2), 0.04, 99)
