// Nearest neighbours of descriptors: exact, or through an index in large databases.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "common/aligned.h"
#include "proposals/matching/descriptor_boxes.h"
#include "proposals/matching/descriptor_rows.h"
#include "simd/kernels.h"

namespace segloc {

// Descriptors divided into lists around centres (k-means), packed for the scan. With one list every
// search is exact; with more, a search reads only the lists whose centres are nearest to the query.
// Within its lists it skips the blocks that lie too far for any of their rows to be among the
// nearest. Neither the lists nor the answers depend on the number of threads.
class DescriptorIndex {
 public:
  // dim > 0, lists > 0. Without `boxes` no block is skipped: they cost what they spare to some
  // hundreds of queries.
  DescriptorIndex(const DescriptorRows& database, std::size_t lists, Isa isa, int threads,
                  bool boxes = true);

  // For each row of queries (Q, dim) the `columns` nearest rows, columns <= count, sorted by
  // distance and then by index. Distances are Euclidean; they are ranked in double. `probes` lists
  // are read, or more where those hold fewer than `columns`.
  void search(const float* queries, std::size_t query_count, std::size_t columns,
              std::size_t probes, int threads, int64_t* indices, float* distances) const;

  std::size_t size() const { return count_; }
  std::size_t dim() const { return dim_; }
  std::size_t lists() const { return starts_.size() - 1; }

 private:
  class Search;

  void divide(std::size_t lists, int threads);
  void pack(const std::vector<uint32_t>& list_of, int threads);
  void bound(int threads);
  template <typename Value>
  void fill(Value* packed, const Value* rows, int threads) const;
  std::vector<std::vector<uint32_t>> probed(const float* queries, std::size_t query_count,
                                            std::size_t columns, std::size_t probes) const;

  DescriptorRows database_;
  std::size_t count_, dim_;
  bool boxed_;
  const Kernels& kernels_;
  std::size_t lanes_;
  std::vector<float> centres_;                     // (lists, dim)
  std::unique_ptr<const DescriptorIndex> coarse_;  // over the centres, if there are several
  std::vector<std::size_t> starts_;  // of each list, in packed positions: multiples of lanes_
  std::vector<std::size_t> sizes_;   // of each list
  std::vector<uint32_t> ids_;        // row of the database at each position
  AlignedFloats packed_;             // blocks of rows, one dimension after another,
  std::vector<std::uint8_t> codes_;  // or the same of coded rows
  DescriptorAxes axes_;                   // none: every block is read
  float farthest_ = 0.0f;                 // along the axes, of any row
  std::vector<std::size_t> group_starts_;  // of each list, among the groups of blocks
  DescriptorBoxes boxes_;
};

// An exact search, once.
void nearest_descriptors(const float* queries, std::size_t query_count, const float* database,
                         std::size_t database_count, std::size_t dim, std::size_t columns, Isa isa,
                         int threads, int64_t* indices, float* distances);

}  // namespace segloc
