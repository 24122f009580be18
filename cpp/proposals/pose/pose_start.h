// Where the refinement of a pose starts: the best pose of a cell of the coarse vote.
#pragma once

#include <cstddef>
#include <vector>

#include "proposals/pose/consensus.h"
#include "proposals/pose/match_table.h"
#include "proposals/pose/pose_votes.h"
#include "simd/kernels.h"

namespace segloc {

struct PoseStart {
  std::size_t index = 0;    // of a match that agrees
  std::size_t support = 0;  // votes
  PoseHypothesis pose;
};

// The pose of a cell that most matches agree on: the cell is divided and voted for again. Where a
// map has storeys, matches agree on it at several heights: one start for each, the first at the
// height of most.
std::vector<PoseStart> best_starts(const MatchTable& f, const PoseCell& cell,
                                   const PoseVotes& votes, const ConsensusOptions& options,
                                   const Kernels& kernels);

}  // namespace segloc
