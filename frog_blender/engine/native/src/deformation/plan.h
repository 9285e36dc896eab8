#pragma once
#include <vector>

#include "deformation/types.h"

namespace frog {

using Memory = std::vector<std::vector<float>>;

// A plan and what it points to.
struct Packed {
  Memory memory;
  DeformationPlan plan{};
};

// `backward`: with what a backward pass needs.
Packed plan_of(const FrogDeformation &field, bool backward);

}  // namespace frog
