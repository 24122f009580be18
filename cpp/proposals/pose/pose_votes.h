// Peaks of the matches in the space of poses: a Hough transform over yaw and translation.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "proposals/pose/match_table.h"

namespace segloc {

struct PoseCell {
  std::uint32_t votes = 0;             // distinct objects of the query
  std::uint32_t index = 0;             // of one match of the cell, in the table
  double yaw = 0.0, x = 0.0, y = 0.0;  // p_map = Rz(yaw) p_query + (x, y): the middle of the cell
};

struct VoteOptions {
  double tolerance = 0.6;         // largest residual of a match, metres
  std::size_t max_votes = 32768;  // the best matches vote
  std::size_t max_cells = 512;    // those with the most votes are returned,
  double least_share = 0.0;       // of these, least share of the most votes,
  std::size_t fewest_cells = 0;   // except for this number of the best
};

struct PoseVotes {
  std::vector<PoseCell> cells;    // most votes first
  double width = 0.0;             // of a cell, metres
  double turn = 0.0;              // step of yaw
  double middle[2] = {0.0, 0.0};  // of the query; cells are taken about it
  double radius = 0.0;            // root mean square distance of the voters to it
};

// At every step of yaw each match votes for the cell of the translation that it implies. Poses
// are windows of two by two cells, which overlap by half, so that none falls between them. Objects
// are counted, not matches. Which cells come first does not depend on the number of threads.
PoseVotes vote_for_poses(const MatchTable& f, const VoteOptions& options, int threads);

}  // namespace segloc
