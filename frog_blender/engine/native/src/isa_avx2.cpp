#define FROG_ISA frog_avx2
#define FROG_ISA_NAME "avx2"
#define FROG_VECTOR_BYTES 32
#include "kernels.inl"

const Kernels *kernels_avx2() { return &FROG_ISA::kernels; }
