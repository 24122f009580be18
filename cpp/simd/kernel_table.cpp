// The table of one instruction set. CMake compiles this file once for each one, with SEGLOC_ISA set
// to its name and with its flags (simd/instruction_sets.cmake). A new kernel is included here.
#include "common/cells_kernel.h"
#include "descriptors/fps_kernel.h"
#include "descriptors/network/conv_kernel.h"
#include "descriptors/network/neighbors_kernel.h"
#include "descriptors/network/xconv_kernel.h"
#include "descriptors/profile_kernel.h"
#include "frontend/gravity_kernel.h"
#include "frontend/grid_kernel.h"
#include "frontend/ground_kernel.h"
#include "likelihood/gicp_kernel.h"
#include "likelihood/visibility_kernel.h"
#include "proposals/matching/knn_kernel.h"
#include "proposals/occupancy/windows_kernel.h"
#include "proposals/pose/consensus_kernel.h"
#include "proposals/pose/edges_kernel.h"
#include "proposals/pose/votes_kernel.h"
#include "simd/kernels.h"
#include "training/train_kernel.h"

namespace segloc {
namespace SEGLOC_ISA {

extern const Kernels kTable;
const Kernels kTable = {Isa::SEGLOC_ISA,
                        kWidth,
                        kBlock,
                        kPanel,
                        &fps,
                        &neighbors,
                        &xconv,
                        &dense,
                        &conv,
                        &knn_scan,
                        &knn_scan_codes,
                        &box_bounds,
                        &near_pose,
                        &like_edges,
                        kTraining,
                        &vote_cells,
                        &full_windows,
                        &matches_inside,
                        &add_slices,
                        &all_below,
                        &extent,
                        &cell_numbers,
                        &cell_keys,
                        &sums_within,
                        &nearest_squared,
                        &nearest_points,
                        &move_pairs,
                        &sum_pairs,
                        &pair_error,
                        &range_pixels,
                        &ground_cells,
                        &ground_heights,
                        &count_like,
                        &agreements,
                        &sort_lanes,
                        &axis_statistics,
                        &pair_distances,
                        &slice_sums};

}  // namespace SEGLOC_ISA
}  // namespace segloc
