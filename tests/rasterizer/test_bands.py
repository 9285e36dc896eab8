"""Splats over the whole image: the same image in bounded memory, and a sentence that it takes its time."""

import json
from pathlib import Path

import numpy as np
from support.builders import run_python

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.native import binding
from frog_blender.engine.rasterizer import GaussianArrays, RasterizeOptions

SIZE = (1352, 1014)
CAMERA = Camera("c", *SIZE, np.array([[1000, 0, 676], [0, 1000, 507], [0, 0, 1.0]]), np.eye(4))
BAND = 24 << 20  # BAND_INSTANCES of the native code


def giants(count: int, opacity: float = 0.02) -> GaussianArrays:
    """Each over every tile, except for a few that are small."""
    random = np.random.default_rng(0)
    means = np.concatenate([random.normal(0, 1, (count, 2)), random.uniform(5, 6, (count, 1))], axis=1)
    scales = np.where(np.arange(count) % 50, 8.0, 0.05)[:, None].repeat(3, axis=1)
    opacities = np.full(count, opacity)
    return GaussianArrays(means, random.normal(size=(count, 4)), scales, opacities, random.normal(size=(count, 1, 3)))


def drawn(gaussians: GaussianArrays, whole: bool) -> tuple[dict[str, np.ndarray], binding.Frame]:
    """All images of the view; with weights, which need all instances in memory at once, or without."""
    options = RasterizeOptions(depth=True, weights=whole)
    image = options.new_image(CAMERA, len(gaussians))
    return image, binding.Frame(gaussians, CAMERA, (0.1, 0.2, 0.3), options, image)


def test_bands_have_the_bits_of_the_whole_image() -> None:
    gaussians = giants(5500).checked()
    image, frame = drawn(gaussians, whole=False)
    expected, whole = drawn(gaussians, whole=True)
    assert frame.instances == whole.instances > 1.1 * BAND, "the test's own splats fit into one band"
    for name, values in image.items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)
    assert image["rgb"].std() > 0.01
    assert frame.count_pairs() == whole.count_pairs() > 0


MEASURED = f"""
import json, resource, sys, warnings
sys.path.insert(0, {str(Path(__file__).parent)!r})
from frog_blender.engine.playback.render import draw, render_image
from test_bands import CAMERA, giants
draw(giants(100), CAMERA)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
drawing = draw(giants(12_000), CAMERA)
unit = 1 if sys.platform == "darwin" else 1024
grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit
for _ in range(2):
    render_image(giants(12_000), CAMERA)
print(json.dumps([drawing.notice, grown]))
"""


def test_memory_is_bounded_and_what_takes_long_says_so_once() -> None:
    """All instances at once would be 500 MB here, and grow with every splat. The few splats drawn first are quick."""
    run = run_python(MEASURED)
    assert run.returncode == 0, run.stderr
    notice, grown = json.loads(run.stdout)
    assert grown < 320e6 < 8 * binding.MANY_INSTANCES
    assert notice.startswith("Many of the 12,000 Gaussians") and notice.endswith("takes seconds.")
    assert run.stderr.count(notice) == run.stderr.count("takes seconds") == 1
