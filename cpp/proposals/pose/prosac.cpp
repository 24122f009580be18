#include "proposals/pose/prosac.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>

namespace segloc {
namespace {

// splitmix64: small, and the same numbers on every platform (std::uniform_int_distribution is not).
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}

  std::size_t below(std::size_t n) {
    state_ += 0x9E3779B97F4A7C15ull;
    std::uint64_t z = state_;
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ull;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBull;
    z ^= z >> 31;
    return static_cast<std::size_t>(z % n);
  }

 private:
  std::uint64_t state_;
};

constexpr std::size_t kSample = 3;  // matches that fix a pose

// The growing pool of the paper: how many of the best matches the t-th sample is drawn from.
class Pool {
 public:
  Pool(std::size_t total, double max_draws, bool ordered)
      : total_(total), n_(ordered ? kSample : total), ordered_(ordered) {
    drawn_ = max_draws;
    for (std::size_t i = 0; i < kSample; ++i) drawn_ *= double(kSample - i) / double(total - i);
  }

  // Advances to draw t (from 1). Returns whether the newest match of the pool must be in the
  // sample. The published listing has this test the wrong way round; its text and its author's
  // later code agree on this one.
  bool advance(std::size_t t) {
    if (!ordered_) return false;
    while (t > limit_ && n_ < total_) {
      const double next = drawn_ * double(n_ + 1) / double(n_ + 1 - kSample);
      limit_ += static_cast<std::size_t>(std::ceil(next - drawn_));
      drawn_ = next;
      ++n_;
    }
    return t <= limit_;
  }

  std::size_t size() const { return n_; }

 private:
  std::size_t total_, n_;
  bool ordered_;
  double drawn_;           // T_n
  std::size_t limit_ = 1;  // T'_n
};

double distance(const double* points, std::size_t i, std::size_t j) {
  const double dx = points[3 * i] - points[3 * j], dy = points[3 * i + 1] - points[3 * j + 1];
  const double dz = points[3 * i + 2] - points[3 * j + 2];
  return std::sqrt(dx * dx + dy * dy + dz * dz);
}

class Search {
 public:
  Search(const double* source, const double* target, const std::int64_t* query_id,
         const std::int64_t* map_id, std::size_t n, const ProsacOptions& o)
      : source_(source), target_(target), n_(n), o_(o), random_(o.seed) {
    number(query_id, query_);
    number(map_id, map_);
  }

  std::vector<SampledHypothesis> run() {
    Pool pool(n_, double(o_.max_draws), o_.ordered);
    double needed = double(o_.max_draws);
    std::vector<std::size_t> sample(kSample);
    for (std::size_t t = 1; t <= o_.max_draws && double(t) <= needed; ++t) {
      const bool newest = pool.advance(t);
      if (!draw(pool.size(), newest, sample)) continue;
      const std::size_t before = best_;
      consider(fit_rigid(source_, target_, sample));
      if (best_ > before) needed = std::min(needed, draws_needed());
    }
    return std::move(found_);
  }

 private:
  // Segments are renumbered densely, so that "seen" marks fit into arrays.
  void number(const std::int64_t* ids, std::vector<std::uint32_t>& dense) {
    std::unordered_map<std::int64_t, std::uint32_t> known;
    dense.resize(n_);
    for (std::size_t k = 0; k < n_; ++k) {
      dense[k] = known.emplace(ids[k], static_cast<std::uint32_t>(known.size())).first->second;
    }
    marks_.push_back(std::vector<std::uint32_t>(known.size(), 0));
  }

  // Draws a sample; false if its edges do not agree, which rejects nearly all wrong ones unfitted.
  bool draw(std::size_t pool, bool newest, std::vector<std::size_t>& sample) {
    for (std::size_t i = 0; i < kSample; ++i) {
      const bool fixed = newest && i == 0;
      sample[i] = fixed ? pool - 1 : random_.below(newest ? pool - 1 : pool);
      for (std::size_t j = 0; j < i; ++j) {
        if (!edges_agree(sample[i], sample[j])) return false;
      }
    }
    return !collinear(sample);
  }

  bool edges_agree(std::size_t i, std::size_t j) const {
    if (query_[i] == query_[j] || map_[i] == map_[j]) return false;
    const double a = distance(source_, i, j);
    return a >= o_.min_edge && std::fabs(a - distance(target_, i, j)) <= o_.edge_tolerance;
  }

  bool collinear(const std::vector<std::size_t>& s) const {
    const double a = distance(source_, s[0], s[1]), b = distance(source_, s[1], s[2]);
    const double c = distance(source_, s[2], s[0]), h = (a + b + c) / 2;
    const double area = std::sqrt(std::max(h * (h - a) * (h - b) * (h - c), 0.0));
    return 2.0 * area < o_.min_edge / 2 * std::max({a, b, c});  // height over the longest edge
  }

  // One-to-one inliers in match order: each query and each map segment counts once.
  void collect(const Rigid& T, std::vector<std::size_t>& inliers) {
    inliers.clear();
    ++round_;
    const double limit = o_.inlier_tolerance * o_.inlier_tolerance;
    for (std::size_t k = 0; k < n_; ++k) {
      const auto p = T.apply(source_ + 3 * k);
      const double* q = target_ + 3 * k;
      const double dx = p[0] - q[0], dy = p[1] - q[1], dz = p[2] - q[2];
      if (dx * dx + dy * dy + dz * dz > limit) continue;
      if (marks_[0][query_[k]] == round_ || marks_[1][map_[k]] == round_) continue;
      marks_[0][query_[k]] = marks_[1][map_[k]] = round_;
      inliers.push_back(k);
    }
  }

  // Local optimisation: a promising pose is refitted to its own inliers while that gains any.
  void consider(Rigid T) {
    collect(T, inliers_);
    if (inliers_.size() < kSample || 2 * inliers_.size() < best_) return;
    for (int round = 0; round < 5; ++round) {
      const Rigid refitted = fit_rigid(source_, target_, inliers_);
      collect(refitted, refit_);
      if (refit_.size() < inliers_.size()) break;
      const bool gained = refit_.size() > inliers_.size();
      T = refitted;
      inliers_.swap(refit_);
      if (!gained && round > 0) break;
    }
    remember({T, inliers_.size()});
    if (inliers_.size() > best_) {
      best_ = inliers_.size();
      best_inliers_ = inliers_;
    }
  }

  bool same_place(const Rigid& a, const Rigid& b) const {
    // Compared where the query is, not at the origin of a frame that may be far away.
    const auto p = a.apply(source_), q = b.apply(source_);
    double trace = 0.0;
    for (int k = 0; k < 9; ++k) trace += a.R[k] * b.R[k];
    return std::hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]) < o_.separation &&
           trace > 1.0 + 2.0 * std::cos(o_.separation_angle);
  }

  void remember(const SampledHypothesis& hypothesis) {
    for (SampledHypothesis& known : found_) {
      if (!same_place(known.T, hypothesis.T)) continue;
      if (hypothesis.inliers > known.inliers) known = hypothesis;
      sort_found();
      return;
    }
    found_.push_back(hypothesis);
    sort_found();
    if (found_.size() > o_.max_hypotheses) found_.pop_back();
  }

  void sort_found() {
    std::stable_sort(found_.begin(), found_.end(),
                     [](const auto& a, const auto& b) { return a.inliers > b.inliers; });
  }

  // The stopping rules: over all prefixes n of the matches that hold more inliers than chance
  // explains (non-randomness), the least number of draws after which a better set is unlikely to
  // have been missed (maximality).
  double draws_needed() const {
    double fewest = std::numeric_limits<double>::infinity();
    std::size_t next = 0;
    for (std::size_t n = 1; n <= n_; ++n) {
      if (next < best_inliers_.size() && best_inliers_[next] == n - 1) ++next;
      if (n <= kSample || (!o_.ordered && n < n_)) continue;
      const double b = o_.chance, pool = double(n);
      const double by_chance = double(kSample) + pool * b + std::sqrt(2.706 * pool * b * (1.0 - b));
      if (double(next) < std::ceil(by_chance)) continue;
      const double all_good = std::pow(double(next) / pool, double(kSample));
      const double draws = all_good >= 1.0 ? 1.0 : std::log(o_.missed) / std::log1p(-all_good);
      fewest = std::min(fewest, draws);
    }
    return fewest;
  }

  const double *source_, *target_;
  std::size_t n_;
  const ProsacOptions& o_;
  Random random_;
  std::vector<std::uint32_t> query_, map_;
  std::vector<std::vector<std::uint32_t>> marks_;
  std::uint32_t round_ = 0;
  std::vector<std::size_t> inliers_, refit_, best_inliers_;
  std::size_t best_ = 0;
  std::vector<SampledHypothesis> found_;
};

}  // namespace

std::vector<SampledHypothesis> prosac(const double* source, const double* target,
                                      const std::int64_t* query_id, const std::int64_t* map_id,
                                      std::size_t n, const ProsacOptions& options) {
  if (n < kSample) return {};
  return Search(source, target, query_id, map_id, n, options).run();
}

}  // namespace segloc
