"""What a field's kernels give, and gradients of everything, beside plain torch in float64."""

import copy

import numpy as np
import torch
from support.torch_drawing import relative_error

from frog_blender.engine.model.frog import Frog
from frog_blender.engine.model.interface import ScheduleState

OUTPUTS = ("means", "quaternions", "scales", "opacities", "sh")
TIME = 0.37


def gradients_by(model: Frog, state: ScheduleState, pulled: float, kernels: bool) -> dict[str, np.ndarray]:
    """Results and gradients of a random linear loss by name, where all but a share ``pulled`` of the Gaussians have no
    gradient."""
    random = torch.Generator().manual_seed(3)
    if kernels:
        _, field, gaussians, changes = model.deform_fused(TIME, state)
    else:
        gaussians, parts = model.deform_reference(model.temporal_embedding(TIME, state), state)
        changes = torch.cat([part.flatten(1) for part in parts.values()], 1)
    seen = torch.rand(len(gaussians), generator=random) < pulled
    outputs = {name: getattr(gaussians, name) for name in OUTPUTS}
    by = {name: torch.randn(output.shape, generator=random).to(output) for name, output in outputs.items()}
    for gradient in by.values():
        gradient[~seen] = 0
    if kernels:
        gradients = field.backward(by)
    else:
        torch.autograd.backward(list(outputs.values()), list(by.values()))
        gradients = {name.split(".")[-1]: value.grad for name, value in model.named_parameters()}
    values = {f"drawn {name}": output for name, output in (outputs | {"changes": changes}).items()}
    return {name: value.detach().cpu().numpy() for name, value in (values | gradients).items()}


def assert_as_reference(
    model: Frog, state: ScheduleState, pulled: float = 1.0, error: float = 1e-5
) -> dict[str, np.ndarray]:
    """What the kernels gave. Where units are many, some are so close to zero that rounding decides whether they pass a
    gradient, and the ``error`` is larger."""
    found = gradients_by(model, state, pulled, True)
    double = copy.deepcopy(model).cpu().double()
    expected = gradients_by(double, state, pulled, False)
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name].shape == values.shape and found[name].dtype == np.float32, name
        assert relative_error(found[name], values) < error, name
    return found
