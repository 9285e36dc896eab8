#pragma once
#include "raster/frame.h"

namespace frog {
// Fills `result` with the gradients of the image that `frame` drew; throws std::bad_alloc.
void backward(const Kernels &kernels, FrogFrame &frame, const FrogGaussians &gaussians,
              const FrogImageGradient &gradient, const FrogGradients &result);
}  // namespace frog
