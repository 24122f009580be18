// A small thread pool of our own: no OpenMP, so two runtimes can never meet in one process.
#pragma once

#include <cstddef>
#include <functional>

namespace segloc {

// Runs body(begin, end, worker) over [0, count) in chunks of `grain`, on up to `threads` workers
// (0: all that the process may use). `worker` is in [0, threads) and can index per-thread scratch
// memory. Which worker gets which chunk varies from run to run, so a body must write only to slots
// named by its own indices: then the result does not depend on the number of threads. The first
// exception that a body throws is rethrown here. Calls may come from several threads at once and
// may nest. A process that was forked, at any time, may call too: it gets threads of its own.
void parallel_for(std::size_t count, std::size_t grain, int threads,
                  const std::function<void(std::size_t begin, std::size_t end, int worker)>& body);

// The number of workers that `threads` stands for: itself, but at most 256, or as many as the
// process has processors (processors.h) where it is 0 or less.
int resolve_threads(int threads);

}  // namespace segloc
