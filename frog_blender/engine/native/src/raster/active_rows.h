// Gaussians with a nonzero gradient. A step on a part of an image reaches few of them, and for the others the
// deformation's backward pass would add up zeros.
#pragma once
#include <memory>
#include <vector>

#include "buffer.h"
#include "frog_native.h"

namespace frog {

class ActiveRows {
 public:
  ActiveRows(const FrogDeformation &field, const FrogDeformed &by);
  int count() const { return count_; }

  // The field, gradients and results of the active Gaussians alone.
  FrogDeformation field() const { return field_; }
  FrogDeformed by() const { return by_; }
  FrogDeformationGradients results(const FrogDeformationGradients &all);
  // Gathers what the backward pass reads; call it before field() and by().
  void gather();
  // Puts the results where they belong, and zero everywhere else.
  void scatter(const FrogDeformationGradients &all) const;

 private:
  void list();  // called only where gathering is worth it: else they are counted alone
  const float *gathered(const float *from, int length);
  const float *gathered(const float *from, int length, int rows);  // the first `rows` active ones
  float *allocate(int length);

  int num_dynamic_, count_ = 0;  // of all Gaussians, and active ones
  FrogDeformation field_;
  FrogDeformed by_;
  FrogDeformationGradients results_{};
  std::vector<int> rows_, positions_;  // active -> all, and all -> active (-1: not active)
  std::vector<std::unique_ptr<Buffer<float>>> memory_;
};

}  // namespace frog
