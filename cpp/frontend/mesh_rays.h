// First hits of rays on triangles.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace segloc {

struct RayHit {
  float range;            // in lengths of the ray's direction; infinite if it hits nothing
  std::int32_t triangle;  // -1 if it hits nothing
};

// Triangles in a tree of boxes, for rays of any origin. Both sides of a triangle are hit.
class MeshRays {
 public:
  // Copies n triangles, (n, 3, 3) row-major; n is less than 2^31.
  MeshRays(const float* triangles, std::size_t n);

  std::size_t size() const { return order_.size(); }

  // The first hit of each ray within `max_range`; origins and directions are (rays, 3). Of equally
  // near triangles the first one counts, so that the result does not depend on the tree.
  void cast(const float* origins, const float* directions, std::size_t rays, float max_range,
            int threads, RayHit* hits) const;

 private:
  struct Node {
    std::array<float, 3> low, high;
    std::uint32_t first;  // triangle of a leaf; else the second child, the first one follows
    std::uint32_t count;  // of a leaf; else 0
    int axis;             // along which the first child lies before the second
  };
  void build(std::uint32_t begin, std::uint32_t end, const std::vector<float>& middles);
  RayHit first_hit(const float* origin, const float* direction, float max_range) const;

  std::vector<float> triangles_;      // in the order of the leaves: corner and two edges, 9 each
  std::vector<std::uint32_t> order_;  // row in the input
  std::vector<Node> nodes_;
};

}  // namespace segloc
