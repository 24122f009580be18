// Number of threads that this process can run in parallel.
#pragma once

namespace segloc {

// The processors that the process may use: those of the machine, fewer where it is bound to some of
// them (taskset, a batch system), and fewer where a control group has a quota (a container's
// `--cpus`). At least 1. It is looked up once.
int usable_processors();

// Parses a quota file of Linux, rounded up to whole processors: "150000 100000" is 2; "max 100000"
// or unreadable text is 0, no limit.
int processors_of_quota(const char* text);

}  // namespace segloc
