// Exact nearest neighbours of descriptors.
#pragma once

#include <cstddef>
#include <cstdint>

#include "kernels.h"

namespace segloc {

// For each row of queries (Q, dim) the `columns` nearest rows of database (M, dim), columns <= M,
// sorted by distance and then by index. Distances are Euclidean; they are ranked in double.
void nearest_descriptors(const float* queries, std::size_t query_count, const float* database,
                         std::size_t database_count, std::size_t dim, std::size_t columns, Isa isa,
                         int threads, int64_t* indices, float* distances);

}  // namespace segloc
