#include "common/processors.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <sstream>
#include <string>
#include <thread>

#ifdef __linux__
#include <sched.h>
#endif

namespace segloc {
namespace {

constexpr double kMost = 4096.0;

// Of two limits, where 0 is none.
int lower(int a, int b) { return a > 0 && b > 0 ? std::min(a, b) : std::max(a, b); }

#ifdef __linux__

std::string first_line(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  return line;
}

// The least quota of a group and of those above it.
template <typename Quota>
int least_quota(std::string group, const Quota& quota) {
  int least = quota(group);
  while (!group.empty()) {
    const std::size_t slash = group.find_last_of('/');
    group.erase(slash == std::string::npos ? 0 : slash);
    least = lower(least, quota(group));
  }
  return least;
}

int quota_of_version_2(const std::string& group) {
  return processors_of_quota(first_line("/sys/fs/cgroup" + group + "/cpu.max").c_str());
}

int quota_of_version_1(const std::string& group) {
  const std::string file = "/sys/fs/cgroup/cpu" + group + "/cpu.cfs_";
  const std::string both = first_line(file + "quota_us") + " " + first_line(file + "period_us");
  return processors_of_quota(both.c_str());
}

// Lines are "number:controllers:group"; version 2 has one group and names no controllers.
int quota_of_group() {
  std::ifstream lines("/proc/self/cgroup");
  int least = 0;
  for (std::string number, controllers, group; std::getline(lines, number, ':');) {
    if (!std::getline(lines, controllers, ':') || !std::getline(lines, group)) break;
    if (controllers.empty()) least = lower(least, least_quota(group, quota_of_version_2));
    if (("," + controllers + ",").find(",cpu,") != std::string::npos)
      least = lower(least, least_quota(group, quota_of_version_1));
  }
  return least;
}

int bound_processors() {
  cpu_set_t set;
  CPU_ZERO(&set);
  return sched_getaffinity(0, sizeof(set), &set) == 0 ? CPU_COUNT(&set) : 0;
}

int most_processors() { return lower(bound_processors(), quota_of_group()); }

#else

int most_processors() { return 0; }

#endif

int count_processors() {
  const int there = static_cast<int>(std::thread::hardware_concurrency());
  return std::max(lower(there, most_processors()), 1);
}

// Before any thread: a fork could leave the guard of a function's static variable locked.
const int kUsable = count_processors();

}  // namespace

int processors_of_quota(const char* text) {
  std::istringstream words(text);
  double quota = 0.0, period = 0.0;
  if (!(words >> quota >> period) || !(quota > 0.0) || !(period > 0.0)) return 0;
  return static_cast<int>(std::min(std::ceil(quota / period), kMost));
}

int usable_processors() { return kUsable; }

}  // namespace segloc
