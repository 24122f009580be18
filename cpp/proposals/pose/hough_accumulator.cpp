#include "proposals/pose/hough_accumulator.h"

#include <algorithm>

namespace segloc {
namespace {

constexpr std::size_t kKeptPerStep = 48;
constexpr std::size_t kFront = 32;  // values before a table

// Nearly every branch in these two loops would be a coin toss: there are none.

// Voters from `begin` to `end` each count in their own cell, once for each object in a row.
void count_span(const std::uint32_t* own, const std::uint16_t* mark, std::size_t begin,
                std::size_t end, std::uint16_t* cells) {
  for (std::size_t k = begin; k < end; ++k) {
    std::uint16_t& cell = cells[own[k]];
    const std::uint32_t old = cell, voter = mark[k];
    const std::uint32_t votes = (old & kVotes) + ((old ^ voter) > kVotes);
    cell = static_cast<std::uint16_t>(voter | std::min(votes, kMostCountedVotes));
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

// The window of a corner, at the place where the voter that made it count has voted.
Peak peak_of(const Voters& v, const VoteLattice& l, std::uint32_t k, std::uint32_t slot,
             std::uint32_t corner) {
  const float x = v.mx[k] - (l.cosine * v.qx[k] - l.sine * v.qy[k]) - l.low_x;
  const float y = v.my[k] - (l.sine * v.qx[k] + l.cosine * v.qy[k]) - l.low_y;
  return {0, slot, k, static_cast<std::int32_t>(x * l.per_metre) + std::int32_t(corner & 1),
          static_cast<std::int32_t>(y * l.per_metre) + std::int32_t(corner >> 1)};
}

}  // namespace

void HoughAccumulator::resize(const Voters& v, const Lattice& lattice) {
  if (!cells_.empty()) return;
  cells_.resize(kFront + lattice.cells());
  windows_.reset(new std::uint32_t[lattice.cells()]);
  counters_.reset(new std::uint32_t[lattice.cells()]);
  full_.resize(lattice.cells() / 64);
  wanted_.resize(lattice.cells() / 64);
  own_.resize(v.size());
  inside_.resize(v.size());
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
  mark_windows(lattice, found, true);
  count_objects(v, lattice, at);
  mark_windows(lattice, found, false);
  keep_highest(fewest);
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

// Which windows were found, and which cells belong to one of them.
void HoughAccumulator::mark_windows(const Lattice& lattice, std::size_t found, bool wanted) {
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
    counters_[windows_[w]] = 0;
  }
}

// Distinct objects in the windows that were found. A counter holds the object that voted last, from
// 1 (upper 16 bits), and the votes (lower 16 bits).
void HoughAccumulator::count_objects(const Voters& v, const Lattice& lattice,
                                     const VoteLattice& at) {
  const std::size_t inside = voters_inside(own_.data(), v.size(), wanted_.data(), inside_.data());
  for (std::size_t i = 0; i < inside; ++i) {
    const std::uint32_t k = inside_[i], group = (v.group[k] + 1) & 0xffffu;
    const std::uint32_t x = own_[k] & lattice.mask_x(), y = own_[k] >> lattice.bits_x;
    for (std::uint32_t corner = 0; corner < 4; ++corner) {
      const std::uint32_t column = (x + (corner & 1)) & lattice.mask_x();
      const std::uint32_t row = (y + (corner >> 1)) & lattice.mask_y();
      const std::uint32_t slot = row << lattice.bits_x | column;
      if ((full_[slot >> 6] >> (slot & 63) & 1) == 0) continue;
      const std::uint32_t old = counters_[slot], fresh = (old >> 16) != group;
      const std::uint32_t votes = (old & 0xffffu) + fresh;
      counters_[slot] = group << 16 | votes;
      if ((votes == kFewestVotes) & fresh) peaks_.push_back(peak_of(v, at, k, slot, corner));
    }
  }
  for (Peak& peak : peaks_) peak.votes = counters_[peak.slot] & 0xffffu;
}

void HoughAccumulator::keep_highest(std::uint32_t fewest) {
  peaks_.erase(std::remove_if(peaks_.begin(), peaks_.end(),
                              [&](const Peak& peak) { return peak.votes < fewest; }),
               peaks_.end());
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

}  // namespace segloc
