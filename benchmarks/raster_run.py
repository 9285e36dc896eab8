"""One measurement of the rasterizer benchmark, in a process of its own (``rasterizer.py`` starts it).

    python benchmarks/raster_run.py SCENE.npz BACKEND THREADS      prints one JSON object
    python benchmarks/raster_run.py --probe BACKEND ...            prints {backend: null, or why it is absent}

A process of its own keeps the peak of memory honest, and ``FROG_INSTRUCTION_SET`` is read but once.
"""

from __future__ import annotations

import importlib.util
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from raster_scenes import Scene, load

from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import ATTRIBUTES, GaussianArrays
from frog_blender.engine.native import binding
from frog_blender.engine.native.options import RasterizeOptions

BACKENDS = ("cpu", "cuda", "gsplat", "reference")
MIN_REPEATS, MAX_REPEATS = 5, 40
ENOUGH_SECONDS = 1.0  # of measured time; what is quick is repeated more often
REFERENCE_LIMIT = 25_000_000  # pixels times Gaussians: the reference keeps about fifty bytes for each
_MEGABYTE = 1e6

Pass = Callable[[], None]


def cpu_passes(scene: Scene) -> tuple[Pass, Pass]:
    """Forward and backward of the native library itself, without torch."""
    g, image = scene.gaussians, new_image(scene)
    gradients = {name: np.empty_like(getattr(g, name)) for name in ATTRIBUTES}
    gradients["screen"] = np.empty((len(g), 2), np.float32)
    frames: list[binding.Frame] = []

    def forward() -> None:
        frames.append(binding.Frame(g, scene.camera, scene.background, RasterizeOptions(), image, differentiable=True))

    def backward() -> None:
        frames.pop().backward(scene.by_rgb, scene.by_alpha, gradients)

    return forward, backward


def new_image(scene: Scene) -> dict[str, np.ndarray]:
    """What the native library fills: see ``binding.Frame``."""
    count = len(scene.gaussians)
    return RasterizeOptions().new_image(scene.camera, count) | {"radii": np.empty(count, np.float32)}


def torch_passes(scene: Scene, backend: str) -> tuple[Pass, Pass]:
    """Forward and backward through torch: ``cuda`` and ``gsplat`` on the GPU, ``reference`` on the CPU."""
    import torch

    device = "cpu" if backend == "reference" else "cuda"
    leaves = [torch.tensor(getattr(scene.gaussians, name), device=device, requires_grad=True) for name in ATTRIBUTES]
    sent_back = [torch.tensor(array, device=device) for array in (scene.by_rgb, scene.by_alpha)]
    draw = _gsplat_drawing(scene, leaves) if backend == "gsplat" else _own_drawing(scene, leaves, backend)
    images: list[list[Any]] = []

    def forward() -> None:
        images.append(draw())
        _wait(device)

    def backward() -> None:
        for leaf in leaves:
            leaf.grad = None
        torch.autograd.backward(images.pop(), sent_back)
        _wait(device)

    return forward, backward


def _own_drawing(scene: Scene, leaves: list[Any], backend: str) -> Callable[[], list[Any]]:
    from frog_blender.engine.rasterizer import rasterize

    def draw() -> list[Any]:
        gaussians = GaussianArrays(*leaves)
        image = rasterize(gaussians, scene.camera, scene.background, backend=backend)
        return [image.rgb, image.alpha]

    return draw


def _gsplat_drawing(scene: Scene, leaves: list[Any]) -> Callable[[], list[Any]]:
    import torch
    from gsplat import rasterization

    camera, device = scene.camera, leaves[0].device
    view = torch.tensor(camera.world_to_camera, device=device, dtype=torch.float32)[None]
    intrinsics = torch.tensor(camera.intrinsics, device=device, dtype=torch.float32)[None]
    background = torch.tensor([scene.background], device=device)

    def draw() -> list[Any]:
        rgb, alpha, _ = rasterization(
            *leaves[:4],
            leaves[4],
            view,
            intrinsics,
            camera.width,
            camera.height,
            sh_degree=scene.gaussians.sh_degree,
            packed=False,
            backgrounds=background,
        )
        return [rgb[0], alpha[0, ..., 0]]

    return draw


def _wait(device: str) -> None:
    if device == "cuda":
        import torch

        torch.cuda.synchronize()


def timed(forward: Pass, backward: Pass) -> dict[str, Any]:
    """Medians and minima in seconds of at least five runs after one that is not counted, and the cores it kept busy."""
    seconds: tuple[list[float], list[float]] = [], []
    forward(), backward()
    started_all, busy = time.perf_counter(), time.process_time()
    while len(seconds[0]) < MAX_REPEATS and (len(seconds[0]) < MIN_REPEATS or sum(map(sum, seconds)) < ENOUGH_SECONDS):
        for one_pass, spent in zip((forward, backward), seconds, strict=True):
            started = time.perf_counter()
            one_pass()
            spent.append(time.perf_counter() - started)
    cores_used = (time.process_time() - busy) / (time.perf_counter() - started_all)
    return {
        "forward_s": statistics.median(seconds[0]),
        "backward_s": statistics.median(seconds[1]),
        "forward_min_s": min(seconds[0]),
        "backward_min_s": min(seconds[1]),
        "repeats": len(seconds[0]),
        "cores_used": cores_used,
    }


def resident_mb(peak: bool) -> float | None:
    """This process's memory now, or at its peak, in 10^6 bytes; None where the system does not say."""
    status, wanted = Path("/proc/self/status"), "VmHWM:" if peak else "VmRSS:"
    if status.exists():  # getrusage would count the process that started this one
        line = next(line for line in status.read_text().splitlines() if line.startswith(wanted))
        return int(line.split()[1]) * 1024 / _MEGABYTE
    if not peak or sys.platform == "win32":
        return None
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MEGABYTE  # bytes on macOS


def device_peak_gflops() -> float:
    """What the GPU reaches in a large float32 matrix product: its arithmetic peak as far as torch can show it."""
    import torch

    torch.backends.cuda.matmul.allow_tf32 = False
    size = 8192
    a = torch.rand((size, size), device="cuda")
    seconds = []
    for _ in range(6):
        started = time.perf_counter()
        torch.mm(a, a)
        torch.cuda.synchronize()
        seconds.append(time.perf_counter() - started)
    return 2e-9 * size**3 / min(seconds)


def measure(path: Path, backend: str, threads: int) -> dict[str, Any]:
    """The figures of one run; FrogError in one sentence when it cannot be made."""
    scene = load(path)
    camera, result = scene.camera, {}
    if backend == "reference" and len(scene.gaussians) * camera.width * camera.height > REFERENCE_LIMIT:
        million = REFERENCE_LIMIT // 1_000_000
        raise FrogError(f"the reference tries every Gaussian on every pixel, at most {million} million of such pairs.")
    loaded = resident_mb(peak=False)
    on_gpu = backend in ("cuda", "gsplat")
    if backend == "cpu":
        binding.set_thread_count(threads)
        result = timed(*cpu_passes(scene))
    else:
        import torch

        torch.set_num_threads(threads)
        result = timed(*torch_passes(scene, backend))
        if on_gpu:
            result["peak_device_mb"] = torch.cuda.max_memory_allocated() / _MEGABYTE
    result |= {"peak_rss_mb": resident_mb(peak=True), "loaded_rss_mb": loaded}
    if on_gpu:
        result["device_peak_gflops"] = device_peak_gflops()
    return {"isa": binding.instruction_set() if backend == "cpu" else None, **result, **work(scene)}


def work(scene: Scene) -> dict[str, Any]:
    """Gaussians drawn, (Gaussian, tile) instances and blended (Gaussian, pixel) pairs: the scene's, whoever draws.

    The native library counts them; None where there is none.
    """
    if absence("cpu"):
        return dict.fromkeys(("gaussians", "instances", "pairs"))
    image = new_image(scene)
    frame = binding.Frame(scene.gaussians, scene.camera, scene.background, RasterizeOptions(), image)
    drawn = int(np.count_nonzero(image["radii"]))
    return {"gaussians": drawn, "instances": frame.instances, "pairs": frame.count_pairs()}


def absence(backend: str) -> str | None:
    """None, or one sentence that says why the backend cannot run here."""
    if backend == "cpu":
        try:
            binding.library()
        except FrogError as error:
            return str(error)
        return None
    if importlib.util.find_spec("torch") is None:
        return "torch is not installed."
    if backend == "gsplat" and importlib.util.find_spec("gsplat") is None:
        return "gsplat is not installed."
    if backend in ("cuda", "gsplat"):
        import torch

        if not torch.cuda.is_available():
            return "torch finds no CUDA device."
    return None


def main() -> int:
    if sys.argv[1] == "--probe":
        print(json.dumps({backend: absence(backend) for backend in sys.argv[2:]}))
        return 0
    path, backend, threads = sys.argv[1:]
    try:
        print(json.dumps(measure(Path(path), backend, int(threads))))
    except (FrogError, MemoryError, RuntimeError, ValueError, OSError) as error:
        print(str(error) if isinstance(error, FrogError) else f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
