#define FROG_ISA frog_avx512
#define FROG_ISA_NAME "avx512"
#define FROG_VECTOR_BYTES 64
#include "kernels.inl"

const Kernels *kernels_avx512() { return &FROG_ISA::kernels; }
