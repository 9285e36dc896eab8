// Everything that is compiled once for each instruction set, in a namespace of its own so that the linker can never
// mix two of them. No standard containers here: their templates would be shared between the sets.
#include <math.h>
#include <stddef.h>
#if defined(__SSE__)
#include <immintrin.h>
#endif

#include "internal.h"

namespace FROG_ISA {
#include "shared/adam.h"
#include "shared/projection_backward.h"
#include "simd.inl"
#include "raster/projection.inl"
#include "raster/tile.inl"
#include "raster/blend.inl"
#include "raster/blend_backward.inl"
#include "deformation/prefetch.inl"
#include "deformation/gemm.inl"
#include "deformation/activation.inl"
#include "deformation/playback_gemm.inl"
#include "deformation/playback_kernel.inl"
#include "deformation/deformation.inl"
#include "losses/ssim.inl"
#include "optimizer/adam.inl"
#include "losses/l1_loss.inl"
#include "images/tile_coding.inl"

const Kernels kernels = {FROG_ISA_NAME, project,  blend,           count_blended, blend_backward, project_backward,
                         deform,        playback, deform_backward, ssim_scratch,  ssim,           adam,
                         predict,       restore,  l1_loss};
}  // namespace FROG_ISA
