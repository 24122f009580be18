// The kernels that exist once for each instruction set, and how one is chosen.
//
// kernel_table.cpp and the *_kernel.h files that it includes are compiled with the flags of each
// instruction set (instruction_sets.cmake). The rest of the library uses them through the table
// `Kernels` only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "simd/isa_list.h"

namespace segloc {

// portable, avx2, avx512: the list of instruction_sets.cmake, the best one last.
#define SEGLOC_ENUMERATOR_BUILT(name, runs) name,
#define SEGLOC_ENUMERATOR_MISSING(name) name,
enum class Isa { SEGLOC_ISAS(SEGLOC_ENUMERATOR_BUILT, SEGLOC_ENUMERATOR_MISSING) };
#undef SEGLOC_ENUMERATOR_BUILT
#undef SEGLOC_ENUMERATOR_MISSING

#define SEGLOC_NAME_BUILT(name, runs) #name,
#define SEGLOC_NAME_MISSING(name) #name,
static constexpr const char* kIsaNames[] = {SEGLOC_ISAS(SEGLOC_NAME_BUILT, SEGLOC_NAME_MISSING)};
#undef SEGLOC_NAME_BUILT
#undef SEGLOC_NAME_MISSING

// One cloud for farthest-point sampling, in scratch memory of the caller: x, y, z and the distance
// to the set, 64 values a group each, one after another, then fps_group_max_size more.
struct FpsCloud {
  float* memory;
  int32_t* order;  // receives `samples` indices
  size_t n, samples;
};

// Sources and queries of one dilated neighbour search (the queries are the first of the sources).
// x, y, z are padded to a multiple of 16 with infinity.
struct NeighborTask {
  const float* x;
  const float* y;
  const float* z;
  size_t sources;
  size_t queries;
  int neighbors;     // K
  int dilation;      // D
  float* scratch;    // neighbor_scratch_size(sources) floats
  uint16_t* result;  // (queries, K)
};

struct GridCells;
struct GridNearest;
struct XConvWeights;
struct XConvTask;
struct DenseWeights;

// Rows of a convolution or a dense layer: output = start + sum over the pieces of input * weight.
// The columns come in panels as in DenseWeights; a row starts from its own sums.
struct ConvTask {
  size_t rows;
  const float* const* input;  // (rows)
  const float* const* start;  // (rows): the sums that a row starts from
  float* const* output;       // (rows)
  size_t pieces;
  const size_t* offset;      // (pieces): from a row's input to the piece
  const size_t* weight_row;  // (pieces): where its weights begin
  size_t length;             // of a piece
  const float* weight;       // (panels, weight_rows, panel)
  size_t weight_rows;
  size_t first_column, last_column;  // of the output; multiples of the panel
  bool rectify;
};

// Squared distances of up to 4 queries to a block of database points, fused with the selection.
struct KnnScan {
  uint32_t points;  // a bit for each of the block that is one
  const float* queries[4];
  float thresholds[4];
  // Appended to, for points with distance^2 <= threshold: their indices and distance^2.
  uint32_t* candidates[4];
  float* distances2[4];
  size_t counts[4];
};

// A block of coded database points: base + code * step along each dimension.
struct KnnCodes {
  const uint8_t* codes;
  const float *base, *step;
};

// Boxes of blocks of descriptors: how many are measured together, and along how many axes.
static constexpr size_t kBoxRun = 16, kBoxAxes = 8;

// Query and map coordinates of matches, an array for each. Up to 15 values behind the last one may
// be read.
struct MatchArrays {
  const float* qx;
  const float* qy;
  const float* mx;
  const float* my;
};

// Sources and targets of pairs, x, y, z each. Up to 15 values behind the last one may be read.
struct EdgeArrays {
  const float* source[3];
  const float* target[3];
};

// Points, an array for each coordinate. Up to 15 values behind the last one may be read.
struct PointArrays {
  const float* x;
  const float* y;
  const float* z;
};

// Which matches lie near each other in the plane under a pose, in single precision.
struct PoseTest {
  float cosine, sine, x, y;
  float max_distance2;
};

// Cells of translations at one yaw, folded into a table of 2^n columns and rows.
struct VoteLattice {
  float cosine, sine, low_x, low_y, per_metre;
  uint32_t mask_x, mask_y;
  int bits_x;
};

// A cell of the table holds its votes, and above them a mark of who voted last.
static constexpr uint16_t kVotes = 0xff;

// A window in the low bits, a bound of its votes above them.
static constexpr int kSlotBits = 24;
static constexpr uint32_t kSlotMask = (1u << kSlotBits) - 1;

// One point of an X-conv layer in training. rows is K padded to 4, width the channels and lanes K,
// both padded to 16; whatever is padded is zero. x (rows, rows), f and t (rows, width), depthwise
// (depth, rows, width), output (depth, width): the result, or the gradient that comes in.
struct ApplyPoint {
  size_t neighbors, rows, width, lanes, depth;
  const float* x;
  const float* x_transposed;
  const float* f;
  const float* f_transposed;  // (width, lanes)
  const float* depthwise;
  float* t;
  float* output;
  float* grad_t;
  float* grad_f;          // (rows, width)
  float* grad_x;          // (rows, lanes)
  float* grad_depthwise;  // added to
};

// Points of a depthwise map of K x K matrices: row c of the result comes from column c of x.
// x (points, K, K); y and its gradient (points, K, K) with 16 values behind the last that may be
// read and written; weight (K, K, lanes): [c][i][o]; transposed [c][o][i]; lanes is K padded to 16.
struct ColumnTask {
  size_t points, neighbors, lanes;
  const float* x;
  const float* weight;
  const float* transposed;
  float* y;            // the result, or the gradient that comes in
  float* grad_x;       // (points, K, K)
  float* grad_weight;  // (K, K, lanes), added to; whatever is beyond K means nothing
  float* scratch;      // (K, lanes)
};

// The inner loops of train_ops.cpp; rows of a width that is a multiple of 16.
struct TrainKernels {
  void (*apply)(const ApplyPoint& point);
  void (*apply_backward)(const ApplyPoint& point);
  void (*columns)(const ColumnTask& task);
  void (*columns_backward)(const ColumnTask& task);
  void (*elu_sums)(const float* input, size_t rows, size_t width, bool activate, float* z,
                   float* sum, float* square);
  void (*scale_shift)(const float* z, size_t rows, size_t width, const float* scale,
                      const float* shift, float* output);
  void (*gradient_sums)(const float* gradient, const float* z, size_t rows, size_t width,
                        float* sum, float* product);
  void (*norm_gradient)(const float* gradient, const float* z, size_t rows, size_t width,
                        bool activate, const float* coefficients, float* output);
};

// Lists that are sorted at a time.
static constexpr size_t kSortLanes = 16;

// Coordinates of kSortLanes clouds come in rows of a value of each. Extent, mean and standard
// deviation along an axis:
struct AxisLanes {
  float low[kSortLanes], high[kSortLanes], mean[kSortLanes], spread[kSortLanes];
};

// Clouds that are cut into `slices` equal parts along an axis, from `low` on over `span`.
struct SliceTask {
  const float* along;      // (count, kSortLanes): the coordinate that is cut
  const float* values[2];  // (count, kSortLanes): two coordinates, whose means are taken off
  const float *low, *span, *means[2];
  size_t count, slices;
};

// Of the points of a slice: their number, sums of the two values and of their squares, and the
// greatest second value.
struct SliceLanes {
  float count[kSortLanes], sum[2][kSortLanes], squares[2][kSortLanes], top[kSortLanes];
};

// Values whose extents are taken at a time: whole points and whole vectors.
static constexpr size_t kExtentRun = 48;

// Directions, `bin_deg` wide: columns around, and rows from below to above. A quick angle may be
// wrong by the share `doubt` of a pixel.
struct PixelGrid {
  double bin_deg, doubt;
  int32_t columns, rows;
};

// Pairs of an alignment, an array for each coordinate.
struct PairArrays {
  const double *source[3], *target[3];
  const double *normal[3], *own[3];  // of the target and of the source
  const double* use;                 // 1, or 0 where there is no pair
  const float *at[3], *stays;        // where the source was, and how far its pair holds from there
  double* weight[6];                 // xx, xy, xz, yy, yz, zz
};
static constexpr size_t kPairTerms = 28;

// Sums over points around a place, from there.
struct PointSums {
  double first[3], second[6];  // xx, xy, xz, yy, yz, zz
  uint32_t count;
};

// Square cells over the plane, (ny, stride), of which the first nx columns count.
struct GroundLattice {
  double x0, y0, edge;
  bool is_power;  // the edge is a power of two
  int32_t nx, ny, stride;
};

// Windows of a map that lie side by side.
static constexpr size_t kWindowRun = 16;

struct Kernels {
  Isa isa;
  size_t width;  // floats in a vector
  size_t block;  // queries that xconv takes at a time
  size_t panel;  // output channels of a column panel of dense weights
  // Clouds of up to 64 * `groups` points.
  void (*fps)(const FpsCloud* clouds, size_t count, size_t groups);
  void (*neighbors)(const NeighborTask& task);
  void (*xconv)(const XConvWeights& weights, const XConvTask& task);
  void (*dense)(const DenseWeights& weights, const float* input, size_t input_stride, size_t rows,
                float* output, size_t output_stride);
  void (*conv)(const ConvTask& task);
  void (*knn_scan)(const float* block, size_t dim, uint32_t first, KnnScan& scan);
  void (*knn_scan_codes)(const KnnCodes& block, size_t dim, uint32_t first, KnnScan& scan);
  // Squared distances from a place to kBoxRun boxes: ends (kBoxAxes, 2, kBoxRun).
  void (*box_bounds)(const float* boxes, const float* place, float* bounds);
  // Writes the indices of the matches in [begin, end) that pass, and returns how many.
  size_t (*near_pose)(const MatchArrays& f, const PoseTest& test, size_t begin, size_t end,
                      uint32_t* found);
  // Writes the pairs in [begin, end) whose edges to pair k differ in length by `tolerance` at most,
  // up to rounding, and returns how many.
  size_t (*like_edges)(const EdgeArrays& f, size_t k, float tolerance, size_t begin, size_t end,
                       uint32_t* found);
  TrainKernels training;
  // The cell that each match votes for.
  void (*vote_cells)(const MatchArrays& f, size_t count, const VoteLattice& lattice,
                     uint32_t* cells);
  // Writes the windows with at least `fewest` votes, with these; clears the table, and returns how
  // many there are. The window of a cell are the two by two cells that end with it, across the edges
  // of the table. A multiple of 32 columns; the value before the table may be read.
  size_t (*full_windows)(uint16_t* cells, size_t columns, size_t rows, uint32_t fewest,
                         uint32_t* found);
  // Writes the matches whose cell has its bit set, and returns how many there are. There must be
  // room for all of them and a vector's width.
  size_t (*matches_inside)(const uint32_t* cells, size_t count, const uint32_t* wanted,
                           uint32_t* inside);
  // Adds to the sum of each window how many of the slices it holds: bytes of the image, in runs
  // that begin at `runs` from the beginning of each column.
  void (*add_slices)(const uint8_t* image, const size_t* columns, const uint8_t* slices,
                     size_t count, const size_t* runs, size_t run_count, uint16_t* sums);
  // Whether each value is finite and its magnitude below `limit`.
  bool (*all_below)(const float* values, size_t count, float limit);
  // The least and the greatest of values kExtentRun apart, of at least one run.
  void (*extent)(const float* values, size_t runs, float* low, float* high);
  // floor(values / size), all of which are below 2^30.
  void (*cell_numbers)(const float* values, size_t count, double size, int32_t* cells);
  // x + stride_y y + stride_z z - base of each cell, whose last 32 bits are all there is.
  void (*cell_keys)(const int32_t* cells, size_t count, uint32_t stride_y, uint32_t stride_z,
                    uint32_t base, uint64_t* keys);
  // Sums over the points within the distance, squared, of each place.
  void (*sums_within)(const GridCells& grid, const float* places, size_t count, float distance2,
                      PointSums* sums);
  // As PointGrid's.
  void (*nearest_squared)(const GridCells& grid, const float* places, size_t count, float limit,
                          float enough, float* squared);
  void (*nearest_points)(const GridCells& grid, const float* places, size_t count, float limit,
                         float lead, GridNearest* found);
  // Of pairs [begin, end) at poses of nine values of rotation and three of translation: where they
  // are (x, y, z from the first on) and which are lost; their weights and the sums of their terms,
  // added to; and their error in a frame.
  void (*move_pairs)(const PairArrays& pairs, const double* T, size_t begin, size_t end,
                     float* const* moved, uint8_t* lost);
  void (*sum_pairs)(const PairArrays& pairs, const double* T, size_t begin, size_t end,
                    double* sums);
  double (*pair_error)(const PairArrays& pairs, const double* frame, const double* T, size_t begin,
                       size_t end);
  // The pixel of each point, column by column, or -1 where a quick angle is in doubt; and its range.
  void (*range_pixels)(const float* points, size_t count, const PixelGrid& grid, int32_t* pixels,
                       float* ranges);
  // The number of the cell of each point, or of the nearest one.
  void (*ground_cells)(const float* points, size_t count, const GroundLattice& lattice,
                       int32_t* cells);
  // Heights of points above the bilinear surface through the centres of cells of height z.
  void (*ground_heights)(const float* points, size_t count, const GroundLattice& lattice,
                         const float* z, float* heights);
  // How many of the other values within `reach` rows and columns of each of a row differ from it
  // by no more than their band; `bands` points to the middle one. Up to 15 values behind the last
  // are read and written.
  void (*count_like)(const float* z, ptrdiff_t stride, size_t count, const float* bands,
                     size_t band_stride, int reach, int32_t* level);
  // Sums over normals of 1 - slope * (squared sine to the direction or its plane), where positive.
  // `count` is a multiple of 16.
  void (*agreements)(const PointArrays& normals, size_t count, const double* directions,
                     size_t direction_count, float slope, double* scores);
  // Sorts kSortLanes lists side by side: row i has the i-th value of each. `count` is a power of
  // two.
  void (*sort_lanes)(float* rows, size_t count);
  void (*axis_statistics)(const float* rows, size_t count, AxisLanes& axis);
  // Of each pair of `count` points, (i, j) for j < i: squared distances in space and in the plane,
  // and differences in height.
  void (*pair_distances)(const float* const* xyz, size_t count, float* space, float* flat,
                         float* rise);
  // `number` receives the slice of each point, (count, kSortLanes).
  void (*slice_sums)(const SliceTask& task, float* number, SliceLanes* sums);
};

const Kernels& kernels(Isa isa);

// Those of the best instruction set that this processor runs.
const Kernels& best_kernels();

// "auto" is the best one that this processor runs; throws std::invalid_argument for a name that is
// unknown or not available here.
Isa parse_isa(const std::string& name);

// static: a shared definition could come from a file built for a newer processor.
static constexpr size_t padded(size_t n, size_t multiple) {
  return (n + multiple - 1) / multiple * multiple;
}
static constexpr size_t kFpsGroup = 64;
static constexpr size_t kFpsFewGroups = 8;  // clouds that are sampled in lockstep have no more
static constexpr size_t fps_groups(size_t n) { return (n + kFpsGroup - 1) / kFpsGroup; }
// The largest distances of each group, one vector (of at most 16) a group, in blocks of 64. Of a
// large cloud: its points in another order, one value a group, and the box of each group.
static constexpr size_t fps_group_max_size(size_t groups) {
  return groups > kFpsFewGroups ? 4 * groups * kFpsGroup + 7 * padded(groups, 64)
                                : padded(groups * 16, 64);
}

}  // namespace segloc
