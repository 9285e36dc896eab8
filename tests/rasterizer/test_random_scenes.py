"""The native library against the reference in float64 on hundreds of random scenes of every kind.

Pictures: where float32 decides a threshold the other way a whole contribution appears or goes, which no tolerance can
hide. Such pixels ("flips", beyond FLIP) are counted over all scenes together and must be very rare; all others are held
to a mean error. A single scene may hold a few more of them than its share.

Gradients: compared where no pixel flipped, that is where the pictures agree within AGREEMENT everywhere. The tolerance
is 1e-5 and, for scenes that are ill-conditioned in float32 (a Gaussian one hundredth of a unit before a camera that
stands one unit from the origin has lost two digits before anything is drawn), a few times what the reference's own
gradients change by when its input and its picture are rounded to float32 the other way. The picture, because the
backward pass takes what lies behind each Gaussian from it: a part d of what a pixel sends back that is lost in rounding
adds d alpha / (1 - alpha) to dL/d(log alpha) of every Gaussian there, which is the gradient of -d log(1 - coverage).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from drawing import BACKGROUND, cut, draw_with_gradients, image_weights, relative_error, tensors
from helpers import ATTRIBUTES
from hypothesis import HealthCheck, given, settings
from random_scenes import Scene, scenes

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.rasterizer import GaussianArrays, RasterizeOptions, rasterize

EXAMPLES = 500
FLIP, FLIPPED_SHARE, FLIPS_IN_ONE = 1e-4, 3e-4, 8
MEAN_ERROR = 1e-6
AGREEMENT = 1e-5
GRADIENT_ERROR, CONDITION = 1e-5, 16.0
LAST_PLACE = 2.0**-24


@dataclass
class Totals:
    scenes: int = 0
    pixels: int = 0
    error: float = 0.0
    flips: int = 0
    compared: int = 0


def rounded_otherwise(gaussians: GaussianArrays, camera: Camera, seed: int) -> GaussianArrays:
    """The same with every number moved by half a unit in the last place; means by that of the camera's distance, since
    their transformation rounds at that size. For float64 only."""
    random = np.random.default_rng(seed)
    reach = np.abs(gaussians.means).sum(1, keepdims=True) + np.abs(camera.world_to_camera[:3, 3]).max()
    changed = {}
    for name in ATTRIBUTES:
        values = np.asarray(getattr(gaussians, name), np.float32).astype(np.float64)
        size = reach if name == "means" else np.abs(values)
        changed[name] = values + LAST_PLACE * size * random.choice([-1.0, 1.0], values.shape)
    return GaussianArrays(**changed)


def rounded_gradients(
    gaussians: GaussianArrays,
    camera: Camera,
    options: RasterizeOptions,
    seed: int,
    pose: np.ndarray | None,
    depth_limit: torch.Tensor | None,
) -> dict[str, np.ndarray]:
    """As ``draw_with_gradients``, in float64 throughout, of a picture that is rounded otherwise (see above)."""
    leaves = tensors(gaussians, torch.float64, exact=True)
    moving = None if pose is None else torch.tensor(pose, requires_grad=True)
    image = rasterize(
        leaves, camera, BACKGROUND, options, pose=moving, depth_limit=depth_limit, implementation="reference"
    )
    by_rgb, by_alpha = (cut(weights, options.region_of(camera)) for weights in image_weights(camera))
    sent_back = (image.rgb * by_rgb).sum(-1) + image.alpha * by_alpha
    size = LAST_PLACE * ((image.rgb * by_rgb).abs().sum(-1) + by_alpha.abs() * (1 - image.alpha)).detach()
    signs = torch.randint(0, 2, size.shape, generator=torch.Generator().manual_seed(seed)) * 2 - 1
    (sent_back + size * signs * torch.log(1 - image.alpha)).sum().backward()
    gradients = {name: getattr(leaves, name).grad.numpy() for name in ATTRIBUTES}
    gradients["screen"] = image.screen.grad.numpy()
    if moving is not None:
        gradients["pose"] = moving.grad.numpy()
    if image.screen_absolute is not None:
        gradients["screen_absolute"] = image.screen_absolute.numpy()
    return gradients


def compare(scene: Scene, totals: Totals) -> None:
    camera, gaussians, options = scene.camera(), scene.gaussians(), scene.drawing()
    more = {"pose": camera.world_to_camera if scene.posed else None, "depth_limit": scene.depth_limit()}
    image, found = draw_with_gradients(gaussians, camera, "cpu", options=options, **more)
    reference, expected = draw_with_gradients(gaussians, camera, "reference", torch.float64, options, **more)
    for name, gradient in found.items():
        assert np.isfinite(gradient).all(), name
    assert image.at_fault == reference.at_fault == 0
    difference = (image.rgb.detach() - reference.rgb.detach()).abs()
    alpha_difference = (image.alpha.detach() - reference.alpha.detach()).abs()
    flips = int((difference.amax(-1) > FLIP).sum())
    assert flips <= FLIPS_IN_ONE
    totals.scenes += 1
    totals.pixels += image.alpha.numel()
    totals.error += float(difference.mean(-1).sum())
    totals.flips += flips
    if max(float(difference.max()), float(alpha_difference.max())) > AGREEMENT:
        return
    totals.compared += 1
    allowed = dict.fromkeys(expected, 0.0)
    if any(relative_error(found[name], expected[name]) > GRADIENT_ERROR for name in expected):
        for seed in (1, 2):
            other = rounded_otherwise(gaussians, camera, seed)
            elsewhere = rounded_gradients(other, camera, options, seed, **more)
            allowed = {n: max(allowed[n], CONDITION * relative_error(elsewhere[n], expected[n])) for n in expected}
    for name, gradient in expected.items():
        assert relative_error(found[name], gradient) <= GRADIENT_ERROR + allowed[name], name


def test_random_scenes() -> None:
    totals = Totals()

    @settings(
        max_examples=EXAMPLES, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(scenes())
    def look(scene: Scene) -> None:
        compare(scene, totals)

    look()
    assert totals.scenes >= EXAMPLES
    assert totals.compared >= 0.85 * totals.scenes
    assert totals.error / totals.pixels <= MEAN_ERROR
    assert totals.flips <= FLIPPED_SHARE * totals.pixels
