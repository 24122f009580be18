#include "likelihood/gicp.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/parallel.h"
#include "simd/kernels.h"

namespace segloc {
namespace {

constexpr std::size_t kChunk = 256;   // source points that are summed together
// Fewer points than these are not worth a second thread: to call it takes as long.
constexpr std::size_t kFewPairs = 1024, kFewErrors = 16384;
constexpr double kLead = 0.4;       // share of the maximum distance in which others are sought
constexpr double kRounding = 1e-3;  // metres
constexpr double kFirstDamping = 1e-3, kDampingFactor = 10.0;
constexpr int kTries = 10;

using Vector6 = std::array<double, 6>;

// H, its upper triangle by rows, b, and the error.
using Sums = std::array<double, kPairTerms>;
constexpr std::size_t kGradient = 21, kError = 27;

// Nine values of rotation, and three of translation.
std::array<double, 12> flat(const Rigid& T) {
  std::array<double, 12> values;
  std::copy(T.R.begin(), T.R.end(), values.begin());
  std::copy(T.t.begin(), T.t.end(), values.begin() + 9);
  return values;
}

class Problem {
 public:
  // Of every `stride`-th point of the source.
  Problem(const Surface& target, const Surface& source, std::size_t stride, int threads)
      : target_(target),
        source_(source),
        stride_(stride),
        threads_(threads),
        count_((source.size() + stride - 1) / stride),
        targets_(count_, kNoPoint),
        values_(kRows * count_),
        places_(kPlaceRows * count_) {
    for (std::size_t i = 0; i < count_; ++i) {
      const PointGrid::Point p = source.grid()[i * stride];
      for (std::size_t a = 0; a < 3; ++a) row(kSource + a)[i] = p[a];
      place(kStays)[i] = -1.0f;
    }
  }

  // Pairs at this pose, and the quadratic form of the error about it.
  Sums linearized(const Rigid& T) {
    frame_ = flat(T);
    return summed(kFewPairs, [&](std::size_t begin, std::size_t end, Sums& sums) {
      find(begin, end);
      best_kernels().sum_pairs(arrays(), frame_.data(), begin, end, sums.data());
    });
  }

  // The error of the same pairs at another pose.
  double error(const Rigid& T) {
    const auto pose = flat(T);
    return summed(kFewErrors, [&](std::size_t begin, std::size_t end, Sums& sums) {
      sums[kError] =
          best_kernels().pair_error(arrays(), frame_.data(), pose.data(), begin, end);
    })[kError];
  }

  // Sums J'J of the pairs.
  std::array<double, 36> motion() {
    double n = 0.0, s[3] = {}, ss[3][3] = {};
    for (std::size_t i = 0; i < count_; ++i) {
      if (targets_[i] == kNoPoint) continue;
      n += 1.0;
      for (std::size_t a = 0; a < 3; ++a) {
        s[a] += row(kSource + a)[i];
        for (std::size_t b = 0; b < 3; ++b) ss[a][b] += row(kSource + a)[i] * row(kSource + b)[i];
      }
    }
    const double squared = ss[0][0] + ss[1][1] + ss[2][2];
    const double skew[3][3] = {{0.0, -s[2], s[1]}, {s[2], 0.0, -s[0]}, {-s[1], s[0], 0.0}};
    std::array<double, 36> H{};
    for (std::size_t a = 0; a < 3; ++a) {
      for (std::size_t b = 0; b < 3; ++b) {
        H[6 * a + b] = (a == b ? squared : 0.0) - ss[a][b];
        H[6 * a + b + 3] = H[6 * (b + 3) + a] = skew[a][b];
        H[6 * (a + 3) + b + 3] = a == b ? n : 0.0;
      }
    }
    return H;
  }

  std::size_t inliers() const {
    const auto lone = std::count(targets_.begin(), targets_.end(), kNoPoint);
    return count_ - static_cast<std::size_t>(lone);
  }

 private:
  static constexpr std::size_t kSource = 0, kTarget = 3, kNormal = 6, kOwn = 9, kUse = 12,
                               kWeight = 13, kRows = 19;
  static constexpr std::size_t kAt = 0, kStays = 3, kPlaceRows = 4;

  double* row(std::size_t k) { return values_.data() + k * count_; }
  float* place(std::size_t k) { return places_.data() + k * count_; }
  PairArrays arrays() {
    return {{row(kSource), row(kSource + 1), row(kSource + 2)},
            {row(kTarget), row(kTarget + 1), row(kTarget + 2)},
            {row(kNormal), row(kNormal + 1), row(kNormal + 2)},
            {row(kOwn), row(kOwn + 1), row(kOwn + 2)},
            row(kUse),
            {place(kAt), place(kAt + 1), place(kAt + 2)},
            place(kStays),
            {row(kWeight), row(kWeight + 1), row(kWeight + 2), row(kWeight + 3), row(kWeight + 4),
             row(kWeight + 5)}};
  }

  // Chunks are fixed and added up in order: no sum depends on who took which.
  template <typename Body>
  Sums summed(std::size_t few, const Body& body) const {
    std::vector<Sums> parts((count_ + kChunk - 1) / kChunk, Sums{});
    const int threads = count_ < few ? 1 : threads_;
    parallel_for(count_, kChunk, threads, [&](std::size_t begin, std::size_t end, int) {
      body(begin, end, parts[begin / kChunk]);
    });
    Sums total{};
    for (const Sums& part : parts) {
      for (std::size_t k = 0; k < kPairTerms; ++k) total[k] += part[k];
    }
    return total;
  }

  // Finds the pairs of points that moved too far for theirs to be sure.
  void find(std::size_t begin, std::size_t end) {
    std::array<float, kChunk> x, y, z;
    std::array<std::uint8_t, kChunk> is_lost;
    float* const moved[3] = {x.data(), y.data(), z.data()};
    best_kernels().move_pairs(arrays(), frame_.data(), begin, end, moved, is_lost.data());
    std::vector<std::uint32_t> lost;
    std::vector<float> places;
    for (std::size_t i = begin; i < end; ++i) {
      const std::size_t k = i - begin;
      if (!is_lost[k]) continue;
      lost.push_back(static_cast<std::uint32_t>(i));
      places.insert(places.end(), {x[k], y[k], z[k]});
    }
    const std::vector<GridNearest> nearest =
        target_.nearest(places, kLead * target_.max_correspondence_distance());
    std::vector<std::uint32_t> targets, sources;
    for (std::size_t k = 0; k < lost.size(); ++k) {
      const std::size_t i = lost[k];
      for (std::size_t a = 0; a < 3; ++a) place(kAt + a)[i] = places[3 * k + a];
      pair(i, nearest[k]);
      if (targets_[i] == kNoPoint) continue;
      lost[targets.size()] = lost[k];
      targets.push_back(targets_[i]);
      sources.push_back(static_cast<std::uint32_t>(i * stride_));
    }
    const auto normals = target_.normals(targets), own = source_.normals(sources);
    for (std::size_t k = 0; k < targets.size(); ++k) {
      for (std::size_t a = 0; a < 3; ++a) {
        row(kNormal + a)[lost[k]] = normals[k][a];
        row(kOwn + a)[lost[k]] = own[k][a];
      }
    }
  }

  void pair(std::size_t i, const GridNearest& nearest) {
    const double limit = target_.max_correspondence_distance();
    const float next = std::sqrt(nearest.next);
    targets_[i] = nearest.point;
    row(kUse)[i] = nearest.point != kNoPoint;
    if (nearest.point == kNoPoint) {
      place(kStays)[i] = static_cast<float>(next - limit - kRounding);
      return;
    }
    // Moved by less than half the lead, it is still the nearest, and still close enough.
    const float lead = std::min(next, static_cast<float>(limit)) - std::sqrt(nearest.squared);
    place(kStays)[i] = 0.5f * lead;
    const PointGrid::Point t = target_.grid()[nearest.point];
    for (std::size_t a = 0; a < 3; ++a) row(kTarget + a)[i] = t[a];
  }

  const Surface& target_;
  const Surface& source_;
  std::size_t stride_;
  int threads_;
  std::size_t count_;
  std::vector<std::uint32_t> targets_;
  std::vector<double> values_;  // (kRows, count)
  std::vector<float> places_;   // (kPlaceRows, count)
  std::array<double, 12> frame_{};
};

std::array<double, 36> full(const Sums& upper) {
  std::array<double, 36> H{};
  std::size_t k = 0;
  for (std::size_t a = 0; a < 6; ++a) {
    for (std::size_t b = a; b < 6; ++b) H[6 * a + b] = H[6 * b + a] = upper[k++];
  }
  return H;
}

// Solves (H + damping I) x = -b by Cholesky's decomposition; false where that is not positive.
bool solve(std::array<double, 36> L, double damping, const Vector6& b, Vector6& x) {
  for (std::size_t i = 0; i < 6; ++i) {
    for (std::size_t j = 0; j <= i; ++j) {
      double sum = L[6 * i + j] + (i == j ? damping : 0.0);
      for (std::size_t k = 0; k < j; ++k) sum -= L[6 * i + k] * L[6 * j + k];
      if (i == j && !(sum > 0.0)) return false;
      L[6 * i + j] = i == j ? std::sqrt(sum) : sum / L[6 * j + j];
    }
  }
  for (std::size_t i = 0; i < 6; ++i) {
    double sum = -b[i];
    for (std::size_t k = 0; k < i; ++k) sum -= L[6 * i + k] * x[k];
    x[i] = sum / L[6 * i + i];
  }
  for (std::size_t i = 6; i-- > 0;) {
    for (std::size_t k = i + 1; k < 6; ++k) x[i] -= L[6 * k + i] * x[k];
    x[i] /= L[6 * i + i];
  }
  return true;
}

// Rodrigues' formula.
std::array<double, 9> rotation(const double* w) {
  const double angle = std::sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]);
  const double s = angle > 1e-12 ? std::sin(angle) / angle : 1.0;
  const double c = angle > 1e-12 ? (1.0 - std::cos(angle)) / (angle * angle) : 0.5;
  const double x = w[0], y = w[1], z = w[2];
  return {1 - c * (y * y + z * z), c * x * y - s * z,       c * x * z + s * y,
          c * x * y + s * z,       1 - c * (x * x + z * z), c * y * z - s * x,
          c * x * z - s * y,       c * y * z + s * x,       1 - c * (x * x + y * y)};
}

// T times a small step of rotation and translation in the source's frame.
Rigid stepped(const Rigid& T, const Vector6& step) {
  const auto dR = rotation(step.data());
  Rigid moved;
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) {
      moved.R[3 * r + c] =
          T.R[3 * r] * dR[c] + T.R[3 * r + 1] * dR[3 + c] + T.R[3 * r + 2] * dR[6 + c];
    }
  }
  moved.t = T.apply(step.data() + 3);
  return moved;
}

// Levenberg-Marquardt from result.T, until its steps are small.
void optimise(Problem& problem, int iterations, const GicpOptions& options, GicpResult& result) {
  double damping = kFirstDamping;
  bool done = false;
  for (int k = 0; k < iterations && !done; ++k) {
    ++result.iterations;
    const Sums sums = problem.linearized(result.T);
    result.H = full(sums);
    result.error = sums[kError];
    result.inliers = problem.inliers();
    Vector6 b;
    std::copy_n(sums.begin() + kGradient, b.size(), b.begin());
    done = true;  // unless a step that is not small lowers the error
    for (int tries = 0; tries < kTries && result.inliers > 0; ++tries, damping *= kDampingFactor) {
      Vector6 step{};
      if (!solve(result.H, damping, b, step)) continue;
      const Rigid moved = stepped(result.T, step);
      const double error = problem.error(moved);
      if (!(error < sums[kError])) continue;
      result.T = moved;
      result.error = error;
      damping /= kDampingFactor;
      done = std::hypot(step[0], step[1], step[2]) <= options.rotation_step &&
             std::hypot(step[3], step[4], step[5]) <= options.translation_step;
      break;
    }
  }
}

// Makes the rotation orthonormal, and scales sums over every `stride`-th point to those over all.
void complete(Problem& problem, std::size_t stride, GicpResult& result) {
  result.T.R = orthonormal(result.T.R);
  result.motion = problem.motion();
  for (double& h : result.H) h *= static_cast<double>(stride);
  for (double& m : result.motion) m *= static_cast<double>(stride);
}

}  // namespace

GicpResult align(const Surface& target, const Surface& source, const Rigid& start,
                 const GicpOptions& options, int threads) {
  GicpResult result;
  result.T = start;
  const std::size_t rough = source.size() / std::max<std::size_t>(1, options.coarse);
  if (rough > 1) {
    Problem few(target, source, rough, threads);
    optimise(few, options.max_iterations, options, result);
    if (options.max_final == 0) {
      complete(few, rough, result);
      return result;
    }
  }
  const std::size_t share = source.size() / std::max<std::size_t>(1, options.fine);
  const std::size_t stride = std::max<std::size_t>(1, share);
  Problem most(target, source, stride, threads);
  optimise(most, rough > 1 ? options.max_final : options.max_iterations, options, result);
  complete(most, stride, result);
  return result;
}

}  // namespace segloc
