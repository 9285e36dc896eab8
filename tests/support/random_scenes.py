"""Random scenes for the rasterizer: every kind of Gaussian, camera and option, from a few numbers."""

from dataclasses import dataclass, field

import numpy as np
from hypothesis import strategies as st
from support.builders import random_gaussians, rotation_of

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.rasterizer import GaussianArrays, RasterizeOptions

NEAR = 1 / 128
"""The near plane: the same number in both precisions, so that a Gaussian can lie exactly on it."""
KINDS = ("plain", "needles", "giants", "at the near plane", "behind", "transparent", "opaque")


@dataclass(frozen=True)
class Scene:
    """Small enough to print. ``kinds`` are KINDS that the Gaussians are taken from in turn."""

    seed: int
    width: int
    height: int
    count: int
    degree: int
    kinds: tuple[str, ...]
    principal: tuple[float, float]
    turned: bool
    posed: bool
    cut: tuple[float, float, float, float] | None
    low_pass: float = 0.3
    options: RasterizeOptions = field(default_factory=RasterizeOptions)

    def camera(self) -> Camera:
        """All its numbers are float32 ones: both precisions see the same view."""
        random = np.random.default_rng(self.seed)
        center = np.array(self.principal) * [self.width, self.height]
        focal = random.uniform(20, 60, 2)
        intrinsics = np.array([[focal[0], 0, center[0]], [0, focal[1], center[1]], [0, 0, 1]], np.float32)
        pose = np.eye(4, dtype=np.float32)
        if self.turned:
            pose[:3, :3] = rotation_of(tuple(random.normal(size=3)), random.uniform(0, 3))
            pose[:3, 3] = random.normal(size=3)
        return Camera("random", self.width, self.height, intrinsics.astype(float), pose.astype(float))

    def drawing(self) -> RasterizeOptions:
        """The options, with the region in pixels."""
        region = None
        if self.cut:
            left, top = int(self.cut[0] * (self.width - 1)), int(self.cut[1] * (self.height - 1))
            size = 1 + int(self.cut[2] * (self.width - left - 1)), 1 + int(self.cut[3] * (self.height - top - 1))
            region = (left, top, *size)
        return RasterizeOptions(**{**vars(self.options), "region": region})

    def gaussians(self) -> GaussianArrays:
        random = np.random.default_rng(self.seed + 2)
        camera = self.camera()
        g = random_gaussians(camera, self.count, self.degree, self.seed)
        g.low_pass = self.low_pass
        local = g.means @ camera.rotation.T + camera.world_to_camera[:3, 3]
        for i in range(self.count):
            kind = self.kinds[i % len(self.kinds)]
            if kind == "needles":
                g.scales[i] = random.permutation([random.uniform(0.2, 1.5), *np.exp(random.uniform(-9, -3, 2))])
            elif kind == "giants":
                g.scales[i] = np.exp(random.uniform(0, 3, 3))
            elif kind == "at the near plane":
                # No two at depths that float32 might order otherwise; where the camera is turned rounding would decide
                # what lies exactly on the plane, too.
                depth = 0.9 + 2 * (i + 0.5) / self.count
                if abs(depth - 1) < 0.002:
                    depth += 0.005
                if not self.turned and random.uniform() < 0.2:
                    depth = 1.0
                local[i] *= NEAR * depth / local[i, 2]
                local[i, 2] = NEAR * depth
                g.scales[i] *= random.choice([0.001, 0.01])
            elif kind == "behind":
                local[i, 2] = -random.choice([0.0, 1e-3, 1.0]) - 1e-6 * self.turned
            elif kind == "transparent":
                g.opacities[i] = random.choice([0.0, 0.001, 0.003, 0.005, 0.01])
            elif kind == "opaque":
                g.opacities[i] = random.choice([1.0, 0.9995, 0.995])
        g.means = (local - camera.world_to_camera[:3, 3]) @ camera.rotation
        return g


def scenes() -> st.SearchStrategy[Scene]:
    share = st.floats(0, 1, width=16)
    options = st.builds(RasterizeOptions, depth=st.booleans(), weights=st.booleans(), near_plane=st.just(NEAR))
    return st.builds(
        Scene,
        low_pass=st.sampled_from([0.3, 0.1, 1.0]),
        seed=st.integers(0, 2**31 - 1),
        width=st.sampled_from([45, 64, 1, 15, 16, 17, 31, 33, 50, 59]),
        height=st.sampled_from([27, 48, 1, 15, 16, 17, 32, 33, 40]),
        count=st.integers(0, 100),
        degree=st.integers(0, 3),
        kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=4, unique=True).map(tuple),
        principal=st.tuples(st.floats(-0.5, 1.5, width=16), st.floats(-0.5, 1.5, width=16)),
        turned=st.booleans(),
        posed=st.booleans(),
        cut=st.none() | st.tuples(share, share, share, share),
        options=options,
    )
