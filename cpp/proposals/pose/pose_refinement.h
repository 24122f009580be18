// Fits a pose to all of its inliers.
#pragma once

#include "proposals/pose/consensus.h"
#include "proposals/pose/match_table.h"
#include "proposals/pose/pose_start.h"
#include "simd/kernels.h"

namespace segloc {

// Least squares on the inliers, which are found again after each fit. Counts them and their score.
PoseHypothesis refine(const MatchTable& f, const PoseStart& start, const ConsensusOptions& options,
                      const Kernels& kernels);

}  // namespace segloc
