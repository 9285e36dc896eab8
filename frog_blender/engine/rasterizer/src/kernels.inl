// Everything that is compiled once for each instruction set, in a namespace of its own so that the linker can never
// mix two of them. No standard containers here: their templates would be shared between the sets.
#include <math.h>
#if defined(__SSE__)
#include <immintrin.h>
#endif

#include "internal.h"

namespace FROG_ISA {
#include "shared/mathematics.h"
#include "shared/projection.h"
#include "shared/projection_backward.h"
#include "simd.inl"
#include "projection.inl"
#include "tile.inl"
#include "blend.inl"
#include "blend_backward.inl"
#include "ahead.inl"
#include "gemm.inl"
#include "activation.inl"
#include "played_products.inl"
#include "played.inl"
#include "deformation.inl"
#include "similarity.inl"
#include "adam.inl"
#include "comparison.inl"

const Kernels kernels = {FROG_ISA_NAME, project, blend, count_blended, blend_backward, project_backward,
                         deform, play, deform_backward, similarity_scratch, similarity, adam, compare};
}  // namespace FROG_ISA
