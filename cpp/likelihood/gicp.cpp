#include "likelihood/gicp.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/parallel.h"

namespace segloc {
namespace {

constexpr double kFlat = 1.0 - 1e-3;  // how much less a point is uncertain across its surface
constexpr std::size_t kChunk = 256;   // source points that are summed together
// Fewer points than these are not worth a second thread: to call it takes as long.
constexpr std::size_t kFewPairs = 1024, kFewErrors = 16384;
constexpr double kLead = 0.4;       // share of the maximum distance within which others are looked for
constexpr double kRounding = 1e-3;  // metres
constexpr double kFirstDamping = 1e-3, kDampingFactor = 10.0;
constexpr int kTries = 10;

using Vector6 = std::array<double, 6>;

struct Pair {
  std::uint32_t target = kNoPoint;
  float stays = -1.0f;        // it, or none, stays the nearest while the point moves less than this
  PointGrid::Point at{};      // where the point was when that was found
  Surface::Normal normal{}, own_normal{};
  std::array<double, 6> W{};  // xx, xy, xz, yy, yz, zz of the inverse covariance, source frame
};

struct Sums {
  std::array<double, 21> H{};  // upper triangle, by rows
  Vector6 b{};
  double error = 0.0;
  std::size_t inliers = 0;

  void add(const Sums& other) {
    for (std::size_t i = 0; i < H.size(); ++i) H[i] += other.H[i];
    for (std::size_t i = 0; i < b.size(); ++i) b[i] += other.b[i];
    error += other.error;
    inliers += other.inliers;
  }
};

std::array<double, 3> turned_back(const Rigid& T, const double* v) {
  return {T.R[0] * v[0] + T.R[3] * v[1] + T.R[6] * v[2],
          T.R[1] * v[0] + T.R[4] * v[1] + T.R[7] * v[2],
          T.R[2] * v[0] + T.R[5] * v[1] + T.R[8] * v[2]};
}

// The inverse of 2 I - kFlat (n n' + m m').
std::array<double, 6> weight(const std::array<double, 3>& n, const Surface::Normal& m) {
  const auto entry = [&](int a, int b) { return -kFlat * (n[a] * n[b] + m[a] * m[b]); };
  const double xx = 2.0 + entry(0, 0), yy = 2.0 + entry(1, 1), zz = 2.0 + entry(2, 2);
  const double xy = entry(0, 1), xz = entry(0, 2), yz = entry(1, 2);
  const double a = yy * zz - yz * yz, b = xz * yz - xy * zz, c = xy * yz - xz * yy;
  const double scale = 1.0 / (xx * a + xy * b + xz * c);
  return {a * scale,
          b * scale,
          c * scale,
          (xx * zz - xz * xz) * scale,
          (xy * xz - xx * yz) * scale,
          (xx * yy - xy * xy) * scale};
}

std::array<double, 3> times(const std::array<double, 6>& W, const std::array<double, 3>& v) {
  return {W[0] * v[0] + W[1] * v[1] + W[2] * v[2], W[1] * v[0] + W[3] * v[1] + W[4] * v[2],
          W[2] * v[0] + W[4] * v[1] + W[5] * v[2]};
}

class Problem {
 public:
  // Of every `stride`-th point of the source.
  Problem(const Surface& target, const Surface& source, std::size_t stride, int threads)
      : target_(target),
        source_(source),
        stride_(stride),
        threads_(threads),
        pairs_((source.size() + stride - 1) / stride) {}

  // Pairs at this pose, and the quadratic form of the error about it.
  Sums linearized(const Rigid& T) {
    frame_ = T;
    return summed(kFewPairs, [&](std::size_t begin, std::size_t end, Sums& sums) {
      find(T, begin, end);
      for (std::size_t i = begin; i < end; ++i) {
        Pair& pair = pairs_[i];
        if (pair.target == kNoPoint) continue;
        pair.W = weight(turned_back(T, pair.normal.data()), pair.own_normal);
        add(pair, point(i), residual(T, i, pair), sums);
      }
    });
  }

  // The error of the same pairs at another pose.
  double error(const Rigid& T) const {
    return summed(kFewErrors,
                  [&](std::size_t begin, std::size_t end, Sums& sums) {
                    for (std::size_t i = begin; i < end; ++i) {
                      const Pair& pair = pairs_[i];
                      if (pair.target == kNoPoint) continue;
                      const auto e = residual(T, i, pair);
                      const auto We = times(pair.W, e);
                      sums.error += 0.5 * (e[0] * We[0] + e[1] * We[1] + e[2] * We[2]);
                    }
                  })
        .error;
  }

 private:
  // Chunks are fixed and added up in order: no sum depends on who took which.
  template <typename Body>
  Sums summed(std::size_t few, const Body& body) const {
    const std::size_t n = pairs_.size();
    std::vector<Sums> parts((n + kChunk - 1) / kChunk);
    parallel_for(n, kChunk, n < few ? 1 : threads_, [&](std::size_t begin, std::size_t end, int) {
      body(begin, end, parts[begin / kChunk]);
    });
    Sums total;
    for (const Sums& part : parts) total.add(part);
    return total;
  }

  PointGrid::Point point(std::size_t i) const { return source_.grid()[i * stride_]; }

  std::array<double, 3> moved(const Rigid& T, std::size_t i) const {
    const PointGrid::Point p = point(i);
    const double s[3] = {p[0], p[1], p[2]};
    return T.apply(s);
  }

  // Pairs of points that moved too far for theirs to be sure.
  void find(const Rigid& T, std::size_t begin, std::size_t end) {
    std::vector<std::uint32_t> lost, targets, sources;
    std::vector<float> places;
    for (std::size_t i = begin; i < end; ++i) {
      const auto moved = this->moved(T, i);
      Pair& pair = pairs_[i];
      const PointGrid::Point p = {static_cast<float>(moved[0]), static_cast<float>(moved[1]),
                                  static_cast<float>(moved[2])};
      const float dx = p[0] - pair.at[0], dy = p[1] - pair.at[1], dz = p[2] - pair.at[2];
      if (std::sqrt(dx * dx + dy * dy + dz * dz) < pair.stays) continue;
      pair.at = p;
      lost.push_back(static_cast<std::uint32_t>(i));
      places.insert(places.end(), p.begin(), p.end());
    }
    const std::vector<GridNearest> nearest = target_.nearest(places, kLead * limit());
    std::size_t found = 0;
    for (std::size_t k = 0; k < lost.size(); ++k) {
      Pair& pair = pairs_[lost[k]];
      pair.target = nearest[k].point;
      const float next = std::sqrt(nearest[k].next);
      if (pair.target == kNoPoint) {
        pair.stays = static_cast<float>(next - limit() - kRounding);
        continue;
      }
      // Moved by less than half the lead, it is still the nearest, and still close enough.
      pair.stays = 0.5f * (std::min(next, static_cast<float>(limit())) - std::sqrt(nearest[k].squared));
      lost[found++] = lost[k];
      targets.push_back(pair.target);
      sources.push_back(static_cast<std::uint32_t>(lost[k] * stride_));
    }
    const auto normals = target_.normals(targets), own = source_.normals(sources);
    for (std::size_t k = 0; k < found; ++k) {
      pairs_[lost[k]].normal = normals[k];
      pairs_[lost[k]].own_normal = own[k];
    }
  }
  double limit() const { return target_.max_correspondence_distance(); }

  // In the source's frame at the last linearization.
  std::array<double, 3> residual(const Rigid& T, std::size_t i, const Pair& pair) const {
    const PointGrid::Point t = target_.grid()[pair.target];
    const auto moved = this->moved(T, i);
    const double e[3] = {t[0] - moved[0], t[1] - moved[1], t[2] - moved[2]};
    return turned_back(frame_, e);
  }

  // With J = (skew(s), -I), the error's derivative by a step of rotation and translation.
  static void add(const Pair& pair, const PointGrid::Point& s, const std::array<double, 3>& e,
                  Sums& sums) {
    const std::array<double, 6>& W = pair.W;
    const double x = s[0], y = s[1], z = s[2];
    // Columns of skew(s).
    const std::array<double, 3> J[3] = {{0, z, -y}, {-z, 0, x}, {y, -x, 0}};
    const std::array<double, 3> WJ[3] = {times(W, J[0]), times(W, J[1]), times(W, J[2])};
    const std::array<double, 3> We = times(W, e);
    const double Ws[3][3] = {{W[0], W[1], W[2]}, {W[1], W[3], W[4]}, {W[2], W[4], W[5]}};
    std::size_t k = 0;
    for (int a = 0; a < 3; ++a) {
      for (int b = a; b < 3; ++b) {
        sums.H[k++] += J[a][0] * WJ[b][0] + J[a][1] * WJ[b][1] + J[a][2] * WJ[b][2];
      }
      for (int b = 0; b < 3; ++b) sums.H[k++] -= WJ[a][b];
      sums.b[a] += J[a][0] * We[0] + J[a][1] * We[1] + J[a][2] * We[2];
      sums.b[3 + a] -= We[a];
    }
    for (int a = 0; a < 3; ++a) {
      for (int b = a; b < 3; ++b) sums.H[k++] += Ws[a][b];
    }
    sums.error += 0.5 * (e[0] * We[0] + e[1] * We[1] + e[2] * We[2]);
    ++sums.inliers;
  }

  const Surface& target_;
  const Surface& source_;
  std::size_t stride_;
  int threads_;
  std::vector<Pair> pairs_;
  Rigid frame_;
};

std::array<double, 36> full(const std::array<double, 21>& upper) {
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
    result.H = full(sums.H);
    result.error = sums.error;
    result.inliers = sums.inliers;
    done = true;  // unless a step that is not small lowers the error
    for (int tries = 0; tries < kTries && sums.inliers > 0; ++tries, damping *= kDampingFactor) {
      Vector6 step{};
      if (!solve(result.H, damping, sums.b, step)) continue;
      const Rigid moved = stepped(result.T, step);
      const double error = problem.error(moved);
      if (!(error < sums.error)) continue;
      result.T = moved;
      result.error = error;
      damping /= kDampingFactor;
      done = std::hypot(step[0], step[1], step[2]) <= options.rotation_step &&
             std::hypot(step[3], step[4], step[5]) <= options.translation_step;
      break;
    }
  }
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
    if (options.max_final == 0) return result;
  }
  const std::size_t share = source.size() / std::max<std::size_t>(1, options.fine);
  const std::size_t stride = std::max<std::size_t>(1, share);
  Problem most(target, source, stride, threads);
  optimise(most, rough > 1 ? options.max_final : options.max_iterations, options, result);
  for (double& h : result.H) h *= static_cast<double>(stride);
  return result;
}

}  // namespace segloc
