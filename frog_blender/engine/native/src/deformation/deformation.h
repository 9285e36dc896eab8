#pragma once
#include <vector>

#include "internal.h"

namespace frog {
void deform(const Kernels &kernels, const FrogDeformation &field, const FrogDeformed &result);
void deform_backward(const Kernels &kernels, const FrogDeformation &field, const FrogDeformed &by,
                     const FrogDeformationGradients &result);
}  // namespace frog
