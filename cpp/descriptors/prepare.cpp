#include "descriptors/prepare.h"

#include <algorithm>
#include <cmath>
#include <cstring>
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

// Everything that one worker needs.
class Preparer {
 public:
  Preparer(std::size_t count, Alignment alignment, const Kernels& kernels)
      : count_(count),
        alignment_(alignment),
        kernels_(kernels),
        scratch_(fps_scratch_size(kThinnedPoints)) {
    order_.resize(count);
  }

  void prepare(const float* points, std::size_t n, float* output) {
    if (n == 0) {
      std::fill(output, output + 3 * count_, 0.0f);
      return;
    }
    centre_points(points, n, cloud_);
    if (alignment_ == Alignment::pca2d) align_2d(cloud_, n);
    if (alignment_ == Alignment::pca3d) align_3d(cloud_, n);
    sample(points, n, output);
  }

 private:
  void sample(const float* points, std::size_t n, float* output) {
    const uint64_t limit = hash_limit(points, n);
    const std::size_t kept = std::min(n, kThinnedPoints), stride = padded(kept, kFpsGroup);
    const FpsCloud cloud = {scratch_.data(), order_.data()};
    float* x = cloud.memory;
    for (std::size_t i = 0, next = 0; i < n && next < kept; ++i) {
      if (n > kThinnedPoints && hashes_[i] > limit) continue;
      for (std::size_t d = 0; d < 3; ++d) x[next + d * stride] = cloud_[3 * i + d];
      ++next;
    }
    for (std::size_t d = 0; d < 3; ++d) {
      std::fill(x + kept + d * stride, x + (d + 1) * stride, 0.0f);
    }
    const std::size_t samples = std::min(kept, count_);
    kernels_.fps(&cloud, 1, kept, samples);
    for (std::size_t s = 0; s < count_; ++s) {
      const auto i = static_cast<std::size_t>(order_[s % samples]);
      for (std::size_t d = 0; d < 3; ++d) output[3 * s + d] = x[i + d * stride];
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
  parallel_for(segments, 8, threads, [&](std::size_t begin, std::size_t end, int) {
    Preparer preparer(count, alignment, k);
    for (std::size_t i = begin; i < end; ++i) {
      const auto n = static_cast<std::size_t>(offsets[i + 1] - offsets[i]);
      preparer.prepare(points + 3 * offsets[i], n, output + i * count * 3);
    }
  });
}

}  // namespace segloc
