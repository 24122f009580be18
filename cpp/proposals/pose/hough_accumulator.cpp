#include "proposals/pose/hough_accumulator.h"

#include <algorithm>
#include <array>
#include <utility>

#include "proposals/pose/match_table.h"

namespace segloc {
namespace {

constexpr std::size_t kKeptPerStep = 48;
constexpr std::size_t kFront = 32;  // values before a table

// Voters from `begin` to `end` each count in their own cell, once for each object in a row. Nearly
// every branch would be a coin toss: there is none.
void count_span(const std::uint32_t* own, const std::uint16_t* mark, std::size_t begin,
                std::size_t end, std::uint16_t* cells) {
  for (std::size_t k = begin; k < end; ++k) {
    std::uint16_t& cell = cells[own[k]];
    const std::uint32_t old = cell, voter = mark[k];
    const std::uint32_t votes = (old & kVotes) + ((old ^ voter) > kVotes);
    cell = static_cast<std::uint16_t>(voter | std::min(votes, kMostCountedVotes));
  }
}

}  // namespace

void HoughAccumulator::resize(const Voters& v, const Lattice& lattice) {
  if (!cells_.empty()) return;
  cells_.resize(kFront + lattice.cells());
  windows_.reset(new std::uint32_t[lattice.cells()]);
  numbers_.reset(new std::uint32_t[lattice.cells()]);
  wanted_.resize(lattice.cells() / 32);
  own_.resize(v.size());
  seen_.resize(v.size() == 0 ? 0 : v.group.back() + 1);
}

const std::vector<Peak>& HoughAccumulator::peaks(const Voters& v, const Lattice& lattice,
                                                 double yaw, std::uint32_t fewest,
                                                 const Kernels& kernels) {
  const VoteLattice at = lattice.at(yaw);
  kernels.vote_cells(v.arrays(), v.size(), at, own_.data());
  count_cells(v);
  const std::size_t found =
      kernels.full_windows(cells_.data() + kFront, std::size_t{1} << lattice.bits_x,
                           std::size_t{1} << lattice.bits_y, fewest, windows_.get());
  peaks_.clear();
  if (found == 0) return peaks_;
  // Windows with the highest bounds mostly have enough peaks: none of the others has a higher one.
  for (std::uint32_t least = bound_of_likely(found, fewest);; least = fewest) {
    peaks_.clear();
    gather_voters(lattice, found, least, kernels);
    count_objects(v, least);
    if (least == fewest || peaks_.size() >= kKeptPerStep) break;
  }
  keep_highest();
  for (Peak& peak : peaks_) place(v, at, peak);
  return peaks_;
}

void HoughAccumulator::count_cells(const Voters& v) {
  std::uint16_t* const cells = cells_.data() + kFront;
  for (std::size_t span = 0; span + 1 < v.spans.size(); ++span) {
    if (span > 0) {  // marks are given again
      for (std::uint16_t& cell : cells_) cell &= kVotes;
    }
    count_span(own_.data(), v.mark.data(), v.spans[span], v.spans[span + 1], cells);
  }
}

// The largest bound that is reached by twice the windows that are kept.
std::uint32_t HoughAccumulator::bound_of_likely(std::size_t found, std::uint32_t fewest) const {
  std::array<std::uint32_t, 256> windows{};
  for (std::size_t w = 0; w < found; ++w) ++windows[windows_[w] >> kSlotBits];
  std::size_t reached = 0;
  std::uint32_t bound = 255;
  while (bound > fewest && (reached += windows[bound]) < 2 * kKeptPerStep) --bound;
  return bound;
}

// The windows of at least that bound, and the voters in their cells: cell after cell.
void HoughAccumulator::gather_voters(const Lattice& lattice, std::size_t found,
                                     std::uint32_t fewest, const Kernels& kernels) {
  chosen_.clear();
  ends_.clear();
  for (std::size_t w = 0; w < found; ++w) {
    if (windows_[w] >> kSlotBits < fewest) continue;
    Window window{windows_[w] & kSlotMask, {}};
    for (std::uint32_t corner = 0; corner < 4; ++corner) {
      const std::uint32_t cell = lattice.cell_of(window.slot, corner);
      const std::uint32_t bit = 1u << (cell & 31);
      if ((wanted_[cell >> 5] & bit) == 0) {
        wanted_[cell >> 5] |= bit;
        numbers_[cell] = static_cast<std::uint32_t>(ends_.size());
        ends_.push_back(0);
      }
      window.cells[corner] = numbers_[cell];
    }
    chosen_.push_back(window);
  }
  inside_.resize(own_.size() + kMaxWidth);
  const std::size_t inside =
      kernels.matches_inside(own_.data(), own_.size(), wanted_.data(), inside_.data());
  for (std::size_t i = 0; i < inside; ++i) ++ends_[numbers_[own_[inside_[i]]]];
  std::uint32_t before = 0;
  for (std::uint32_t& end : ends_) before += std::exchange(end, before);
  voters_.resize(inside);
  for (std::size_t i = 0; i < inside; ++i) {
    voters_[ends_[numbers_[own_[inside_[i]]]]++] = inside_[i];
  }
  for (const Window& window : chosen_) {
    for (std::uint32_t corner = 0; corner < 4; ++corner) {
      wanted_[lattice.cell_of(window.slot, corner) >> 5] = 0;
    }
  }
}

// Distinct objects in the windows of at least that bound.
void HoughAccumulator::count_objects(const Voters& v, std::uint32_t fewest) {
  for (std::size_t w = 0; w < chosen_.size(); ++w) {
    std::uint32_t votes = 0;
    ++stamp_;
    for (const std::uint32_t cell : chosen_[w].cells) {
      for (std::uint32_t i = cell == 0 ? 0 : ends_[cell - 1]; i < ends_[cell]; ++i) {
        std::uint32_t& seen = seen_[v.group[voters_[i]]];
        votes += seen != stamp_;
        seen = stamp_;
      }
    }
    if (votes >= fewest) {
      peaks_.push_back({votes, chosen_[w].slot, static_cast<std::uint32_t>(w), 0, 0});
    }
  }
}

void HoughAccumulator::keep_highest() {
  const auto higher = [](const Peak& a, const Peak& b) {
    return a.votes != b.votes ? a.votes > b.votes : a.slot < b.slot;
  };
  if (peaks_.size() > kKeptPerStep) {
    const auto end = peaks_.begin() + static_cast<std::ptrdiff_t>(kKeptPerStep);
    std::nth_element(peaks_.begin(), end, peaks_.end(), higher);
    peaks_.erase(end, peaks_.end());
  }
  std::sort(peaks_.begin(), peaks_.end(), higher);
}

// A voter of the window: the first one of the third object, with which the window counts.
std::uint32_t HoughAccumulator::voter_of(const Voters& v, const Window& window) {
  inside_.clear();
  for (const std::uint32_t cell : window.cells) {
    inside_.insert(inside_.end(), voters_.begin() + (cell == 0 ? 0 : ends_[cell - 1]),
                   voters_.begin() + ends_[cell]);
  }
  std::sort(inside_.begin(), inside_.end());
  std::size_t k = 0;
  for (std::uint32_t objects = 1; objects < kFewestVotes; ++objects) {
    const std::uint32_t group = v.group[inside_[k]];
    while (v.group[inside_[k]] == group) ++k;
  }
  return inside_[k];
}

// Where that voter has voted.
void HoughAccumulator::place(const Voters& v, const VoteLattice& l, Peak& peak) {
  const std::uint32_t k = voter_of(v, chosen_[peak.voter]);
  const float x = v.mx[k] - (l.cosine * v.qx[k] - l.sine * v.qy[k]) - l.low_x;
  const float y = v.my[k] - (l.sine * v.qx[k] + l.cosine * v.qy[k]) - l.low_y;
  const std::uint32_t own = own_[k];
  peak.voter = k;
  peak.x = static_cast<std::int32_t>(x * l.per_metre) +
           static_cast<std::int32_t>((peak.slot - own) & l.mask_x & 1u);
  peak.y = static_cast<std::int32_t>(y * l.per_metre) +
           static_cast<std::int32_t>(((peak.slot >> l.bits_x) - (own >> l.bits_x)) & 1u);
}

}  // namespace segloc
