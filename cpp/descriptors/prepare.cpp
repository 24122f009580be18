#include "descriptors/prepare.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <vector>

#include "common/aligned.h"
#include "common/parallel.h"
#include "descriptors/align.h"
#include "descriptors/fps.h"
#include "descriptors/moments.h"

namespace segloc {
namespace {

uint64_t hash_point(const float* p) {
  uint64_t h = 0x9e3779b97f4a7c15ULL;
  for (int d = 0; d < 3; ++d) {
    const float value = p[d] + 0.0f;  // -0 and 0 are one place
    uint32_t word;
    std::memcpy(&word, &value, sizeof(word));
    h = (h ^ word) * 0xbf58476d1ce4e5b9ULL;
    h ^= h >> 31;
  }
  return h;
}

constexpr std::size_t kTogether = 4;      // clouds whose points are chosen in lockstep
constexpr std::size_t kSlot = padded(fps_scratch_size(kFpsFewGroups * kFpsGroup), 16);

std::size_t kept_points(std::size_t n) { return std::min(n, kThinnedPoints); }

// A segment, and where its points go.
struct Task {
  const float* points;
  std::size_t n;
  float* output;

  std::size_t groups() const { return fps_groups(kept_points(n)); }
};

// Everything that one worker needs.
class Preparer {
 public:
  Preparer(std::size_t count, Alignment alignment, const Kernels& kernels)
      : count_(count),
        alignment_(alignment),
        kernels_(kernels),
        scratch_(std::max(fps_scratch_size(kThinnedPoints), kTogether * kSlot)),
        order_(kTogether * count) {}

  // Segments in the order of their falling size: those alike are sampled together.
  void prepare(const Task* tasks, std::size_t count) {
    for (std::size_t first = 0; first < count;) {
      const std::size_t groups = tasks[first].groups();
      const std::size_t together = groups > kFpsFewGroups ? 1 : std::min(kTogether, count - first);
      FpsCloud clouds[kTogether];
      for (std::size_t k = 0; k < together; ++k) clouds[k] = place(tasks[first + k], k, groups);
      kernels_.fps(clouds, together, groups);
      for (std::size_t k = 0; k < together; ++k) {
        write(clouds[k], groups * kFpsGroup, tasks[first + k].output);
      }
      first += together;
    }
  }

 private:
  // The aligned points in the memory of cloud k.
  FpsCloud place(const Task& task, std::size_t k, std::size_t groups) {
    const float* points = task.points;
    const std::size_t n = task.n, kept = kept_points(n), stride = groups * kFpsGroup;
    float* x = scratch_.data() + k * kSlot;
    centre_points(points, n, cloud_);
    if (alignment_ == Alignment::pca2d) align_2d(cloud_, n);
    if (alignment_ == Alignment::pca3d) align_3d(cloud_, n);
    const uint64_t limit = hash_limit(points, n);
    for (std::size_t i = 0, next = 0; i < n && next < kept; ++i) {
      if (n > kThinnedPoints && hashes_[i] > limit) continue;
      for (std::size_t d = 0; d < 3; ++d) x[next + d * stride] = cloud_[3 * i + d];
      ++next;
    }
    for (std::size_t d = 0; d < 3; ++d) {
      std::fill(x + kept + d * stride, x + (d + 1) * stride, 0.0f);
    }
    return {x, order_.data() + k * count_, kept, std::min(kept, count_)};
  }

  void write(const FpsCloud& cloud, std::size_t stride, float* output) const {
    for (std::size_t s = 0; s < count_; ++s) {
      const auto i = static_cast<std::size_t>(cloud.order[s % cloud.samples]);
      for (std::size_t d = 0; d < 3; ++d) output[3 * s + d] = cloud.memory[i + d * stride];
    }
  }

  uint64_t hash_limit(const float* points, std::size_t n) {
    if (n <= kThinnedPoints) return 0;
    hashes_.resize(n);
    for (std::size_t i = 0; i < n; ++i) hashes_[i] = hash_point(points + 3 * i);
    ranked_ = hashes_;
    const auto last = ranked_.begin() + kThinnedPoints - 1;
    std::nth_element(ranked_.begin(), last, ranked_.end());
    return *last;
  }

  std::size_t count_;
  Alignment alignment_;
  const Kernels& kernels_;
  AlignedFloats scratch_;
  std::vector<int32_t> order_;
  std::vector<float> cloud_;
  std::vector<uint64_t> hashes_, ranked_;
};

}  // namespace

void prepare_segments(const float* points, const int64_t* offsets, std::size_t segments,
                      std::size_t count, Alignment alignment, Isa isa, int threads, float* output) {
  const Kernels& k = kernels(isa);
  std::vector<Task> tasks;
  tasks.reserve(segments);
  for (std::size_t i = 0; i < segments; ++i) {
    const auto n = static_cast<std::size_t>(offsets[i + 1] - offsets[i]);
    float* out = output + i * count * 3;
    if (n > 0) {
      tasks.push_back({points + 3 * offsets[i], n, out});
    } else {
      std::fill(out, out + 3 * count, 0.0f);
    }
  }
  std::sort(tasks.begin(), tasks.end(), [](const Task& a, const Task& b) { return a.n > b.n; });
  std::vector<std::unique_ptr<Preparer>> workers(
      static_cast<std::size_t>(resolve_threads(threads)));
  parallel_for(tasks.size(), 8, threads, [&](std::size_t begin, std::size_t end, int worker) {
    std::unique_ptr<Preparer>& own = workers[static_cast<std::size_t>(worker)];
    if (!own) own = std::make_unique<Preparer>(count, alignment, k);
    own->prepare(tasks.data() + begin, end - begin);
  });
}

}  // namespace segloc
