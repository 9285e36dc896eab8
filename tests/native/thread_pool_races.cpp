// Several callers and short jobs on a pool whose size changes: `make test-sanitizers` builds it with the thread
// sanitizer, which stops at a data race. Ends with 0 when every piece of every job was done once.
#include <atomic>
#include <cstdio>
#include <thread>
#include <vector>

#include "threads/thread_pool.h"

int main() {
  constexpr int CALLERS = 3, ROUNDS = 50000, LONGEST = 97, GRAINS = 5, RESIZED_EVERY = 1000;
  std::atomic<long> wrong{0};
  const auto call = [&](int caller) {
    for (int round = 0; round < ROUNDS; ++round) {
      std::vector<int> done(1 + (7 * round + caller) % LONGEST, 0);
      frog::parallel_for(static_cast<int>(done.size()), 1 + round % GRAINS, [&](int begin, int end) {
        for (int i = begin; i < end; ++i) ++done[i];
      });
      for (int times : done) wrong += times != 1;
      if (caller == 0 && round % RESIZED_EVERY == 0) frog::set_thread_count(2 + round / RESIZED_EVERY % 5);
    }
  };
  std::vector<std::thread> callers;
  for (int caller = 0; caller < CALLERS; ++caller) callers.emplace_back(call, caller);
  for (auto &caller : callers) caller.join();
  std::printf("%ld pieces were not done once\n", wrong.load());
  return wrong != 0;
}
