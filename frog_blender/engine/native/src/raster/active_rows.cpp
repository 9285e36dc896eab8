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

PulledRows::PulledRows(const FrogDeformation &field, const FrogDeformed &by)
    : moving_(field.num_dynamic), field_(field), by_(by) {
  places_.resize(field.count);
  const int colors = 3 * field.sh_active;
  std::atomic<int> all{0};
  parallel_for(field.count, GRAIN, [&](int begin, int end) {
    int here = 0;
    for (long long i = begin; i < end; ++i)
      here += places_[i] = by.opacities[i] != 0 || any(by.means + 3 * i, 3) || any(by.scales + 3 * i, 3) ||
                           any(by.quaternions + 4 * i, 4) || any(by.sh + colors * i, colors);
    all += here;
  });
  count_ = all;
}

void PulledRows::list() {
  rows_.reserve(count_);
  for (int i = 0; i < static_cast<int>(places_.size()); ++i) {
    const bool pulled = places_[i] != 0;
    places_[i] = pulled ? static_cast<int>(rows_.size()) : -1;
    if (pulled) rows_.push_back(i);
  }
}

float *PulledRows::room(int length) {
  memory_.push_back(std::make_unique<Buffer<float>>());
  return memory_.back()->resize(std::max<size_t>(1, rows_.size() * length));
}

const float *PulledRows::gathered(const float *from, int length) { return gathered(from, length, count()); }

const float *PulledRows::gathered(const float *from, int length, int rows) {
  float *to = room(length);
  parallel_for(rows, GRAIN, [&](int begin, int end) {
    for (long long r = begin; r < end; ++r) std::copy_n(from + static_cast<long long>(rows_[r]) * length, length, to + r * length);
  });
  return to;
}

void PulledRows::gather() {
  list();
  field_.log_scales = gathered(field_.log_scales, 3);
  field_.opacity_logits = gathered(field_.opacity_logits, 1);
  const int moving = static_cast<int>(std::lower_bound(rows_.begin(), rows_.end(), moving_) - rows_.begin());
  field_.embeddings = gathered(field_.embeddings, field_.embedding_size, moving);
  const auto moved = [&](float *from, int length) { return const_cast<float *>(gathered(from, length)); };
  by_.means = moved(by_.means, 3), by_.quaternions = moved(by_.quaternions, 4), by_.scales = moved(by_.scales, 3);
  by_.opacities = moved(by_.opacities, 1), by_.sh = moved(by_.sh, 3 * field_.sh_active);
  field_.count = count(), field_.moving = moving;
}

FrogDeformationGradients PulledRows::results(const FrogDeformationGradients &all) {
  results_ = all;
  results_.means = room(3), results_.log_scales = room(3), results_.quaternions = room(4), results_.opacity_logits = room(1);
  results_.sh = room(3 * field_.sh_count), results_.embeddings = room(field_.embedding_size);
  return results_;
}

void PulledRows::scatter(const FrogDeformationGradients &all) const {
  const struct { const float *from; float *to; long long length; } arrays[] = {
      {results_.means, all.means, 3}, {results_.log_scales, all.log_scales, 3}, {results_.quaternions, all.quaternions, 4},
      {results_.opacity_logits, all.opacity_logits, 1}, {results_.sh, all.sh, 3 * field_.sh_count}};
  const auto put = [&](int begin, int end, const float *from, float *all_rows, long long length) {
    for (int i = begin; i < end; ++i) {
      float *to = all_rows + i * length;
      if (places_[i] < 0) std::fill_n(to, length, 0.0f);
      else std::copy_n(from + places_[i] * length, length, to);
    }
  };
  parallel_for(static_cast<int>(places_.size()), GRAIN, [&](int begin, int end) {
    for (const auto &array : arrays) put(begin, end, array.from, array.to, array.length);
    put(begin, std::min(end, moving_), results_.embeddings, all.embeddings, field_.embedding_size);
  });
}

}  // namespace frog
