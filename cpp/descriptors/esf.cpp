#include "descriptors/esf.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numeric>
#include <vector>

#include "common/parallel.h"
#include "descriptors/esf_grid.h"
#include "descriptors/moments.h"

namespace segloc {
namespace {

constexpr float kRadius = 32.0f;
constexpr float kLeastArea2 = 0.001f;
constexpr float kSideScale = 1.0f / 32.0f;
constexpr std::size_t kBlock = 256;             // triangles that are measured together
constexpr std::size_t kRememberedPoints = 320;  // fewer: each line is traced and counted once

uint64_t random_word(uint64_t counter) {  // splitmix64
  uint64_t z = counter * 0x9e3779b97f4a7c15ULL;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
  return z ^ (z >> 31);
}

using Histogram = std::array<float, kEsfBins>;

std::size_t bin_of(float value, float largest) {
  return static_cast<std::size_t>(value / largest * (kEsfBins - 1) + 0.5f);
}

class Describer {
 public:
  Describer(std::size_t triples, uint64_t seed) : triples_(triples), seed_(seed) {
    sides_.reserve(3 * triples);
    areas_.reserve(triples);
  }

  void describe(const float* points, std::size_t n, float* output) {
    std::fill(output, output + kEsfSize, 0.0f);
    if (n < 3 || !load(points, n)) return;
    for (Histogram* h : {angles_, area_, side_}) std::fill(h, h + 3, Histogram{});
    shares_.fill(0.0f);
    longest_ = 0;
    sides_.clear();
    areas_.clear();
    for (std::size_t first = 0; first < 2 * triples_ && areas_.size() < triples_; first += kBlock) {
      draw(first);
      measure();
      for (std::size_t i = 0; i < kBlock && areas_.size() < triples_; ++i) {
        if (area2_[i] > kLeastArea2) count(i);
      }
    }
    if (!areas_.empty()) finish(output);
  }

 private:
  struct Side {
    float length;
    Kind kind;
  };
  struct Area {
    float root;
    Kind kind;
  };

  // Sorts, centres and scales the points, and fills the grid; false where all are in one place.
  bool load(const float* points, std::size_t n) {
    n_ = n;
    order_.resize(n);
    std::iota(order_.begin(), order_.end(), 0u);
    std::sort(order_.begin(), order_.end(), [&](uint32_t a, uint32_t b) {
      const float *p = points + 3 * std::size_t{a}, *q = points + 3 * std::size_t{b};
      return std::lexicographical_compare(p, p + 3, q, q + 3);
    });
    const Vec3 centre = mean_of(points, n);
    double largest2 = 0;
    for (std::size_t i = 0; i < n; ++i) {
      double sum = 0;
      for (std::size_t d = 0; d < 3; ++d) {
        const double v = points[3 * i + d] - centre[d];
        sum += v * v;
      }
      largest2 = std::max(largest2, sum);
    }
    if (largest2 == 0) return false;
    const double scale = kRadius / std::sqrt(largest2);
    grid_.clear();
    voxels_.resize(n);
    for (std::size_t d = 0; d < 3; ++d) scaled_[d].resize(n);
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t d = 0; d < 3; ++d) {
        const double v = (points[3 * std::size_t{order_[i]} + d] - centre[d]) * scale;
        scaled_[d][i] = static_cast<float>(v);
        voxels_[i][d] = Grid::coordinate(scaled_[d][i]);
      }
      grid_.occupy(voxels_[i]);
    }
    if (n < kRememberedPoints) lines_.assign(n * n, Line{});
    return true;
  }

  void draw(std::size_t first) {
    for (std::size_t i = 0; i < kBlock; ++i) {
      uint32_t c[3];
      for (std::size_t k = 0; k < 3; ++k) {
        const uint64_t word = random_word(seed_ + 3 * (first + i) + k + 1);
        c[k] = static_cast<uint32_t>((word >> 32) * n_ >> 32);
      }
      corner_[0][i] = std::min({c[0], c[1], c[2]});
      corner_[1][i] = std::max(std::min(c[0], c[1]), std::min(std::max(c[0], c[1]), c[2]));
      corner_[2][i] = std::max({c[0], c[1], c[2]});
    }
    for (std::size_t k = 0; k < 3; ++k) {
      for (std::size_t d = 0; d < 3; ++d) {
        for (std::size_t i = 0; i < kBlock; ++i) place_[k][d][i] = scaled_[d][corner_[k][i]];
      }
    }
  }

  // Of a block of triangles: the lengths of the sides 1-2, 1-3 and 2-3, the squared area, and the
  // cosines of the angles at the corners 1, 3 and 2.
  void measure() {
    for (std::size_t i = 0; i < kBlock; ++i) {
      float e[3][3];
      for (std::size_t d = 0; d < 3; ++d) {
        e[0][d] = place_[1][d][i] - place_[0][d][i];
        e[1][d] = place_[2][d][i] - place_[0][d][i];
        e[2][d] = place_[2][d][i] - place_[1][d][i];
      }
      const auto dot = [&](std::size_t p, std::size_t q) {
        return e[p][0] * e[q][0] + e[p][1] * e[q][1] + e[p][2] * e[q][2];
      };
      const float a = std::sqrt(dot(0, 0)), b = std::sqrt(dot(1, 1)), c = std::sqrt(dot(2, 2));
      // By the cross product, which flat triangles cancel less in than Heron's formula.
      const float nx = e[0][1] * e[1][2] - e[0][2] * e[1][1];
      const float ny = e[0][2] * e[1][0] - e[0][0] * e[1][2];
      const float nz = e[0][0] * e[1][1] - e[0][1] * e[1][0];
      length_[0][i] = a;
      length_[1][i] = b;
      length_[2][i] = c;
      area2_[i] = 0.25f * (nx * nx + ny * ny + nz * nz);
      root_[i] = std::sqrt(std::sqrt(area2_[i]));
      cosine_[0][i] = std::abs(dot(0, 1)) / (a * b);
      cosine_[1][i] = std::abs(dot(1, 2)) / (b * c);
      cosine_[2][i] = std::abs(dot(0, 2)) / (a * c);
    }
  }

  // The line between two corners; it is noted as a side of that length.
  Line side(uint32_t a, uint32_t b, float length) {
    if (n_ >= kRememberedPoints) {
      const Line traced = grid_.trace(voxels_[a], voxels_[b]);
      sides_.push_back({length, traced.kind});
      if (traced.kind == kAcross) shares_[traced.share_bin] += 1.0f;
      return traced;
    }
    Line& known = lines_[a * n_ + b];
    if (known.voxels == 0) known = grid_.trace(voxels_[a], voxels_[b]);
    ++known.drawn;
    longest_ = std::max(longest_, length);
    return known;
  }

  void count(std::size_t i) {
    constexpr std::size_t kEnds[3][2] = {{0, 1}, {0, 2}, {1, 2}};
    constexpr std::size_t kOpposite[3] = {2, 0, 1};  // the side across from each angle
    int occupied = 0, voxels = 0;
    float across[3];
    for (std::size_t e = 0; e < 3; ++e) {
      const Line l = side(corner_[kEnds[e][0]][i], corner_[kEnds[e][1]][i], length_[e][i]);
      occupied += l.occupied;
      voxels += l.voxels;
      across[e] = static_cast<float>(l.voxels) * kSideScale;
    }
    const Kind kind = occupied <= 21 ? kOutside : voxels - occupied < 4 ? kInside : kAcross;
    for (std::size_t k = 0; k < 3; ++k) {
      angles_[kind][bins_.of(cosine_[k][i])] += across[kOpposite[k]];
    }
    areas_.push_back({root_[i], kind});
  }

  // The histograms of sides: of each line as often as it was drawn, or of what was noted.
  void count_sides() {
    for (const Side& s : sides_) longest_ = std::max(longest_, s.length);
    for (const Side& s : sides_) side_[s.kind][bin_of(s.length, longest_)] += 1.0f;
    if (n_ >= kRememberedPoints) return;
    for (std::size_t a = 0; a < n_; ++a) {
      for (std::size_t b = a + 1; b < n_; ++b) {
        const Line& l = lines_[a * n_ + b];
        if (l.drawn == 0) continue;
        float sum = 0;
        for (const std::vector<float>& axis : scaled_) {
          sum += (axis[b] - axis[a]) * (axis[b] - axis[a]);
        }
        const auto drawn = static_cast<float>(l.drawn);
        side_[l.kind][bin_of(std::sqrt(sum), longest_)] += drawn;
        if (l.kind == kAcross) shares_[l.share_bin] += drawn;
      }
    }
  }

  void finish(float* output) {
    count_sides();
    float largest = 0;
    for (const Area& a : areas_) largest = std::max(largest, a.root);
    for (const Area& a : areas_) area_[a.kind][bin_of(a.root, largest)] += 1.0f;
    constexpr float kWeights[10] = {0.5f, 0.5f, 0.5f, 0.5f, 0.5f, 1.0f, 0.5f, 2.0f, 2.0f, 1.0f};
    const Histogram* all[10] = {&angles_[0], &angles_[1], &angles_[2], &area_[0], &area_[1],
                                &area_[2],   &side_[0],   &side_[1],   &side_[2], &shares_};
    double sum = 0;
    for (std::size_t h = 0; h < 10; ++h) {
      for (std::size_t b = 0; b < kEsfBins; ++b) {
        output[h * kEsfBins + b] = (*all[h])[b] * kWeights[h];
        sum += output[h * kEsfBins + b];
      }
    }
    for (std::size_t b = 0; b < kEsfSize; ++b) output[b] = static_cast<float>(output[b] / sum);
  }

  std::size_t triples_, n_ = 0;
  uint64_t seed_;
  Grid grid_;
  AngleBins bins_;
  std::vector<uint32_t> order_;
  std::vector<float> scaled_[3];
  std::vector<Grid::Voxel> voxels_;
  std::vector<Line> lines_;
  float longest_ = 0;
  uint32_t corner_[3][kBlock];
  float place_[3][3][kBlock];
  float length_[3][kBlock], cosine_[3][kBlock];
  float area2_[kBlock], root_[kBlock];
  std::vector<Side> sides_;
  std::vector<Area> areas_;
  Histogram angles_[3], area_[3], side_[3], shares_;
};

}  // namespace

void esf(const float* points, const int64_t* offsets, std::size_t segments, std::size_t triples,
         uint64_t seed, int threads, float* output) {
  const auto workers = static_cast<std::size_t>(resolve_threads(threads));
  std::vector<std::unique_ptr<Describer>> describers(workers);
  parallel_for(segments, 1, threads, [&](std::size_t begin, std::size_t end, int worker) {
    std::unique_ptr<Describer>& describer = describers[static_cast<std::size_t>(worker)];
    if (!describer) describer = std::make_unique<Describer>(triples, seed);
    for (std::size_t s = begin; s < end; ++s) {
      const auto n = static_cast<std::size_t>(offsets[s + 1] - offsets[s]);
      describer->describe(points + 3 * offsets[s], n, output + s * kEsfSize);
    }
  });
}

}  // namespace segloc
