// All Gaussians to the screen, and back.

static void project(const FrameView &view, const FrogGaussians &g, int begin, int end) {
  for (int i = begin; i < end; ++i) make_splat(g, view.camera, view.options, i, view.splats[i]);
}

static void project_backward(const FrameView &view, const FrogGaussians &g, const float *sums, const FrogGradients &out,
                             float *pose, int begin, int end) {
  for (int i = begin; i < end; ++i)
    if (view.splats[i].radius > 0)
      splat_backward(g, view.camera, view.options, i, sums + static_cast<long long>(i) * SPLAT_GRADIENTS, out, pose);
    else
      no_gradient(g, out, i);
}
