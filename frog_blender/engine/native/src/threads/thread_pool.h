// The library's own threads: one pool, one job at a time; a caller who finds it busy works alone.
#pragma once
#include <functional>

namespace frog {
void set_thread_count(int count);  // 0: one for each core
// Calls work(begin, end) over [0, count) in pieces of `grain`, on all threads and the caller's. Blocks until done;
// throws std::bad_alloc when any piece did.
void parallel_for(int count, int grain, const std::function<void(int, int)> &work);
// The same for each number below `count`, one by one.
template <class Use>
void parallel_each(int count, const Use &use) {
  parallel_for(count, 1, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) use(i);
  });
}
}  // namespace frog
