// Memory is prefetcher, a line at a time while numbers are multiplied, for what is worked on later: it would wait
// meanwhile, and the processor for it afterwards.

struct NoPrefetch {
  void next() {}
};

// Pieces of memory, one after the other. Narrow vectors take so long that nobody waits for memory.
class Prefetcher {
  static constexpr int MOST = 14, LINE = 16;
  const float *pieces_[MOST], *ends_[MOST], *next_ = nullptr, *end_ = nullptr;
  int count_ = 0, begun_ = 0;

  bool advance() {
    if (begun_ == count_) return false;
    next_ = pieces_[begun_];
    end_ = ends_[begun_];
    ++begun_;
    return next_ < end_;
  }

 public:
  // What is read, or written, of `count` numbers; MOST times at most.
  void add(const float *from, long long count) { pieces_[count_] = from, ends_[count_] = from + count, ++count_; }
  void next() {
    if (LANES < 8 || (next_ >= end_ && !advance())) return;
    __builtin_prefetch(next_);
    next_ += LINE;
  }
  void finish() {
    while (LANES >= 8 && (next_ < end_ || begun_ < count_)) next();
  }
};

// The deformed attributes of `count` Gaussians from `begin` on, of whose spherical harmonics rows of `colors` numbers
// are written to.
static inline void prefetch_deformed(Prefetcher &prefetcher, const FrogDeformed &out, long long begin, int count,
                                     int colors) {
  prefetcher.add(out.means + 3 * begin, 3 * count);
  prefetcher.add(out.scales + 3 * begin, 3 * count);
  prefetcher.add(out.quaternions + 4 * begin, 4 * count);
  prefetcher.add(out.opacities + begin, count);
  if (colors) prefetcher.add(out.sh + colors * begin, colors * count);
}
