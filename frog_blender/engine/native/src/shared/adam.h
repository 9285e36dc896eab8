// Adam (Kingma and Ba, algorithm 1), on the CPU and on a GPU.
#pragma once
#include "types.h"

// One number of one parameter. Memory is what this waits for: each number is read and written once.
FROG_FUNCTION void adam_step(const FrogAdam &p, long long i) {
  const float gradient = p.gradients[i];
  const float first = p.first[i] + p.first_share * (gradient - p.first[i]);
  const float second = p.second[i] + p.second_share * (gradient * gradient - p.second[i]);
  p.values[i] -= p.rate * first / (sqrtf(second) * p.second_scale + p.epsilon);
  p.first[i] = first;
  p.second[i] = second;
}
