// The pose of a camera, where it lies on the device: a differentiable pose must not cross to the host and back.
#pragma once

static __device__ __forceinline__ void take_pose(FrogCamera &camera, const float *pose) {
  if (pose)
    for (int k = 0; k < 12; ++k) camera.world_to_camera[k] = pose[k];
}
