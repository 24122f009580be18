// The votes of one step of yaw.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "simd/kernels.h"

namespace segloc {

constexpr std::uint32_t kFewestVotes = 3;        // of a window that counts
constexpr std::uint32_t kMostCountedVotes = 63;  // in a cell: the sum of four fits its byte
constexpr std::uint32_t kMarks = 255;            // objects that a byte tells apart

// The matches that vote, one object after another.
struct Voters {
  std::vector<float> qx, qy, mx, my;  // queries relative to their middle
  std::vector<std::uint32_t> group, index;
  std::vector<std::uint16_t> mark;  // of the object, where a cell keeps it
  std::vector<std::size_t> spans;   // borders of stretches in which objects have different marks
  double middle[2] = {0.0, 0.0};
  double radius = 0.0;  // root mean square distance to the middle

  std::size_t size() const { return index.size(); }
  MatchArrays arrays() const { return {qx.data(), qy.data(), mx.data(), my.data()}; }
};

// The lattice of translations: cells are folded into a table, so that it stays in cache.
struct Lattice {
  float per_metre = 1.0f, low_x = 0.0f, low_y = 0.0f;
  int bits_x = 0, bits_y = 0;

  std::size_t cells() const { return std::size_t{1} << (bits_x + bits_y); }
  std::uint32_t mask_x() const { return (1u << bits_x) - 1; }
  std::uint32_t mask_y() const { return (1u << bits_y) - 1; }
  // The cell of which that is the corner's window.
  std::uint32_t cell_of(std::uint32_t window, std::uint32_t corner) const {
    const std::uint32_t x = window - (corner & 1), y = (window >> bits_x) - (corner >> 1);
    return (y & mask_y()) << bits_x | (x & mask_x());
  }
  VoteLattice at(double yaw) const {
    return {static_cast<float>(std::cos(yaw)),
            static_cast<float>(std::sin(yaw)),
            low_x,
            low_y,
            per_metre,
            mask_x(),
            mask_y(),
            bits_x};
  }
};

// A window of two by two cells with many votes, named by its last cell. Places that are folded into
// one window share its votes, and x and y are those of the place where `voter` voted.
struct Peak {
  std::uint32_t votes, slot, voter;
  std::int32_t x, y;  // on the lattice, not folded
};

// One step of yaw after another, in the scratch memory of one worker. First every voter counts in
// its own cell, which is quick. The votes of four cells together bound those of a window: an object
// may have voted in several of them. Only where the bound reaches the threshold, which few windows
// in a million do, are the objects of the window counted.
class HoughAccumulator {
 public:
  // Makes room, the first time.
  void resize(const Voters& v, const Lattice& lattice);

  // The windows with the most votes at that yaw, of those with at least `fewest` votes.
  const std::vector<Peak>& peaks(const Voters& v, const Lattice& lattice, double yaw,
                                 std::uint32_t fewest, const Kernels& kernels);

 private:
  struct Window {
    std::uint32_t slot, cells[4];  // the cells, numbered in the order of `ends_`
  };

  void count_cells(const Voters& v);
  std::uint32_t bound_of_likely(std::size_t found, std::uint32_t fewest) const;
  void gather_voters(const Lattice& lattice, std::size_t found, std::uint32_t fewest,
                     const Kernels& kernels);
  void count_objects(const Voters& v, std::uint32_t fewest);
  void keep_highest();
  std::uint32_t voter_of(const Voters& v, const Window& window);
  void place(const Voters& v, const VoteLattice& at, Peak& peak);

  std::vector<std::uint16_t> cells_;   // votes, behind a few others; clear between steps
  std::vector<std::uint32_t> own_;     // cell of each voter
  std::vector<Window> chosen_;         // whose objects are counted
  std::vector<std::uint32_t> wanted_;  // their cells, a bit each; clear between steps
  std::vector<std::uint32_t> inside_, voters_;  // voters in these cells, in order and by cell
  std::vector<std::uint32_t> ends_;             // of the voters of each cell
  std::vector<std::uint32_t> seen_;             // the last window that counted each object
  std::uint32_t stamp_ = 0;                     // of a window
  std::vector<Peak> peaks_;
  // As large as the table, but hardly used, so they are not cleared:
  std::unique_ptr<std::uint32_t[]> windows_;  // that may be full, with the bounds of their votes
  std::unique_ptr<std::uint32_t[]> numbers_;  // of wanted cells
};

}  // namespace segloc
