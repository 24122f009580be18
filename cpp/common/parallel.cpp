#include "common/parallel.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <exception>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "common/processors.h"

#if defined(__unix__) || defined(__APPLE__)
#include <pthread.h>
#endif

namespace segloc {
namespace {

constexpr int kMostThreads = 256;
// Time that a caller spins for the last chunks before it sleeps. Waking up takes as long, and on a
// busy machine a thousand times longer.
constexpr std::chrono::microseconds kWatched{50};

using Clock = std::chrono::steady_clock;

// One call of parallel_for: workers take chunks from `next` until none is left.
struct Job {
  const std::function<void(std::size_t, std::size_t, int)>* body;
  std::size_t count;
  std::size_t grain;
  std::atomic<std::size_t> next{0};
  std::atomic<int> next_worker{1};  // the caller is worker 0
  std::atomic<int> busy{0};         // helpers that may be in the body
  std::exception_ptr error;
  std::mutex error_mutex;

  // Takes one chunk: how many items it was; 0 where none is left.
  std::size_t step(int worker) {
    const std::size_t begin = next.fetch_add(grain);
    if (begin >= count) return 0;
    const std::size_t end = std::min(begin + grain, count);
    try {
      (*body)(begin, end, worker);
    } catch (...) {
      const std::lock_guard<std::mutex> lock(error_mutex);
      if (!error) error = std::current_exception();
      next.store(count);
    }
    return end - begin;
  }
  // A late helper is not waited for: it finds no chunk and leaves.
  bool help(int worker) {
    ++busy;
    const bool taken = step(worker) > 0;
    --busy;
    return taken;
  }
  // For the caller, once no chunk is left.
  bool done() const { return busy.load() == 0; }
};

// Decides whether to call helpers. On a busy machine a helper may be preempted within its chunk,
// and the caller then waits for longer than the chunk takes. Callers then work alone for a while,
// each time twice as long, until helpers are useful again.
class Usefulness {
 public:
  bool is_doubtful() const { return Clock::now().time_since_epoch().count() < alone_until_.load(); }

  // What a call took, of which the caller did `own` of `all` items in `worked`.
  void see(std::size_t own, std::size_t all, Clock::duration worked, Clock::duration elapsed) {
    if (elapsed < kShort || own == 0) return;
    const double alone = double(worked.count()) * double(all) / double(own);
    const Clock::rep pause = pause_.load();
    if (double(elapsed.count()) < kHelpful * alone) {
      pause_.store(std::max(pause / 2, kShortest));
      return;
    }
    alone_until_.store(Clock::now().time_since_epoch().count() + pause);
    pause_.store(std::min(2 * pause, kLongest));
  }

 private:
  static constexpr double kHelpful = 0.9;  // of the time that the caller would take alone
  static constexpr Clock::duration kShort = std::chrono::microseconds(200);
  static constexpr Clock::rep kShortest = Clock::duration(std::chrono::milliseconds(20)).count(),
                              kLongest = Clock::duration(std::chrono::milliseconds(640)).count();

  std::atomic<Clock::rep> alone_until_{0}, pause_{kShortest};
};

class Pool {
 public:
  static Pool& instance();

  bool is_doubtful() const { return usefulness_.is_doubtful(); }

  void execute(const std::shared_ptr<Job>& job, int helpers) {
    const Clock::time_point start = Clock::now();
    call(job, helpers);
    for (int i = 0; i < helpers; ++i) wake_.notify_one();
    std::size_t own = 0;
    while (const std::size_t items = job->step(0)) own += items;
    const Clock::time_point worked = Clock::now();
    while (!job->done() && Clock::now() < worked + kWatched) {
    }
    {
      std::unique_lock<std::mutex> lock(mutex_);
      // Tickets that nobody took are withdrawn, so a busy pool never delays a finished job.
      queue_.erase(std::remove(queue_.begin(), queue_.end(), job), queue_.end());
      done_.wait(lock, [&] { return job->done(); });
    }
    usefulness_.see(own, job->count, worked - start, Clock::now() - start);
  }

 private:
  // If the system gives no threads or memory, the caller works alone.
  void call(const std::shared_ptr<Job>& job, int helpers) {
    const std::lock_guard<std::mutex> lock(mutex_);
    try {
      while (size_ < helpers) {
        std::thread([this] { serve(); }).detach();
        ++size_;
      }
      for (int i = 0; i < helpers; ++i) queue_.push_back(job);
    } catch (const std::exception&) {
    }
  }

  void serve() {
    std::unique_lock<std::mutex> lock(mutex_);
    for (;;) {
      wake_.wait(lock, [this] { return !queue_.empty(); });
      const std::shared_ptr<Job> job = queue_.front();
      queue_.pop_front();
      lock.unlock();
      const int worker = job->next_worker.fetch_add(1);
      while (job->help(worker)) {
      }
      lock.lock();
      if (job->done()) done_.notify_all();
    }
  }

  Usefulness usefulness_;
  std::mutex mutex_;
  std::condition_variable wake_, done_;
  std::deque<std::shared_ptr<Job>> queue_;
  int size_ = 0;
};

// Leaked on purpose: joining threads while the interpreter unloads the library can deadlock. No
// function's static variable: its guard could be locked when another thread forks.
std::atomic<Pool*> pool{nullptr};

Pool& Pool::instance() {
  Pool* known = pool.load();
  if (known != nullptr) return *known;
  auto made = std::make_unique<Pool>();
  return pool.compare_exchange_strong(known, made.get()) ? *made.release() : *known;
}

#if defined(__unix__) || defined(__APPLE__)
// A forked child has none of its parent's threads, and may inherit their locks: it gets its own
// pool on demand.
const int kForgets = pthread_atfork(nullptr, nullptr, [] { pool.store(nullptr); });
#endif

}  // namespace

int resolve_threads(int threads) {
  return std::min(threads > 0 ? threads : usable_processors(), kMostThreads);
}

void parallel_for(std::size_t count, std::size_t grain, int threads,
                  const std::function<void(std::size_t, std::size_t, int)>& body) {
  if (count == 0) return;
  grain = std::clamp<std::size_t>(grain, 1, count);
  const std::size_t chunks = (count + grain - 1) / grain;
  const int workers = static_cast<int>(std::min<std::size_t>(resolve_threads(threads), chunks));
  const auto job = std::make_shared<Job>();
  job->body = &body;
  job->count = count;
  job->grain = grain;
  if (workers <= 1 || Pool::instance().is_doubtful()) {
    while (job->step(0) > 0) {
    }
  } else {
    Pool::instance().execute(job, workers - 1);
  }
  if (job->error) std::rethrow_exception(job->error);
}

}  // namespace segloc
