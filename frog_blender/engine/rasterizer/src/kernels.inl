// Everything that is compiled once for each instruction set, in a namespace of its own so that the linker can never
// mix two of them. No standard containers here: their templates would be shared between the sets.
#include <math.h>

#include "internal.h"

namespace FROG_ISA {
#include "simd.inl"
#include "mathematics.inl"
#include "projection.inl"
#include "blend.inl"
#include "network.inl"

const Kernels kernels = {FROG_ISA_NAME, project, blend, blend_backward, project_backward, network};
}  // namespace FROG_ISA
