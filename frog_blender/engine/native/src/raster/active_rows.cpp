#include "raster/active_rows.h"

#include <algorithm>
#include <atomic>

#include "threads/thread_pool.h"

namespace frog {
namespace {

constexpr int GRAIN = 4096;

bool any(const float *values, int count) {
  bool found = false;
  for (int k = 0; k < count; ++k) found |= values[k] != 0;  // true for NaN too
  return found;
}

}  // namespace

ActiveRows::ActiveRows(const FrogDeformation &field, const FrogDeformed &by)
    : num_dynamic_(field.num_dynamic), field_(field), by_(by) {
  positions_.resize(field.count);
  const int colors = 3 * field.sh_active;
  std::atomic<int> all{0};
  parallel_for(field.count, GRAIN, [&](int begin, int end) {
    int here = 0;
    for (long long i = begin; i < end; ++i)
      here += positions_[i] = by.opacities[i] != 0 || any(by.means + 3 * i, 3) || any(by.scales + 3 * i, 3) ||
                              any(by.quaternions + 4 * i, 4) || any(by.sh + colors * i, colors);
    all += here;
  });
  count_ = all;
}

void ActiveRows::list() {
  rows_.reserve(count_);
  for (int i = 0; i < static_cast<int>(positions_.size()); ++i) {
    const bool active = positions_[i] != 0;
    positions_[i] = active ? static_cast<int>(rows_.size()) : -1;
    if (active) rows_.push_back(i);
  }
}

float *ActiveRows::allocate(int length) {
  memory_.push_back(std::make_unique<Buffer<float>>());
  return memory_.back()->resize(std::max<size_t>(1, rows_.size() * length));
}

const float *ActiveRows::gathered(const float *from, int length) { return gathered(from, length, count()); }

const float *ActiveRows::gathered(const float *from, int length, int rows) {
  float *to = allocate(length);
  parallel_for(rows, GRAIN, [&](int begin, int end) {
    for (long long r = begin; r < end; ++r)
      std::copy_n(from + static_cast<long long>(rows_[r]) * length, length, to + r * length);
  });
  return to;
}

void ActiveRows::gather() {
  list();
  field_.log_scales = gathered(field_.log_scales, 3);
  field_.opacity_logits = gathered(field_.opacity_logits, 1);
  const int num_dynamic = static_cast<int>(std::lower_bound(rows_.begin(), rows_.end(), num_dynamic_) - rows_.begin());
  field_.embeddings = gathered(field_.embeddings, field_.embedding_size, num_dynamic);
  const auto moved = [&](float *from, int length) { return const_cast<float *>(gathered(from, length)); };
  by_.means = moved(by_.means, 3);
  by_.quaternions = moved(by_.quaternions, 4);
  by_.scales = moved(by_.scales, 3);
  by_.opacities = moved(by_.opacities, 1);
  by_.sh = moved(by_.sh, 3 * field_.sh_active);
  field_.count = count();
  field_.num_dynamic = num_dynamic;
}

FrogDeformationGradients ActiveRows::results(const FrogDeformationGradients &all) {
  results_ = all;
  results_.means = allocate(3);
  results_.log_scales = allocate(3);
  results_.quaternions = allocate(4);
  results_.opacity_logits = allocate(1);
  results_.sh = allocate(3 * field_.sh_count);
  results_.embeddings = allocate(field_.embedding_size);
  return results_;
}

void ActiveRows::scatter(const FrogDeformationGradients &all) const {
  const struct {
    const float *from;
    float *to;
    long long length;
  } arrays[] = {{results_.means, all.means, 3},
                {results_.log_scales, all.log_scales, 3},
                {results_.quaternions, all.quaternions, 4},
                {results_.opacity_logits, all.opacity_logits, 1},
                {results_.sh, all.sh, 3 * field_.sh_count}};
  const auto put = [&](int begin, int end, const float *from, float *all_rows, long long length) {
    for (int i = begin; i < end; ++i) {
      float *to = all_rows + i * length;
      if (positions_[i] < 0)
        std::fill_n(to, length, 0.0f);
      else
        std::copy_n(from + positions_[i] * length, length, to);
    }
  };
  parallel_for(static_cast<int>(positions_.size()), GRAIN, [&](int begin, int end) {
    for (const auto &array : arrays) put(begin, end, array.from, array.to, array.length);
    put(begin, std::min(end, num_dynamic_), results_.embeddings, all.embeddings, field_.embedding_size);
  });
}

}  // namespace frog
