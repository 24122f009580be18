// The table of one instruction set; included once by each kernels_*.cpp.
#pragma once

#include "consensus_kernel.h"
#include "conv_kernel.h"
#include "fps_kernel.h"
#include "knn_kernel.h"
#include "neighbors_kernel.h"
#include "train_kernel.h"
#include "votes_kernel.h"
#include "xconv_kernel.h"

namespace segloc {
namespace SEGLOC_ISA {

extern const Kernels kTable;
const Kernels kTable = {Isa::SEGLOC_ISA, kWidth, kBlock, kPanel,   &fps,
                        &neighbors,      &xconv, &dense, &conv,    &knn_scan,
                        &near_pose,      kTraining,
                        &vote_cells,     &full_windows};

}  // namespace SEGLOC_ISA
}  // namespace segloc
