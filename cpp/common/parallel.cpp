#include "common/parallel.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <deque>
#include <exception>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace segloc {
namespace {

// One call of parallel_for: workers take chunks from `next` until none is left.
struct Job {
  const std::function<void(std::size_t, std::size_t, int)>* body;
  std::size_t count;
  std::size_t grain;
  std::atomic<std::size_t> next{0};
  std::atomic<int> next_worker{1};  // the caller is worker 0
  int active = 0;                   // helpers inside run(); guarded by the pool's mutex
  std::exception_ptr error;
  std::mutex error_mutex;

  void run(int worker) {
    for (;;) {
      const std::size_t begin = next.fetch_add(grain);
      if (begin >= count) return;
      try {
        (*body)(begin, std::min(begin + grain, count), worker);
      } catch (...) {
        const std::lock_guard<std::mutex> lock(error_mutex);
        if (!error) error = std::current_exception();
        next.store(count);
      }
    }
  }
};

class Pool {
 public:
  // Leaked on purpose: joining threads while the interpreter unloads the library can deadlock.
  static Pool& instance() {
    static Pool* pool = new Pool();
    return *pool;
  }

  void execute(const std::shared_ptr<Job>& job, int helpers) {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      while (size_ < helpers) {
        std::thread([this] { serve(); }).detach();
        ++size_;
      }
      for (int i = 0; i < helpers; ++i) queue_.push_back(job);
    }
    wake_.notify_all();
    job->run(0);
    std::unique_lock<std::mutex> lock(mutex_);
    // Tickets that nobody took are withdrawn, so a busy pool never delays a finished job.
    queue_.erase(std::remove(queue_.begin(), queue_.end(), job), queue_.end());
    done_.wait(lock, [&] { return job->active == 0; });
  }

 private:
  void serve() {
    std::unique_lock<std::mutex> lock(mutex_);
    for (;;) {
      wake_.wait(lock, [this] { return !queue_.empty(); });
      const std::shared_ptr<Job> job = queue_.front();
      queue_.pop_front();
      ++job->active;
      const int worker = job->next_worker.fetch_add(1);
      lock.unlock();
      job->run(worker);
      lock.lock();
      if (--job->active == 0) done_.notify_all();
    }
  }

  std::mutex mutex_;
  std::condition_variable wake_, done_;
  std::deque<std::shared_ptr<Job>> queue_;
  int size_ = 0;
};

}  // namespace

int resolve_threads(int threads) {
  if (threads > 0) return threads;
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

void parallel_for(std::size_t count, std::size_t grain, int threads,
                  const std::function<void(std::size_t, std::size_t, int)>& body) {
  if (count == 0) return;
  grain = std::max<std::size_t>(grain, 1);
  const std::size_t chunks = (count + grain - 1) / grain;
  const int workers = static_cast<int>(std::min<std::size_t>(resolve_threads(threads), chunks));
  const auto job = std::make_shared<Job>();
  job->body = &body;
  job->count = count;
  job->grain = grain;
  if (workers <= 1) {
    job->run(0);
  } else {
    Pool::instance().execute(job, workers - 1);
  }
  if (job->error) std::rethrow_exception(job->error);
}

}  // namespace segloc
