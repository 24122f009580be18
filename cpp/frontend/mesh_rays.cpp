#include "frontend/mesh_rays.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "common/parallel.h"

namespace segloc {
namespace {

constexpr std::uint32_t kLeaf = 4;     // most triangles of a leaf
constexpr std::size_t kGrain = 256;    // rays of one task
constexpr double kParallel = 1e-12;    // of a ray in the plane of a triangle
constexpr double kSmallest = 1e-30;    // instead of a component that is zero: its inverse is finite
constexpr std::size_t kDeepest = 64;   // halving 2^31 triangles takes 31 levels

using Vector = std::array<double, 3>;

Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// After Moeller and Trumbore, "Fast, minimum storage ray-triangle intersection" (1997): the
// distance in lengths of d, or infinity.
double meets(const float* t, const Vector& o, const Vector& d) {
  constexpr double kNone = std::numeric_limits<double>::infinity();
  const Vector corner{t[0], t[1], t[2]}, one{t[3], t[4], t[5]}, other{t[6], t[7], t[8]};
  const Vector p = cross(d, other);
  const double det = dot(one, p);
  if (!(std::fabs(det) > kParallel)) return kNone;
  const Vector s{o[0] - corner[0], o[1] - corner[1], o[2] - corner[2]};
  const double u = dot(s, p) / det;
  if (!(u >= 0.0 && u <= 1.0)) return kNone;
  const Vector q = cross(s, one);
  const double v = dot(d, q) / det;
  if (!(v >= 0.0 && u + v <= 1.0)) return kNone;
  const double range = dot(other, q) / det;
  return range > 0.0 ? range : kNone;
}

}  // namespace

MeshRays::MeshRays(const float* triangles, std::size_t n) : order_(n) {
  std::iota(order_.begin(), order_.end(), std::uint32_t{0});
  if (n == 0) return;
  std::vector<float> middles(3 * n);
  for (std::size_t i = 0; i < n; ++i) {
    const float* t = triangles + 9 * i;
    for (int a = 0; a < 3; ++a) middles[3 * i + a] = t[a] / 3 + t[3 + a] / 3 + t[6 + a] / 3;
  }
  triangles_.assign(triangles, triangles + 9 * n);
  nodes_.reserve(n);
  build(0, static_cast<std::uint32_t>(n), middles);
  for (std::size_t k = 0; k < n; ++k) {
    const float* t = triangles + 9 * std::size_t{order_[k]};
    float* own = triangles_.data() + 9 * k;
    for (int a = 0; a < 3; ++a) {
      own[a] = t[a];
      own[3 + a] = t[3 + a] - t[a];
      own[6 + a] = t[6 + a] - t[a];
    }
  }
}

void MeshRays::build(std::uint32_t begin, std::uint32_t end, const std::vector<float>& middles) {
  Node node{{}, {}, begin, end - begin, 0};
  node.low.fill(std::numeric_limits<float>::max());
  node.high.fill(std::numeric_limits<float>::lowest());
  std::array<float, 3> low = node.low, high = node.high;
  for (std::uint32_t k = begin; k < end; ++k) {
    for (int a = 0; a < 3; ++a) {
      for (int corner = 0; corner < 3; ++corner) {
        const float value = triangles_[9 * std::size_t{order_[k]} + 3 * corner + a];
        node.low[a] = std::min(node.low[a], value);
        node.high[a] = std::max(node.high[a], value);
      }
      const float middle = middles[3 * std::size_t{order_[k]} + a];
      low[a] = std::min(low[a], middle);
      high[a] = std::max(high[a], middle);
    }
  }
  const std::size_t place = nodes_.size();
  nodes_.push_back(node);
  if (end - begin <= kLeaf) return;
  int axis = 0;
  for (int a = 1; a < 3; ++a) {
    if (high[a] - low[a] > high[axis] - low[axis]) axis = a;
  }
  const std::uint32_t half = begin + (end - begin) / 2;
  std::nth_element(order_.begin() + begin, order_.begin() + half, order_.begin() + end,
                   [&](std::uint32_t i, std::uint32_t j) {
                     const float a = middles[3 * std::size_t{i} + axis];
                     const float b = middles[3 * std::size_t{j} + axis];
                     return a < b || (a == b && i < j);
                   });
  build(begin, half, middles);
  nodes_[place].first = static_cast<std::uint32_t>(nodes_.size());
  nodes_[place].count = 0;
  nodes_[place].axis = axis;
  build(half, end, middles);
}

RayHit MeshRays::first_hit(const float* origin, const float* direction, float max_range) const {
  const Vector o{origin[0], origin[1], origin[2]}, d{direction[0], direction[1], direction[2]};
  Vector inverse;
  for (int a = 0; a < 3; ++a) inverse[a] = 1.0 / (std::fabs(d[a]) > kSmallest ? d[a] : kSmallest);
  double nearest = max_range;
  std::uint32_t hit = std::numeric_limits<std::uint32_t>::max();
  const auto enters = [&](const Node& node) {
    double first = 0.0, last = nearest;
    for (int a = 0; a < 3; ++a) {
      const double x = (double{node.low[a]} - o[a]) * inverse[a];
      const double y = (double{node.high[a]} - o[a]) * inverse[a];
      first = std::max(first, std::min(x, y));
      last = std::min(last, std::max(x, y));
    }
    // Rounding must not lose a wall that is as thin as its box.
    return first <= last * (1 + 1e-9) + 1e-9;
  };
  std::array<std::uint32_t, kDeepest> later;
  std::size_t waiting = 0;
  if (!nodes_.empty()) later[waiting++] = 0;
  while (waiting > 0) {
    const std::uint32_t at = later[--waiting];
    const Node& node = nodes_[at];
    if (!enters(node)) continue;
    if (node.count == 0) {
      const bool forward = d[node.axis] > 0;  // the nearer child is searched first
      later[waiting++] = forward ? node.first : at + 1;
      later[waiting++] = forward ? at + 1 : node.first;
      continue;
    }
    for (std::uint32_t k = node.first; k < node.first + node.count; ++k) {
      const double range = meets(triangles_.data() + 9 * std::size_t{k}, o, d);
      if (range < nearest || (range == nearest && order_[k] < hit)) {
        nearest = range;
        hit = order_[k];
      }
    }
  }
  if (hit == std::numeric_limits<std::uint32_t>::max()) {
    return {std::numeric_limits<float>::infinity(), -1};
  }
  return {static_cast<float>(nearest), static_cast<std::int32_t>(hit)};
}

void MeshRays::cast(const float* origins, const float* directions, std::size_t rays,
                    float max_range, int threads, RayHit* hits) const {
  parallel_for(rays, kGrain, threads, [&](std::size_t begin, std::size_t end, int) {
    for (std::size_t i = begin; i < end; ++i) {
      hits[i] = first_hit(origins + 3 * i, directions + 3 * i, max_range);
    }
  });
}

}  // namespace segloc
