// The Gaussians that an image pulls at: those with a gradient that is not zero. A step that draws a part of an image
// sees few of them, and for the others the deformation's backward pass would add up zeros.
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

  // The same field, gradients and places for results, of the active Gaussians alone.
  FrogDeformation field() const { return field_; }
  FrogDeformed by() const { return by_; }
  FrogDeformationGradients results(const FrogDeformationGradients &all);
  // Gathers what the backward pass reads; call it before field() and by().
  void gather();
  // Puts the results where they belong, and zero everywhere else.
  void scatter(const FrogDeformationGradients &all) const;

 private:
  void list();  // one after the other: where it would not be worth it they are only counted
  const float *gathered(const float *from, int length);
  const float *gathered(const float *from, int length, int rows);  // the first so many of the active
  float *allocate(int length);

  int num_dynamic_, count_ = 0;  // those that move of all, and the active
  FrogDeformation field_;
  FrogDeformed by_;
  FrogDeformationGradients results_{};
  std::vector<int> rows_, positions_;  // of the active among all, and of all among the active (-1: none)
  std::vector<std::unique_ptr<Buffer<float>>> memory_;
};

}  // namespace frog
