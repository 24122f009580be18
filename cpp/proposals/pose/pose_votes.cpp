#include "proposals/pose/pose_votes.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>

#include "common/angles.h"
#include "common/parallel.h"
#include "proposals/pose/hough_accumulator.h"

namespace segloc {
namespace {

constexpr double kSlack = 1.0;  // metres that half a step of yaw moves a typical segment
constexpr int kMinSteps = 36, kMaxSteps = 240;
constexpr int kMinBits = 16, kMaxBits = 18;  // cells of a table; larger maps are folded into it
constexpr int kMinBitsX = 5;                 // a row of the table fills vectors
constexpr std::size_t kCellsPerVoter = 16;
constexpr float kFarthest = 1e8f;  // metres; cells of what is farther away could not be numbered

// The first `most` matches, by object; those of one object keep their order.
std::vector<std::uint32_t> by_object(const MatchTable& f, std::size_t most) {
  std::vector<std::size_t> next(f.groups + 1, 0);
  for (std::size_t i = 0; i < f.size(); ++i) next[f.group[i] + 1] += f.match[i] < most;
  for (std::size_t g = 0; g < f.groups; ++g) next[g + 1] += next[g];
  std::vector<std::uint32_t> order(next.back());
  for (std::uint32_t i = 0; i < f.size(); ++i) {
    if (f.match[i] < most) order[next[f.group[i]]++] = i;
  }
  return order;
}

Voters voters_of(const MatchTable& f, std::size_t most) {
  Voters v;
  v.index = by_object(f, most);
  const std::size_t count = v.index.size();
  for (std::vector<float>* coordinate : {&v.qx, &v.qy, &v.mx, &v.my}) coordinate->resize(count);
  v.group.resize(count);
  v.mark.resize(count);
  const double n = static_cast<double>(count);
  for (const std::uint32_t i : v.index) {
    v.middle[0] += f.qx[i] / n;
    v.middle[1] += f.qy[i] / n;
  }
  double squares = 0.0;
  for (std::size_t k = 0; k < count; ++k) {
    const std::uint32_t i = v.index[k], group = f.group[i];
    const double x = f.qx[i] - v.middle[0], y = f.qy[i] - v.middle[1];
    squares += x * x + y * y;
    v.qx[k] = static_cast<float>(x);
    v.qy[k] = static_cast<float>(y);
    v.mx[k] = std::clamp(f.mx[i], -kFarthest, kFarthest);
    v.my[k] = std::clamp(f.my[i], -kFarthest, kFarthest);
    v.group[k] = group;
    v.mark[k] = static_cast<std::uint16_t>((group % kMarks + 1) << 8);
    if (k == 0 || group / kMarks != v.group[k - 1] / kMarks) v.spans.push_back(k);
  }
  v.spans.push_back(count);
  v.radius = std::sqrt(squares / n);
  return v;
}

int bits_for(double cells, int most) {
  int bits = 2;
  while (bits < most && static_cast<double>(std::size_t{1} << bits) < cells) ++bits;
  return bits;
}

Lattice make_lattice(const Voters& v, double width) {
  double farthest = 0.0;
  for (std::size_t k = 0; k < v.size(); ++k) {
    farthest = std::max(farthest, double{v.qx[k]} * v.qx[k] + double{v.qy[k]} * v.qy[k]);
  }
  farthest = std::sqrt(farthest);
  const auto [x0, x1] = std::minmax_element(v.mx.begin(), v.mx.end());
  const auto [y0, y1] = std::minmax_element(v.my.begin(), v.my.end());
  Lattice lattice;
  lattice.per_metre = static_cast<float>(1.0 / width);
  lattice.low_x = static_cast<float>(*x0 - farthest - 2.0 * width);
  lattice.low_y = static_cast<float>(*y0 - farthest - 2.0 * width);
  const int bits = std::max(kMinBits, bits_for(double(kCellsPerVoter * v.size()), kMaxBits));
  const double across = (*x1 - *x0 + 2.0 * farthest) / width + 5.0;
  const double along = (*y1 - *y0 + 2.0 * farthest) / width + 5.0;
  lattice.bits_x = bits_for(across, bits - bits_for(along, bits / 2));
  lattice.bits_y = bits_for(along, bits - lattice.bits_x);
  lattice.bits_x = std::max(lattice.bits_x, kMinBitsX);
  return lattice;
}

// Lower bound of the votes of a returned peak. It counts only peaks that are returned or surpassed,
// so any thread may read it at any time: it excludes no peak of the result.
class VoteThreshold {
 public:
  explicit VoteThreshold(const VoteOptions& o) : o_(o) {}

  std::uint32_t value() const {
    std::size_t higher = 0;
    double best = 0.0;
    for (std::uint32_t votes = kMostCountedVotes; votes > kFewestVotes; --votes) {
      higher += tally_[votes].load(std::memory_order_relaxed);
      if (higher > 0) best = std::max(best, double(votes));
      if (higher >= o_.max_cells) return votes;
      if (higher >= o_.fewest_cells && votes < o_.least_share * best) return votes;
    }
    return kFewestVotes;
  }
  void add(std::uint32_t votes) {
    tally_[std::min(votes, kMostCountedVotes)].fetch_add(1, std::memory_order_relaxed);
  }

 private:
  VoteOptions o_;
  std::array<std::atomic<std::size_t>, kMostCountedVotes + 1> tally_{};
};

}  // namespace

PoseVotes vote_for_poses(const MatchTable& f, const VoteOptions& o, int threads) {
  const Voters v = voters_of(f, o.max_votes);
  if (v.index.empty()) return {};
  const double fine = 2.0 * kPi * std::max(v.radius, 1.0) / (2.0 * kSlack);
  const auto steps = static_cast<int>(
      std::clamp(std::ceil(fine), static_cast<double>(kMinSteps), static_cast<double>(kMaxSteps)));
  const double turn = 2.0 * kPi / steps;
  PoseVotes result;
  result.turn = turn;
  std::copy_n(v.middle, 2, result.middle);
  result.radius = v.radius;
  result.width = 2.0 * (0.7 * o.tolerance + 0.5 * turn * std::max(v.radius, 1.0));
  const Lattice lattice = make_lattice(v, result.width);

  const Kernels& kernel_table = kernels(parse_isa("auto"));
  VoteThreshold threshold(o);
  std::vector<HoughAccumulator> accumulators(static_cast<std::size_t>(resolve_threads(threads)));
  std::vector<std::vector<PoseCell>> found(static_cast<std::size_t>(steps));
  parallel_for(found.size(), 1, threads, [&](std::size_t begin, std::size_t end, int worker) {
    HoughAccumulator& accumulator = accumulators[static_cast<std::size_t>(worker)];
    accumulator.resize(v, lattice);
    for (std::size_t step = begin; step < end; ++step) {
      const double yaw = static_cast<double>(step) * turn - kPi;
      const double c = std::cos(yaw), s = std::sin(yaw);
      for (const Peak& peak : accumulator.peaks(v, lattice, yaw, threshold.value(), kernel_table)) {
        threshold.add(peak.votes);
        const double x = peak.x * result.width + lattice.low_x;
        const double y = peak.y * result.width + lattice.low_y;
        found[step].push_back({peak.votes, v.index[peak.voter], yaw,
                               x - (c * v.middle[0] - s * v.middle[1]),
                               y - (s * v.middle[0] + c * v.middle[1])});
      }
    }
  });
  for (const auto& cells : found)
    result.cells.insert(result.cells.end(), cells.begin(), cells.end());
  std::stable_sort(result.cells.begin(), result.cells.end(),
                   [](const PoseCell& a, const PoseCell& b) { return a.votes > b.votes; });
  if (result.cells.size() > o.max_cells) result.cells.resize(o.max_cells);
  while (result.cells.size() > o.fewest_cells &&
         result.cells.back().votes < o.least_share * result.cells.front().votes) {
    result.cells.pop_back();
  }
  return result;
}

}  // namespace segloc
