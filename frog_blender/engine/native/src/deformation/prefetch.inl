// Memory is asked, a line at a time while numbers are multiplied, for what is worked on later: it would wait meanwhile, and
// the processor for it afterwards.

struct Nothing {
  void ask() {}
};

// Pieces of memory, one after the other. Narrow vectors take so long that nobody waits for memory.
class Ahead {
  static constexpr int MOST = 14, LINE = 16;
  const float *pieces_[MOST], *ends_[MOST], *next_ = nullptr, *end_ = nullptr;
  int count_ = 0, begun_ = 0;

  bool another() {
    if (begun_ == count_) return false;
    next_ = pieces_[begun_], end_ = ends_[begun_], ++begun_;
    return next_ < end_;
  }

 public:
  // What is read, or written, of `count` numbers; MOST times at most.
  void add(const float *from, long long count) { pieces_[count_] = from, ends_[count_] = from + count, ++count_; }
  void ask() {
    if (LANES < 8 || (next_ >= end_ && !another())) return;
    __builtin_prefetch(next_);
    next_ += LINE;
  }
  void ask_for_all() {
    while (LANES >= 8 && (next_ < end_ || begun_ < count_)) ask();
  }
};

// The deformed attributes of `count` Gaussians from `begin` on, of whose spherical harmonics rows of `colors` numbers are
// written to.
static inline void add_deformed(Ahead &ahead, const FrogDeformed &out, long long begin, int count, int colors) {
  ahead.add(out.means + 3 * begin, 3 * count), ahead.add(out.scales + 3 * begin, 3 * count);
  ahead.add(out.quaternions + 4 * begin, 4 * count), ahead.add(out.opacities + begin, count);
  if (colors) ahead.add(out.sh + colors * begin, colors * count);
}
