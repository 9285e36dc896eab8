// An array that grows and never shrinks, and whose new elements are undefined: a frame's arrays are reused for the next
// frame, since fresh pages cost more than the work done in them.
#pragma once
#include <cstddef>
#include <new>
#ifdef __linux__
#include <sys/mman.h>
#endif

namespace frog {

template <class T>
class Buffer {
 public:
  Buffer() = default;
  Buffer(const Buffer &) = delete;
  Buffer &operator=(const Buffer &) = delete;
  ~Buffer() { release(); }

  // Room for `count` elements, their values undefined; throws std::bad_alloc.
  T *resize(size_t count) {
    if (count > capacity_) {
      release();
      const size_t wanted = count + count / 8;
      alignment_ = std::align_val_t(wanted * sizeof(T) < HUGE_PAGE ? 64 : HUGE_PAGE);
      data_ = static_cast<T *>(::operator new(wanted * sizeof(T), alignment_));
      capacity_ = wanted;
#ifdef __linux__
      // Gradients are written all over their array: with pages of 4 kB most of them miss the table of pages.
      if (bytes() >= HUGE_PAGE) madvise(data_, bytes(), MADV_HUGEPAGE);
#endif
    }
    return data_;
  }
  T *data() { return data_; }
  const T *data() const { return data_; }
  T &operator[](size_t i) { return data_[i]; }
  const T &operator[](size_t i) const { return data_[i]; }
  size_t bytes() const { return capacity_ * sizeof(T); }

 private:
  static constexpr size_t HUGE_PAGE = 2 << 20;
  void release() {
    ::operator delete(data_, alignment_);
    data_ = nullptr;
    capacity_ = 0;
  }

  T *data_ = nullptr;
  size_t capacity_ = 0;
  std::align_val_t alignment_{64};
};

}  // namespace frog
