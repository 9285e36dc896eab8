// The order in which a graphics card blends splats.
#pragma once
#include <cstdint>

namespace frog {

// Fills `order` (count,) with the indices of the points (count, 3) whose depth plane[0..2] . point + plane[3] is finite
// and at least `nearest`, the farthest first and equal ones in their order; returns how many. Depths count as equal that
// agree to a part in 2^17, for positive `nearest`. As floats, which textures of every graphics card hold: exact up to
// 2^24.
int32_t depth_order(const float *points, int32_t count, const float plane[4], float nearest, float *order);

}  // namespace frog
