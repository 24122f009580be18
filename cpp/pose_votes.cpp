#include "pose_votes.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "parallel.h"

namespace segloc {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kSlack = 1.0;  // metres that half a step of yaw moves a typical segment
constexpr int kMinSteps = 36, kMaxSteps = 240;
constexpr int kMinBits = 16, kMaxBits = 18;  // cells of a table; larger maps are folded into it
constexpr std::size_t kCellsPerVoter = 16;
constexpr std::uint32_t kFewest = 3;
constexpr std::size_t kKeptPerStep = 48;

// The object that voted last, from 1 (upper 16 bits), and the votes (lower 16 bits).
using Counter = std::uint32_t;

// The matches that vote, one object after another.
struct Voters {
  std::vector<float> qx, qy, mx, my;  // queries relative to their middle
  std::vector<std::uint32_t> group, index;
  double middle[2] = {0.0, 0.0};
  double radius = 0.0;  // root mean square distance to the middle
};

Voters voters_of(const Field& f, std::size_t most) {
  Voters v;
  for (std::uint32_t i = 0; i < f.size(); ++i) {
    if (f.match[i] < most) v.index.push_back(i);
  }
  std::stable_sort(v.index.begin(), v.index.end(), [&](std::uint32_t a, std::uint32_t b) {
    return f.group[a] < f.group[b];
  });
  const double n = static_cast<double>(v.index.size());
  for (const std::uint32_t i : v.index) {
    v.middle[0] += f.qx[i] / n;
    v.middle[1] += f.qy[i] / n;
  }
  double squares = 0.0;
  for (const std::uint32_t i : v.index) {
    const double x = f.qx[i] - v.middle[0], y = f.qy[i] - v.middle[1];
    squares += x * x + y * y;
    v.qx.push_back(static_cast<float>(x));
    v.qy.push_back(static_cast<float>(y));
    v.mx.push_back(f.mx[i]);
    v.my.push_back(f.my[i]);
    v.group.push_back(f.group[i]);
  }
  v.radius = std::sqrt(squares / n);
  return v;
}

// The lattice of translations: cells are folded into a table, so that it stays in cache.
struct Lattice {
  float per_metre = 1.0f, low_x = 0.0f, low_y = 0.0f;
  int bits_x = 0, bits_y = 0;

  std::size_t cells() const { return std::size_t{1} << (bits_x + bits_y); }
};

int bits_for(double cells, int most) {
  int bits = 2;
  while (bits < most && static_cast<double>(std::size_t{1} << bits) < cells) ++bits;
  return bits;
}

Lattice make_lattice(const Voters& v, double width) {
  double farthest = 0.0;
  for (std::size_t k = 0; k < v.qx.size(); ++k) {
    farthest = std::max(farthest, std::hypot(double{v.qx[k]}, double{v.qy[k]}));
  }
  const auto [x0, x1] = std::minmax_element(v.mx.begin(), v.mx.end());
  const auto [y0, y1] = std::minmax_element(v.my.begin(), v.my.end());
  Lattice lattice;
  lattice.per_metre = static_cast<float>(1.0 / width);
  lattice.low_x = static_cast<float>(*x0 - farthest - 2.0 * width);
  lattice.low_y = static_cast<float>(*y0 - farthest - 2.0 * width);
  const int bits = std::max(kMinBits, bits_for(double(kCellsPerVoter * v.qx.size()), kMaxBits));
  const double across = (*x1 - *x0 + 2.0 * farthest) / width + 5.0;
  const double along = (*y1 - *y0 + 2.0 * farthest) / width + 5.0;
  lattice.bits_x = bits_for(across, bits - bits_for(along, bits / 2));
  lattice.bits_y = bits_for(along, bits - lattice.bits_x);
  return lattice;
}

struct Crowd {
  std::uint32_t votes, slot, voter;
  std::int32_t x, y;
};

// Scratch of one worker.
struct Table {
  std::vector<Counter> counters;
  std::vector<std::int32_t> x, y;
  std::vector<Crowd> crowds;
};

void locate(const Voters& v, const Lattice& lattice, double yaw, Table& table) {
  const auto c = static_cast<float>(std::cos(yaw)), s = static_cast<float>(std::sin(yaw));
  const std::size_t n = v.qx.size();
  for (std::size_t k = 0; k < n; ++k) {  // positive, so that cutting off is rounding down
    const float x = v.mx[k] - (c * v.qx[k] - s * v.qy[k]) - lattice.low_x;
    const float y = v.my[k] - (s * v.qx[k] + c * v.qy[k]) - lattice.low_y;
    table.x[k] = static_cast<std::int32_t>(x * lattice.per_metre);
    table.y[k] = static_cast<std::int32_t>(y * lattice.per_metre);
  }
}

// Nearly every branch here would be a coin toss: there are none but the last.
void count(const Voters& v, const Lattice& lattice, Table& table) {
  table.crowds.clear();
  std::fill(table.counters.begin(), table.counters.end(), 0);
  Counter* const counters = table.counters.data();
  const std::int32_t *const xs = table.x.data(), *const ys = table.y.data();
  const std::uint32_t mask_x = (1u << lattice.bits_x) - 1, mask_y = (1u << lattice.bits_y) - 1;
  const int shift = lattice.bits_x;
  const auto voters = static_cast<std::uint32_t>(v.qx.size());
  for (std::uint32_t k = 0; k < voters; ++k) {
    const std::uint32_t group = (v.group[k] + 1) & 0xffffu;
    const auto x = static_cast<std::uint32_t>(xs[k]), y = static_cast<std::uint32_t>(ys[k]);
    const std::uint32_t columns[2] = {x & mask_x, (x + 1) & mask_x};
    const std::uint32_t rows[2] = {(y & mask_y) << shift, ((y + 1) & mask_y) << shift};
    for (std::uint32_t corner = 0; corner < 4; ++corner) {
      const std::uint32_t slot = rows[corner >> 1] | columns[corner & 1];
      const Counter old = counters[slot];
      const std::uint32_t fresh = (old >> 16) != group;
      const std::uint32_t votes = (old & 0xffffu) + fresh;
      counters[slot] = group << 16 | votes;
      if ((votes == kFewest) & fresh) {
        table.crowds.push_back({0, slot, k, xs[k] + static_cast<std::int32_t>(corner & 1),
                                ys[k] + static_cast<std::int32_t>(corner >> 1)});
      }
    }
  }
}

// The fullest cells of one step of yaw.
void keep_fullest(Table& table) {
  for (Crowd& crowd : table.crowds) crowd.votes = table.counters[crowd.slot] & 0xffffu;
  const auto fuller = [](const Crowd& a, const Crowd& b) {
    return a.votes != b.votes ? a.votes > b.votes : a.slot < b.slot;
  };
  if (table.crowds.size() > kKeptPerStep) {
    const auto end = table.crowds.begin() + static_cast<std::ptrdiff_t>(kKeptPerStep);
    std::nth_element(table.crowds.begin(), end, table.crowds.end(), fuller);
    table.crowds.erase(end, table.crowds.end());
  }
  std::sort(table.crowds.begin(), table.crowds.end(), fuller);
}

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

  std::vector<Table> tables(static_cast<std::size_t>(resolve_threads(threads)));
  std::vector<std::vector<PoseCell>> found(static_cast<std::size_t>(steps));
  parallel_for(found.size(), 1, threads, [&](std::size_t begin, std::size_t end, int worker) {
    Table& table = tables[static_cast<std::size_t>(worker)];
    table.counters.resize(lattice.cells(), 0);
    table.x.resize(v.qx.size());
    table.y.resize(v.qx.size());
    for (std::size_t step = begin; step < end; ++step) {
      const double yaw = static_cast<double>(step) * turn - kPi;
      locate(v, lattice, yaw, table);
      count(v, lattice, table);
      keep_fullest(table);
      const double c = std::cos(yaw), s = std::sin(yaw);
      for (const Crowd& crowd : table.crowds) {
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
