"""A step of a tiny training, on a device and by plain torch: a GPU whose kernels are wrong trains nothing."""

import copy

import numpy as np
import torch

from ...capture.camera import Camera
from ...errors import FrogError
from ...model.canonical import CanonicalField, new_gaussians
from ...model.frog import Frog
from ...model.time_windows import keep_apart, open_windows
from ...rasterizer import RasterizeOptions
from ...recipes import RECIPES
from ...registry import METHODS, RASTERIZERS
from ..methods import ModelInit
from .densification import COLLECTED, DensificationStrategy
from .gaussian_state import GaussianState
from .losses import matte_loss
from .mattes import Truth
from .neighbours import NeighbourGraph
from .optimizer import NativeAdam

_RECIPE, _COUNT = RECIPES["draft"], 600  # more than a block has threads
_CAMERA = Camera("trial", 40, 24, np.array([[30.0, 0, 20], [0, 30, 12], [0, 0, 1]]), np.eye(4))
_BACKGROUND = 0.2, 0.4, 0.6
_MOST = 1e-3  # error, of the size of what is found


def try_step(device: torch.device) -> None:
    """Compiles and runs what a step needs; FrogError where it is not what plain torch finds in float64."""
    generator = torch.Generator().manual_seed(0)
    model, truths = _model(generator), [_truth(on) for on in (device, torch.device("cpu"))]
    exact = copy.deepcopy(model).double()
    exact.backend = RASTERIZERS["reference"]
    found, expected = _found(model.to(device), truths[0]), _found(exact, truths[1])
    # The first step of Adam has the length of the rate.
    means = model.canonical.means
    before, expected["step"] = means.detach().clone(), found["gradient of canonical.means"].sign()
    NativeAdam([{"params": [means]}], lr=1.0, eps=1e-30).step()
    found["step"] = before - means.detach()
    for name, numbers in found.items():
        wanted = expected[name].to("cpu", torch.float64)
        if not float((numbers.to(wanted) - wanted).norm()) <= _MOST * float(wanted.norm()):
            raise FrogError(f"A step's {name} on the device {device} is not what plain torch finds.")


def _model(generator: torch.Generator) -> Frog:
    """Random in everything, on the CPU."""
    points = torch.randn(_COUNT, 3, generator=generator) * torch.tensor([1.2, 0.8, 0.3]) + torch.tensor([0.0, 0, 3])
    spacings = 0.3 * torch.rand(_COUNT, generator=generator) + 0.05
    values = new_gaussians(points, torch.rand(_COUNT, 3, generator=generator), spacings, 4, _RECIPE.embedding_size)
    times = torch.arange(_COUNT) / _COUNT
    times[::2] = torch.nan
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(0)
        model: Frog = METHODS["frog"].model(ModelInit(CanonicalField(values), _RECIPE, 9, 36, 1.0, times))
    open_windows(model, times)
    for parameter in model.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=generator)
    return model


def _truth(device: torch.device) -> Truth:
    """Black or white, a third of it empty and a third of no account."""
    generator = torch.Generator().manual_seed(1)
    pixels = 255 * torch.randint(2, (24, 40, 3), generator=generator, dtype=torch.uint8)
    alpha, ignored = torch.full((24, 40), 200, dtype=torch.uint8), torch.zeros(24, 40, dtype=torch.bool)
    alpha[:8], ignored[16:], pixels[16:] = 0, True, 0
    return Truth(pixels.to(device), _BACKGROUND, alpha.to(device), ignored.to(device), empty_weight=0.3)


def _found(model: Frog, truth: Truth) -> dict[str, torch.Tensor]:
    """What a step finds, by name."""
    density = DensificationStrategy(GaussianState(model, _RECIPE, 1.0), _RECIPE, 1.0)
    for name in COLLECTED:
        getattr(density, name).zero_()
    drawn = model.draw(0.3, _CAMERA, _BACKGROUND, RasterizeOptions(weights=True))
    loss = matte_loss(drawn.image, truth, 0.5, {"square": 1.0, "dssim": 0.2}, 1.0)
    drawn.backward(loss.gradient, loss.alpha_gradient)
    density.observe(drawn.image, drawn.gaussians.opacities.detach(), _CAMERA)
    embeddings = model.canonical.embeddings
    anchors = torch.arange(_COUNT, device=embeddings.device)
    neighbours = torch.stack([3 * anchors + 1, 5 * anchors + 1], dim=1) % _COUNT
    NeighbourGraph(anchors, neighbours, embeddings.new_ones(_COUNT, 2)).add_gradient(embeddings, 0, 1e-3)
    figures = loss.figures()
    numbers = {"image": drawn.image.rgb.detach(), "loss": torch.tensor(figures.loss), "errors": figures.cell_errors}
    numbers |= {name: getattr(density, name) for name in COLLECTED}
    gradients = {name: each.grad for name, each in model.named_parameters() if each.grad is not None}
    numbers |= {f"gradient of {name}": gradient for name, gradient in gradients.items()}
    keep_apart(model)
    return numbers | {name: each.detach() for name, each in model.deformation.named_parameters()}
