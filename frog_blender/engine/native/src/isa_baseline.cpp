#define FROG_ISA frog_baseline
#define FROG_ISA_NAME "baseline"
#define FROG_VECTOR_BYTES 16
#include "kernels.inl"

const Kernels *kernels_baseline() { return &FROG_ISA::kernels; }
