// The deformation field over all Gaussians: shares blocks out to the threads, and adds the chunks' weight gradients in
// a fixed order.
#include <algorithm>

#include "api.h"
#include "buffer.h"
#include "deformation/plan.h"
#include "raster/active_rows.h"
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

void backward_of_all(const Kernels &kernels, const FrogDeformation &field, const FrogDeformed &by,
                     const FrogDeformationGradients &result) {
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
    kernels.deform_backward(plan, by, result, begin, end, thread_scratch(l.scratch), mine);
  });
  float *sum = partials.data();
  for (long long chunk = 1; chunk < chunks; ++chunk)
    for (long long k = 0; k < l.partial; ++k) sum[k] += partials[chunk * l.partial + k];
  unpack_gradients(plan, l, sum, result);
}

}  // namespace

void deform(const Kernels &kernels, const FrogDeformation &field, const FrogDeformed &result) {
  const Packed packed = plan_of(field, false);
  const DeformationLayout layout = layout_of(packed.plan);
  const auto kernel = field.groups ? kernels.playback : kernels.deform;
  const int size =
      field.groups ? PLAYBACK_CHUNK : DEFORM_BLOCK;  // nothing is added up: as small as the threads can share best
  in_chunks(field, size,
            [&](int begin, int end) { kernel(packed.plan, result, begin, end, thread_scratch(layout.forward)); });
}

void deform_backward(const Kernels &kernels, const FrogDeformation &field, const FrogDeformed &by,
                     const FrogDeformationGradients &result) {
  ActiveRows active(field, by);
  if (active.count() > field.count / 4 * 3) return backward_of_all(kernels, field, by, result);
  active.gather();
  backward_of_all(kernels, active.field(), active.by(), active.results(result));
  active.scatter(result);
}

}  // namespace frog
