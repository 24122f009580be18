// Exact Euclidean clustering.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

struct Clusters {
  std::vector<std::uint32_t> points;  // point indices, cluster after cluster
  std::vector<std::int64_t> offsets;  // cluster i is points[offsets[i] .. offsets[i + 1])
};

// Connected components of the graph that links any two points within `radius` metres. Clusters with
// fewer than min_points or more than max_points are left out. Clusters come in the order of their
// lowest point index, and so do the points inside.
Clusters euclidean_clusters(const float* points, std::size_t n, double radius,
                            std::size_t min_points, std::size_t max_points);

// The clusters of the points higher than each cut, cut after cut; `heights` are of the n points.
// Points linked above one cut are linked above every lower one, and not visited again.
Clusters clusters_above(const float* points, const float* heights, std::size_t n,
                        const std::vector<double>& cuts, double radius, std::size_t min_points,
                        std::size_t max_points);

// Clusters with their measures.
struct Segments {
  std::vector<float> points;      // (M, 3), cluster after cluster
  std::vector<double> centroids;  // (clusters, 3)
  std::vector<float> heights;     // the mean ones of their points
};

// Of clusters of these points and heights.
Segments segments_of(const Clusters& clusters, const float* points, const float* heights);

}  // namespace segloc
