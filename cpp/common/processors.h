// How many threads this process can run at the same time.
#pragma once

namespace segloc {

// The processors that the process may use: those of the machine, fewer where it is bound to some of
// them (taskset, a batch system), and fewer where a control group has a quota (a container's
// `--cpus`). At least 1. It is looked up once.
int usable_processors();

// What a quota file of Linux says, rounded up to whole processors: "150000 100000" is 2, and
// "max 100000" is 0, no limit; so is whatever cannot be read.
int processors_of_quota(const char* text);

}  // namespace segloc
