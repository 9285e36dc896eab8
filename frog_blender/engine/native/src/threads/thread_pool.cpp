#include "threads/thread_pool.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <memory>
#include <mutex>
#include <new>
#include <thread>
#include <utility>
#include <vector>

#if defined(__SSE__)
#include <xmmintrin.h>
#endif
#if !defined(_WIN32)
#include <pthread.h>
#endif

namespace frog {
namespace {

// Denormal numbers cost 15 to 20 times more; flush them here and give the caller's setting back afterwards.
class FlushDenormals {
#if defined(__SSE__)
  unsigned saved_ = _mm_getcsr();

 public:
  FlushDenormals() { _mm_setcsr(saved_ | 0x8040); }
  ~FlushDenormals() { _mm_setcsr(saved_); }
#elif defined(__aarch64__)
  unsigned long saved_;

 public:
  FlushDenormals() {
    asm volatile("mrs %0, fpcr" : "=r"(saved_));
    asm volatile("msr fpcr, %0" ::"r"(saved_ | (1ul << 24)));
  }
  ~FlushDenormals() { asm volatile("msr fpcr, %0" ::"r"(saved_)); }
#endif
};

inline void pause() {
#if defined(__SSE__)
  _mm_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#endif
}

struct Job {
  const std::function<void(int, int)> *work;
  int count, grain;
  std::atomic<int> next{0};
  std::atomic<bool> out_of_memory{false};

  void run() {
    FlushDenormals flush;
    try {
      for (int begin; (begin = next.fetch_add(grain)) < count;) (*work)(begin, std::min(begin + grain, count));
    } catch (const std::bad_alloc &) {  // must not leave a worker thread
      out_of_memory = true;
    }
  }
};

// Whether `true_now` becomes true before it is worth sleeping: a drawing is a dozen calls a fraction of a millisecond
// apart, and waking a sleeping thread takes 0.1 ms, on virtual machines 0.3. Threads with work of their own go first.
template <class Condition>
bool soon(Condition true_now) {
  constexpr auto PATIENCE = std::chrono::microseconds(300);
  const auto start = std::chrono::steady_clock::now();
  do {
    for (int i = 0; i < 64; ++i) {
      if (true_now()) return true;
      pause();
    }
    std::this_thread::yield();
  } while (std::chrono::steady_clock::now() - start < PATIENCE);
  return false;
}

class Pool {
 public:
  const int workers;  // that were asked for: the system may give fewer

  explicit Pool(int workers) : workers(workers) {
    try {
      for (int i = 0; i < workers; ++i) threads_.emplace_back([this] { loop(); });
    } catch (const std::exception &) {
    }
  }
  ~Pool() {
    stop_ = true;
    wake_all();
    for (auto &thread : threads_) thread.join();
  }

  // Waits for the workers that came, not for those that did not: where other programs keep the cores busy a thread is
  // given one only after milliseconds, and all pieces have long been taken by then.
  void run(Job &job) {
    job_ = &job;
    state_ = (generation(state_) + 1) << GENERATION | OPEN;
    wake_all();
    job.run();
    state_ &= ~OPEN;
    const auto finished = [this] { return (state_ & INSIDE) == 0; };
    if (soon(finished)) return;
    std::unique_lock<std::mutex> lock(mutex_);
    done_.wait(lock, finished);
  }

 private:
  // One number for all that workers and caller agree on: how many jobs there were, whether the last one may still be
  // joined, and how many workers are inside.
  using State = std::uint64_t;
  static constexpr int GENERATION = 32;
  static constexpr State OPEN = State{1} << 31, INSIDE = OPEN - 1;
  static State generation(State state) { return state >> GENERATION; }

  void loop() {
    State seen = 0;
    const auto called = [&] { return stop_ || generation(state_) != seen; };
    for (;;) {
      if (!soon(called)) {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, called);
      }
      if (stop_) return;
      State state = state_;
      seen = generation(state);
      if (!joined(state)) continue;
      job_->run();
      if ((--state_ & (OPEN | INSIDE)) != 0) continue;
      {
        std::lock_guard<std::mutex> lock(mutex_);
      }  // not between the caller's look and its sleep
      done_.notify_one();
    }
  }

  // Whether the job of `state` could be joined; from then on its caller waits.
  bool joined(State state) {
    const State job = generation(state);
    while ((state & OPEN) && generation(state) == job)
      if (state_.compare_exchange_weak(state, state + 1)) return true;
    return false;
  }

  void wake_all() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
    }
    wake_.notify_all();
  }

  std::vector<std::thread> threads_;
  std::mutex mutex_;
  std::condition_variable wake_, done_;
  Job *job_ = nullptr;
  std::atomic<State> state_{0};
  std::atomic<bool> stop_{false};
};

std::mutex pool_mutex;  // held while a job runs
std::atomic<int> wanted{0};
// Leaked on purpose: joining threads while a process unloads its libraries can hang it.
Pool *pool = nullptr;

#if !defined(_WIN32)
// A forked child has the pool but not its threads; it starts a new one.
const int fork_handlers = pthread_atfork([] { pool_mutex.lock(); }, [] { pool_mutex.unlock(); },
                                         [] {
                                           pool = nullptr;
                                           pool_mutex.unlock();
                                         });
#endif

}  // namespace

void set_thread_count(int count) { wanted = std::max(0, count); }

void parallel_for(int count, int grain, const std::function<void(int, int)> &work) {
  // Asked once: on Linux the answer is read from a file, which takes as long as some hundred Gaussians.
  static const int cores = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  Job job{&work, count, std::max(1, grain)};
  const int threads = wanted > 0 ? wanted.load() : cores;
  std::unique_lock<std::mutex> lock(pool_mutex, std::try_to_lock);
  if (lock && threads > 1 && count > job.grain) {
    if (pool && pool->workers != threads - 1) delete std::exchange(pool, nullptr);
    if (!pool) pool = new Pool(threads - 1);
    pool->run(job);
  } else {
    job.run();
  }
  if (job.out_of_memory) throw std::bad_alloc();
}

}  // namespace frog
