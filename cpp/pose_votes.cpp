#include "pose_votes.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>

#include "parallel.h"

namespace segloc {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kSlack = 1.0;  // metres that half a step of yaw moves a typical segment
constexpr int kMinSteps = 36, kMaxSteps = 240;
constexpr int kMinBits = 16, kMaxBits = 18;  // cells of a table; larger maps are folded into it
constexpr int kMinBitsX = 5;  // a row of the table fills vectors
constexpr std::size_t kCellsPerVoter = 16;
constexpr std::uint32_t kFewest = 3;
constexpr std::size_t kKeptPerStep = 48;
constexpr std::uint32_t kMostCounted = 63;  // in a cell: the sum of four fits its byte
constexpr std::uint32_t kMarks = 255;       // objects that a byte tells apart
constexpr std::size_t kFront = 32;          // values before a table

// The matches that vote, one object after another.
struct Voters {
  std::vector<float> qx, qy, mx, my;  // queries relative to their middle
  std::vector<std::uint32_t> group, index;
  std::vector<std::uint16_t> mark;  // of the object, where a cell keeps it
  std::vector<std::size_t> spans;   // borders of stretches in which objects have different marks
  double middle[2] = {0.0, 0.0};
  double radius = 0.0;  // root mean square distance to the middle

  std::size_t size() const { return index.size(); }
  MatchField columns() const { return {qx.data(), qy.data(), mx.data(), my.data()}; }
};

// The first `most` matches, by object; those of one object keep their order.
std::vector<std::uint32_t> by_object(const Field& f, std::size_t most) {
  std::vector<std::size_t> next(f.groups + 1, 0);
  for (std::size_t i = 0; i < f.size(); ++i) next[f.group[i] + 1] += f.match[i] < most;
  for (std::size_t g = 0; g < f.groups; ++g) next[g + 1] += next[g];
  std::vector<std::uint32_t> order(next.back());
  for (std::uint32_t i = 0; i < f.size(); ++i) {
    if (f.match[i] < most) order[next[f.group[i]]++] = i;
  }
  return order;
}

Voters voters_of(const Field& f, std::size_t most) {
  Voters v;
  v.index = by_object(f, most);
  const std::size_t count = v.index.size();
  for (std::vector<float>* column : {&v.qx, &v.qy, &v.mx, &v.my}) column->resize(count);
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
    v.mx[k] = f.mx[i];
    v.my[k] = f.my[i];
    v.group[k] = group;
    v.mark[k] = static_cast<std::uint16_t>((group % kMarks + 1) << 8);
    if (k == 0 || group / kMarks != v.group[k - 1] / kMarks) v.spans.push_back(k);
  }
  v.spans.push_back(count);
  v.radius = std::sqrt(squares / n);
  return v;
}

// The lattice of translations: cells are folded into a table, so that it stays in cache.
struct Lattice {
  float per_metre = 1.0f, low_x = 0.0f, low_y = 0.0f;
  int bits_x = 0, bits_y = 0;

  std::size_t cells() const { return std::size_t{1} << (bits_x + bits_y); }
  std::uint32_t mask_x() const { return (1u << bits_x) - 1; }
  std::uint32_t mask_y() const { return (1u << bits_y) - 1; }
  VoteLattice at(double yaw) const {
    return {static_cast<float>(std::cos(yaw)), static_cast<float>(std::sin(yaw)), low_x, low_y,
            per_metre, mask_x(), mask_y(), bits_x};
  }
};

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

// A window of two by two cells, named by its last one.
struct Crowd {
  std::uint32_t votes, slot, voter;
  std::int32_t x, y;  // on the lattice, not folded
};

// How many votes a window needs to be among the fullest of all steps, as far as is known. Counts
// only what is surely returned or surpassed, so it may be asked at any time, by any thread, and what
// it keeps out could never have been returned.
class Hurdle {
 public:
  explicit Hurdle(std::size_t most) : most_(most) {}

  std::uint32_t height() const {
    std::size_t fuller = 0;
    for (std::uint32_t votes = kMostCounted; votes > kFewest; --votes) {
      fuller += tally_[votes].load(std::memory_order_relaxed);
      if (fuller >= most_) return votes;
    }
    return kFewest;
  }
  void add(std::uint32_t votes) {
    tally_[std::min(votes, kMostCounted)].fetch_add(1, std::memory_order_relaxed);
  }

 private:
  std::size_t most_;
  std::array<std::atomic<std::size_t>, kMostCounted + 1> tally_{};
};

// Nearly every branch in these two loops would be a coin toss: there are none.

// Voters from `begin` to `end` each count in their own cell, once for each object in a row.
void count_span(const std::uint32_t* own, const std::uint16_t* mark, std::size_t begin,
                std::size_t end, std::uint16_t* cells) {
  for (std::size_t k = begin; k < end; ++k) {
    std::uint16_t& cell = cells[own[k]];
    const std::uint32_t old = cell, voter = mark[k];
    const std::uint32_t votes = (old & kVotes) + ((old ^ voter) > kVotes);
    cell = static_cast<std::uint16_t>(voter | std::min(votes, kMostCounted));
  }
}

// The voters whose cell has its bit set.
std::size_t voters_inside(const std::uint32_t* own, std::size_t count, const std::uint64_t* wanted,
                          std::uint32_t* inside) {
  std::size_t found = 0;
  for (std::uint32_t k = 0; k < count; ++k) {
    inside[found] = k;
    found += wanted[own[k] >> 6] >> (own[k] & 63) & 1;
  }
  return found;
}

// One step of yaw after another, in the scratch memory of one worker. First every voter counts in
// its own cell, which is quick. The votes of four cells together bound those of a window: an object
// may have voted in several of them. Only where the bound reaches the hurdle, which few windows in a
// million do, are the objects of the window counted.
class Ballot {
 public:
  void resize(const Voters& v, const Lattice& lattice) {
    if (!cells_.empty()) return;
    cells_.resize(kFront + lattice.cells());
    windows_.resize(lattice.cells());
    full_.resize(lattice.cells() / 64);
    first_.resize(lattice.cells() / 64);
    wanted_.resize(lattice.cells() / 64);
    own_.resize(v.size());
    inside_.resize(v.size());
  }

  // The fullest windows at that yaw, of those with at least `fewest` votes.
  const std::vector<Crowd>& fullest(const Voters& v, const Lattice& lattice, double yaw,
                                    std::uint32_t fewest, const Kernels& kernels) {
    const VoteLattice at = lattice.at(yaw);
    kernels.vote_cells(v.columns(), v.size(), at, own_.data());
    count_cells(v);
    const std::size_t found =
        kernels.full_windows(cells_.data() + kFront, std::size_t{1} << lattice.bits_x,
                             std::size_t{1} << lattice.bits_y, fewest, windows_.data());
    crowds_.clear();
    if (found == 0) return crowds_;
    mark_windows(lattice, found, true);
    count_objects(v, lattice, at, found);
    mark_windows(lattice, found, false);
    keep_fullest(fewest);
    return crowds_;
  }

 private:
  void count_cells(const Voters& v) {
    std::uint16_t* const cells = cells_.data() + kFront;
    for (std::size_t span = 0; span + 1 < v.spans.size(); ++span) {
      if (span > 0) {  // marks are given again
        for (std::uint16_t& cell : cells_) cell &= kVotes;
      }
      count_span(own_.data(), v.mark.data(), v.spans[span], v.spans[span + 1], cells);
    }
  }

  // Which windows were found, and which cells belong to one of them.
  void mark_windows(const Lattice& lattice, std::size_t found, bool wanted) {
    const auto mark = [wanted](std::vector<std::uint64_t>& bits, std::uint32_t at) {
      const std::uint64_t bit = std::uint64_t{1} << (at & 63);
      bits[at >> 6] = wanted ? bits[at >> 6] | bit : bits[at >> 6] & ~bit;
    };
    for (std::size_t w = 0; w < found; ++w) {
      const std::uint32_t x = windows_[w] & lattice.mask_x(), y = windows_[w] >> lattice.bits_x;
      for (const std::uint32_t row : {y, (y - 1) & lattice.mask_y()}) {
        for (const std::uint32_t column : {x, (x - 1) & lattice.mask_x()}) {
          mark(wanted_, row << lattice.bits_x | column);
        }
      }
      mark(full_, windows_[w]);
    }
  }

  // Distinct objects in the windows that were found. A counter holds the object that voted last,
  // from 1 (upper 16 bits), and the votes (lower 16 bits). The number of a window's counter is that
  // of the first one in its word of bits, and one more for each bit below.
  void count_objects(const Voters& v, const Lattice& lattice, const VoteLattice& at,
                     std::size_t found) {
    counters_.assign(found, 0);
    for (std::size_t w = found; w-- > 0;) {
      first_[windows_[w] >> 6] = static_cast<std::uint32_t>(w);
    }
    const std::size_t inside = voters_inside(own_.data(), v.size(), wanted_.data(), inside_.data());
    for (std::size_t i = 0; i < inside; ++i) {
      const std::uint32_t k = inside_[i], group = (v.group[k] + 1) & 0xffffu;
      const std::uint32_t x = own_[k] & lattice.mask_x(), y = own_[k] >> lattice.bits_x;
      for (std::uint32_t corner = 0; corner < 4; ++corner) {
        const std::uint32_t column = (x + (corner & 1)) & lattice.mask_x();
        const std::uint32_t slot = ((y + (corner >> 1)) & lattice.mask_y()) << lattice.bits_x | column;
        const std::uint64_t word = full_[slot >> 6], bit = std::uint64_t{1} << (slot & 63);
        if ((word & bit) == 0) continue;
        const auto below = static_cast<std::uint32_t>(__builtin_popcountll(word & (bit - 1)));
        const std::uint32_t number = first_[slot >> 6] + below;
        const std::uint32_t old = counters_[number], fresh = (old >> 16) != group;
        const std::uint32_t votes = (old & 0xffffu) + fresh;
        counters_[number] = group << 16 | votes;
        if ((votes == kFewest) & fresh) {
          crowds_.push_back(crowd_of(v, at, k, slot, corner));
          crowds_.back().votes = number;
        }
      }
    }
    for (Crowd& crowd : crowds_) crowd.votes = counters_[crowd.votes] & 0xffffu;
  }

  static Crowd crowd_of(const Voters& v, const VoteLattice& l, std::uint32_t k, std::uint32_t slot,
                        std::uint32_t corner) {
    const float x = v.mx[k] - (l.cosine * v.qx[k] - l.sine * v.qy[k]) - l.low_x;
    const float y = v.my[k] - (l.sine * v.qx[k] + l.cosine * v.qy[k]) - l.low_y;
    return {0, slot, k, static_cast<std::int32_t>(x * l.per_metre) + std::int32_t(corner & 1),
            static_cast<std::int32_t>(y * l.per_metre) + std::int32_t(corner >> 1)};
  }

  void keep_fullest(std::uint32_t fewest) {
    crowds_.erase(std::remove_if(crowds_.begin(), crowds_.end(),
                                 [&](const Crowd& crowd) { return crowd.votes < fewest; }),
                  crowds_.end());
    const auto fuller = [](const Crowd& a, const Crowd& b) {
      return a.votes != b.votes ? a.votes > b.votes : a.slot < b.slot;
    };
    if (crowds_.size() > kKeptPerStep) {
      const auto end = crowds_.begin() + static_cast<std::ptrdiff_t>(kKeptPerStep);
      std::nth_element(crowds_.begin(), end, crowds_.end(), fuller);
      crowds_.erase(end, crowds_.end());
    }
    std::sort(crowds_.begin(), crowds_.end(), fuller);
  }

  std::vector<std::uint16_t> cells_;    // votes of each, behind kFront others; clear between steps
  std::vector<std::uint32_t> own_;      // cell of each voter
  std::vector<std::uint32_t> windows_;  // that may be full, in rising order where bits share a word
  std::vector<std::uint64_t> full_;     // those windows, a bit each; clear between steps
  std::vector<std::uint64_t> wanted_;   // cells of those windows, likewise
  std::vector<std::uint32_t> first_;    // number of the first window in each word of full_
  std::vector<std::uint32_t> counters_;  // one for each of those windows
  std::vector<std::uint32_t> inside_;    // voters in wanted cells
  std::vector<Crowd> crowds_;
};

}  // namespace

PoseVotes vote_for_poses(const Field& f, const VoteOptions& o, int threads) {
  const Voters v = voters_of(f, o.max_votes);
  if (v.index.empty()) return {};
  const double fine = 2.0 * kPi * std::max(v.radius, 1.0) / (2.0 * kSlack);
  const int steps = std::clamp(static_cast<int>(std::ceil(fine)), kMinSteps, kMaxSteps);
  const double turn = 2.0 * kPi / steps;
  PoseVotes result;
  result.turn = turn;
  std::copy_n(v.middle, 2, result.middle);
  result.radius = v.radius;
  result.width = 2.0 * (0.7 * o.tolerance + 0.5 * turn * std::max(v.radius, 1.0));
  const Lattice lattice = make_lattice(v, result.width);

  const Kernels& kernel_table = kernels(parse_isa("auto"));
  Hurdle hurdle(o.max_cells);
  std::vector<Ballot> ballots(static_cast<std::size_t>(resolve_threads(threads)));
  std::vector<std::vector<PoseCell>> found(static_cast<std::size_t>(steps));
  parallel_for(found.size(), 1, threads, [&](std::size_t begin, std::size_t end, int worker) {
    Ballot& ballot = ballots[static_cast<std::size_t>(worker)];
    ballot.resize(v, lattice);
    for (std::size_t step = begin; step < end; ++step) {
      const double yaw = static_cast<double>(step) * turn - kPi;
      const double c = std::cos(yaw), s = std::sin(yaw);
      for (const Crowd& crowd : ballot.fullest(v, lattice, yaw, hurdle.height(), kernel_table)) {
        hurdle.add(crowd.votes);
        const double x = crowd.x * result.width + lattice.low_x;
        const double y = crowd.y * result.width + lattice.low_y;
        found[step].push_back({crowd.votes, v.index[crowd.voter], yaw,
                               x - (c * v.middle[0] - s * v.middle[1]),
                               y - (s * v.middle[0] + c * v.middle[1])});
      }
    }
  });
  for (const auto& cells : found) result.cells.insert(result.cells.end(), cells.begin(), cells.end());
  std::stable_sort(result.cells.begin(), result.cells.end(),
                   [](const PoseCell& a, const PoseCell& b) { return a.votes > b.votes; });
  if (result.cells.size() > o.max_cells) result.cells.resize(o.max_cells);
  return result;
}

}  // namespace segloc
