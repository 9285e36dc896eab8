// Chooses the kernels for this processor, and runs them over the pool: exported functions that have no file of their
// own.
#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <new>
#include <numeric>
#include <utility>
#include <vector>

#if defined(FROG_X86)
#include <cpuid.h>
#endif

#include "api.h"
#include "raster/frame.h"
#include "threads/thread_pool.h"

namespace {

using frog::attempt;
using frog::BAD_SIZE;
using frog::is_drawable;
using frog::kernels;

// For what the processor has and the system keeps. __builtin_cpu_supports would want a part of the compiler's library
// that Clang on Windows does not link, and in which Zig's finds nothing.
const Kernels *choose_kernels() {
#if defined(FROG_X86)
  const char *wanted = std::getenv("FROG_INSTRUCTION_SET");  // "baseline" or "avx2": for tests and measurements
  const bool any = !wanted || !*wanted;
  unsigned a, b, c, d, low, high;
  const auto all = [](unsigned bits, unsigned needed) { return (bits & needed) == needed; };
  const unsigned fma = 1u << 12, xsave = 1u << 27, avx = 1u << 28, avx2 = 1u << 5;
  const unsigned f = 1u << 16, dq = 1u << 17, bw = 1u << 30, vl = 1u << 31;
  if (!__get_cpuid(1, &a, &b, &c, &d) || !all(c, fma | xsave | avx)) return kernels_baseline();
  __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || !all(b, avx2) || !all(low, 0x6)) return kernels_baseline();
#if defined(__APPLE__)
  const bool wide = true;  // macOS keeps the wide registers from their first use on, and says so only then
#else
  const bool wide = all(low, 0xe0);
#endif
  if (wide && all(b, f | dq | bw | vl) && (any || !std::strcmp(wanted, "avx512"))) return kernels_avx512();
  if (any || std::strcmp(wanted, "baseline")) return kernels_avx2();
#endif
  return kernels_baseline();
}

constexpr size_t SPARE_BYTES = 512ull << 20;  // a larger frame's memory goes back to the system
std::mutex spare_mutex;
FrogFrame *spare[2];  // training and scrubbing at once; outlive unloading

// A frame, with the memory of a recycled one if there is one. Nobody waits here: a process forked while another thread
// was inside would wait for ever.
FrogFrame *take_frame() {
  std::unique_lock<std::mutex> lock(spare_mutex, std::try_to_lock);
  for (FrogFrame *&kept : spare)
    if (lock && kept) return std::exchange(kept, nullptr);
  return new FrogFrame;
}

// Threads write the weights of slots, which are theirs alone; each Gaussian's largest comes of its own afterwards.
void begin_weights(FrogFrame &frame) {
  const size_t slots = frame.row_instances.back();
  if (slots > UINT32_MAX) throw std::bad_alloc();
  frame.view.slot_weights = frame.slot_weights.resize(slots);
  std::fill_n(frame.view.slot_weights, slots, 0.0f);
}

void end_weights(const FrogFrame &frame, float *max_weights) {
  frog::parallel_for(frame.view.count, 4096, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const float *slot = frame.view.slot_weights + frame.slot_base[i];
      max_weights[i] = 0;
      for (uint32_t s = 0; s < frame.slot_count[i]; ++s) max_weights[i] = std::max(max_weights[i], slot[s]);
    }
  });
}

// Splats over the whole image have thousands of instances each: 60,000 of them took 2.6 GB.
constexpr uint64_t BAND_INSTANCES = 24ull << 20;  // of 8 bytes

// Has `use` look at each tile, of all of them or of a band of tile rows after another.
template <class Use>
void each_tile(FrogFrame &frame, Use use) {
  const uint64_t most = frame.in_bands ? BAND_INSTANCES : UINT64_MAX;
  for (int row = 0; row < frame.view.tiles_y;) {
    row = frog::list_tiles(frame, row, most);
    frog::parallel_each(static_cast<int>(frame.tiles.size()), [&](int t) { use(frame.tiles[t]); });
  }
}

void draw(FrogFrame &frame, const FrogGaussians &gaussians, const FrogImage &image) {
  const int count = gaussians.count;
  frame.view.splats = frame.splats.resize(count);
  frog::parallel_for(count, 1024, [&](int begin, int end) { kernels().project(frame.view, gaussians, begin, end); });
  frog::bin_splats(frame);
  if (image.max_weights) begin_weights(frame);
  if (image.radii)
    frog::parallel_for(count, 4096, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) image.radii[i] = frame.splats[i].radius;
    });
  // Whoever goes back, or asks for weights, needs all instances at once.
  frame.in_bands = !frame.view.transmittance && !image.max_weights && frame.row_instances.back() > BAND_INSTANCES;
  each_tile(frame, [&](const Tile &tile) { kernels().blend(frame.view, tile, image); });
  if (image.max_weights) end_weights(frame, image.max_weights);
}

}  // namespace

const Kernels &frog::kernels() {
  static const Kernels *chosen = choose_kernels();
  return *chosen;
}

extern "C" {

int32_t frog_abi_version(void) { return 23; }
const char *frog_instruction_set(void) { return kernels().name; }
void frog_set_thread_count(int32_t count) { frog::set_thread_count(count); }

FrogFrame *frog_draw(const FrogGaussians *gaussians, const FrogCamera *camera, const FrogOptions *options,
                     FrogImage *image, int32_t differentiable) {
  if (gaussians->count < 0 || !frog::lies_within(*camera, options->region)) return nullptr;
  FrogFrame *frame = nullptr;
  try {
    frame = take_frame();
    frame->view.camera = *camera;
    frame->view.options = *options;
    frame->view.count = gaussians->count;
    frame->view.tiles_x = (options->region[2] + TILE - 1) / TILE;
    frame->view.tiles_y = (options->region[3] + TILE - 1) / TILE;
    const size_t pixels = static_cast<size_t>(options->region[2]) * options->region[3];
    frame->view.transmittance = differentiable ? frame->transmittance.resize(pixels) : nullptr;
    frame->view.reached = differentiable ? frame->reached.resize(pixels) : nullptr;
    frame->view.slot_weights = nullptr;
    draw(*frame, *gaussians, *image);
    return frame;
  } catch (const std::bad_alloc &) {
    delete frame;
    return nullptr;
  }
}

int64_t frog_count_instances(const FrogFrame *frame) { return static_cast<int64_t>(frame->row_instances.back()); }

int32_t frog_count_pairs(FrogFrame *frame, int64_t *pairs) {
  return attempt([&] {
    std::atomic<int64_t> total{0};
    each_tile(*frame, [&](const Tile &tile) { total += kernels().count_blended(frame->view, tile); });
    *pairs = total;
  });
}

void frog_free(FrogFrame *frame) {
  if (frame && frame->bytes() <= SPARE_BYTES) {
    std::unique_lock<std::mutex> lock(spare_mutex, std::try_to_lock);
    for (FrogFrame *&kept : spare)
      if (lock && !kept) {
        kept = frame;
        return;
      }
  }
  delete frame;
}

int32_t frog_adam(const FrogAdam *parameters, int32_t count) {
  return attempt([&] {
    constexpr int64_t PIECE = 8192;  // numbers that a thread takes at a time
    std::vector<int> ends(count);    // of each parameter's pieces
    int pieces = 0;
    for (int p = 0; p < count; ++p) ends[p] = pieces += static_cast<int>((parameters[p].size + PIECE - 1) / PIECE);
    frog::parallel_each(pieces, [&](int piece) {
      const auto p = std::upper_bound(ends.begin(), ends.end(), piece) - ends.begin();
      const int64_t first = (piece - (p ? ends[p - 1] : 0)) * PIECE;
      kernels().adam(parameters[p], first, std::min<int64_t>(parameters[p].size, first + PIECE));
    });
  });
}

int32_t frog_l1_loss(const FrogL1Loss *comparison, float *absolute) {
  if (!is_drawable(comparison->width, comparison->height)) return BAD_SIZE;
  return attempt([&] {
    const FrogL1Loss &c = *comparison;
    std::vector<double> sums((c.height + FROG_CELL - 1) / FROG_CELL);
    frog::parallel_each(static_cast<int>(sums.size()), [&](int row) { sums[row] = kernels().l1_loss(c, row); });
    const double total = std::accumulate(sums.begin(), sums.end(), 0.0);
    *absolute = static_cast<float>(total / (3.0 * c.height * c.width));
  });
}

int32_t frog_ssim(int32_t height, int32_t width, const float *image, const float *truth, float *similarity,
                  float *gradient) {
  if (!is_drawable(width, height)) return BAD_SIZE;
  return attempt([&] {
    const int strips = (height + SSIM_STRIP - 1) / SSIM_STRIP;
    std::vector<double> sums(3 * static_cast<size_t>(strips));
    frog::parallel_for(3 * strips, 1, [&](int begin, int end) {
      frog::Buffer<float> scratch;
      scratch.resize(kernels().ssim_scratch(width));
      for (int job = begin; job < end; ++job) {
        const int first = job % strips * SSIM_STRIP, last = std::min(height, first + SSIM_STRIP);
        sums[job] = kernels().ssim(height, width, image, truth, job / strips, first, last, gradient, scratch.data());
      }
    });
    const double total = std::accumulate(sums.begin(), sums.end(), 0.0);
    const float share = 1 / (3.0f * height * width);
    *similarity = static_cast<float>(total) * share;
    for (long long i = 0; i < 3ll * height * width; ++i) gradient[i] *= share;
  });
}
}
