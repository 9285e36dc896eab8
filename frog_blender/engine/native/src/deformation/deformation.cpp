// The deformation field over all Gaussians: shares blocks out to the threads, and adds the chunks' weight gradients in
// a fixed order.
#include <algorithm>
#include <deque>
#include <vector>

#include "api.h"
#include "buffer.h"
#include "deformation/plan.h"
#include "threads/thread_pool.h"

namespace frog {
namespace {

void unpack(const float *from, long long rows, long long row_length, long long columns, float *to,
            long long to_length) {
  for (long long r = 0; r < rows; ++r) std::copy_n(from + r * row_length, columns, to + r * to_length);
}

void unpack_gradients(const DeformationPlan &plan, const DeformationLayout &l, const float *sum,
                      const FrogDeformationGradients &result) {
  for (long long n = 0; n < plan.networks; ++n) {
    unpack(sum + l.weight_embedding + n * l.hidden * l.embedding, plan.hidden, l.embedding, plan.embedding,
           result.embedding_weight + n * plan.hidden * plan.embedding, plan.embedding);
    std::copy_n(sum + l.weight_shared + n * l.hidden, plan.hidden, result.shared + n * plan.hidden);
    const long long inputs = plan.branches[0].inputs;
    unpack(sum + l.weight_output + n * padded(inputs), plan.outputs, l.weight_output_row, inputs,
           result.output_weight + n * inputs, plan.networks * inputs);
    if (!plan.heads) continue;
    unpack(sum + l.weight_head + n * plan.heads * l.hidden, plan.heads, l.hidden, plan.hidden,
           result.head_weight + n * plan.heads * plan.hidden, plan.hidden);
    std::copy_n(sum + l.bias_head + n * l.heads, plan.heads, result.head_bias + n * plan.heads);
  }
  std::copy_n(sum + l.bias_output, plan.outputs, result.output_bias);
}

// Each thread's own, kept from chunk to chunk and call to call.
float *thread_scratch(size_t length) {
  static thread_local Buffer<float> scratch;
  return scratch.resize(length);
}

// Chunks of so many Gaussians that all move, then chunks of Gaussians at rest.
template <class Work>
void in_chunks(const FrogDeformation &field, int size, const Work &work) {
  parallel_for(field.num_dynamic, size, work);
  const int first = field.num_dynamic;
  parallel_for(field.count - first, size, [&](int begin, int end) { work(first + begin, first + end); });
}

void backward_of_all(const FrogDeformation &field, const FrogDeformed &by, const FrogDeformationGradients &result) {
  const Packed packed = plan_of(field, true);
  const DeformationPlan &plan = packed.plan;
  const DeformationLayout l = layout_of(plan);
  const long long chunks = (field.num_dynamic + DEFORM_CHUNK - 1) / DEFORM_CHUNK;
  Buffer<float> partials;
  partials.resize(std::max(1ll, chunks) * l.partial);
  std::fill_n(partials.data(), l.partial, 0.0f);  // the sum, where there is no chunk
  in_chunks(field, DEFORM_CHUNK, [&](int begin, int end) {
    float *mine = begin < field.num_dynamic ? partials.data() + begin / DEFORM_CHUNK * l.partial : nullptr;
    if (mine) std::fill_n(mine, l.partial, 0.0f);
    kernels().deform_backward(plan, by, result, begin, end, thread_scratch(l.scratch), mine);
  });
  float *sum = partials.data();
  for (long long chunk = 1; chunk < chunks; ++chunk)
    for (long long k = 0; k < l.partial; ++k) sum[k] += partials[chunk * l.partial + k];
  unpack_gradients(plan, l, sum, result);
}

constexpr int GRAIN = 4096;  // Gaussians that a thread takes at a time where they are only copied

bool any(const float *values, int count) {
  bool nonzero = false;
  for (int k = 0; k < count; ++k) nonzero |= values[k] != 0;  // true for NaN too
  return nonzero;
}

// The Gaussians with a nonzero gradient.
std::vector<int> active_rows(const FrogDeformation &field, const FrogDeformed &by) {
  const int colors = 3 * field.sh_active;
  std::vector<char> active(field.count);
  parallel_for(field.count, GRAIN, [&](int begin, int end) {
    for (long long i = begin; i < end; ++i)
      active[i] = by.opacities[i] != 0 || any(by.means + 3 * i, 3) || any(by.scales + 3 * i, 3) ||
                  any(by.quaternions + 4 * i, 4) || any(by.sh + colors * i, colors);
  });
  std::vector<int> rows(field.count);
  int found = 0;
  for (int i = 0; i < field.count; found += active[i++]) rows[found] = i;
  rows.resize(found);
  return rows;
}

// The backward pass of the active Gaussians alone; the others' gradients are zero. A step on a part of an image reaches
// few of them, and for the others the backward pass would add up zeros.
void backward_of_active(const FrogDeformation &field, const FrogDeformed &by, const FrogDeformationGradients &result,
                        const std::vector<int> &rows) {
  const int count = static_cast<int>(rows.size());
  std::vector<int> positions(field.count, -1);  // of all among the active ones; -1: not active
  for (int r = 0; r < count; ++r) positions[rows[r]] = r;
  std::deque<Buffer<float>> memory;
  const auto allocate = [&](long long length) {
    return memory.emplace_back().resize(std::max<size_t>(1, rows.size() * length));
  };
  const auto gathered = [&](const float *from, long long length, int some) {
    float *to = allocate(length);
    parallel_for(some, GRAIN, [&](int begin, int end) {
      for (long long r = begin; r < end; ++r) std::copy_n(from + rows[r] * length, length, to + r * length);
    });
    return to;
  };
  FrogDeformation own = field;
  own.count = count;
  own.num_dynamic = static_cast<int>(std::lower_bound(rows.begin(), rows.end(), field.num_dynamic) - rows.begin());
  own.log_scales = gathered(field.log_scales, 3, count);
  own.opacity_logits = gathered(field.opacity_logits, 1, count);
  own.embeddings = gathered(field.embeddings, field.embedding_size, own.num_dynamic);
  const FrogDeformed own_by = {gathered(by.means, 3, count),
                               gathered(by.quaternions, 4, count),
                               gathered(by.scales, 3, count),
                               gathered(by.opacities, 1, count),
                               gathered(by.sh, 3 * field.sh_active, count),
                               nullptr};
  using Gradients = FrogDeformationGradients;
  const struct {
    float *Gradients::*array;
    long long length;
    int count;
  } parts[] = {{&Gradients::means, 3, field.count},
               {&Gradients::log_scales, 3, field.count},
               {&Gradients::quaternions, 4, field.count},
               {&Gradients::opacity_logits, 1, field.count},
               {&Gradients::sh, 3 * field.sh_count, field.count},
               {&Gradients::embeddings, field.embedding_size, field.num_dynamic}};
  Gradients own_result = result;
  for (const auto &part : parts) own_result.*part.array = allocate(part.length);
  backward_of_all(own, own_by, own_result);
  parallel_for(field.count, GRAIN, [&](int begin, int end) {
    for (const auto &part : parts)
      for (int i = begin; i < std::min(end, part.count); ++i) {
        float *to = result.*part.array + i * part.length;
        if (positions[i] < 0)
          std::fill_n(to, part.length, 0.0f);
        else
          std::copy_n(own_result.*part.array + positions[i] * part.length, part.length, to);
      }
  });
}

}  // namespace
}  // namespace frog

extern "C" {

int32_t frog_deform(const FrogDeformation *field, const FrogDeformed *result) {
  return frog::attempt([&] {
    const frog::Packed packed = frog::plan_of(*field, false);
    const DeformationLayout layout = layout_of(packed.plan);
    const auto kernel = field->groups ? frog::kernels().playback : frog::kernels().deform;
    // Nothing is added up: as small as the threads can share best.
    frog::in_chunks(*field, field->groups ? PLAYBACK_CHUNK : DEFORM_BLOCK, [&](int begin, int end) {
      kernel(packed.plan, *result, begin, end, frog::thread_scratch(layout.forward));
    });
  });
}

int32_t frog_deform_backward(const FrogDeformation *field, const FrogDeformed *gradients,
                             const FrogDeformationGradients *result) {
  return frog::attempt([&] {
    const std::vector<int> rows = frog::active_rows(*field, *gradients);
    if (static_cast<int>(rows.size()) > field->count / 4 * 3)
      frog::backward_of_all(*field, *gradients, *result);
    else
      frog::backward_of_active(*field, *gradients, *result, rows);
  });
}
}
