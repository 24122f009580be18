#include "frontend/voxel_window.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <utility>

#include "common/cells.h"
#include "frontend/crop.h"

namespace segloc {
namespace {

constexpr double kDiagonal = 1.5;  // of the square that a radius spans, and a little more

Fixed fixed(double metres, double scale) { return std::llrint(metres * scale); }

// Numbers for the cells in a cube, in their order: x runs fastest.
struct Cube {
  std::array<Fixed, 3> low;
  std::array<std::uint64_t, 3> width;

  // The cells within `half` of a centre (all in cells), of those that keys around `near` tell
  // apart.
  Cube(const std::array<double, 3>& centre, double half, const std::array<Fixed, 3>& near) {
    constexpr double kHalf = double(std::uint64_t{1} << (kAxisBits - 1));
    for (std::size_t a = 0; a < 3; ++a) {
      const double least = double(near[a]) - kHalf, most = double(near[a]) + kHalf;
      const double begin = std::clamp(std::floor(centre[a] - half), least, most);
      const double end = std::clamp(std::ceil(centre[a] + half), least, most);
      low[a] = static_cast<Fixed>(begin);
      width[a] = static_cast<std::uint64_t>(end - begin) + 1;
    }
  }
  std::uint64_t number(const std::array<Fixed, 3>& cell) const {
    const auto step = [&](std::size_t a) { return static_cast<std::uint64_t>(cell[a] - low[a]); };
    return step(0) + width[0] * (step(1) + width[1] * step(2));
  }
  int bits() const {
    int bits = 1;
    while (bits < 64 && ((width[0] * width[1] * width[2] - 1) >> bits) != 0) ++bits;
    return bits;
  }
};

// Rows of three in the order of their numbers.
std::vector<float> sorted(const std::vector<float>& points, std::vector<std::uint64_t>& numbers,
                          int bits) {
  std::vector<std::uint32_t> order(numbers.size());
  std::iota(order.begin(), order.end(), 0u);
  radix_sort(numbers, order, bits);
  std::vector<float> result;
  result.reserve(points.size());
  for (const std::size_t i : order) {
    for (std::size_t a = 0; a < 3; ++a) result.push_back(points[3 * i + a]);
  }
  return result;
}

}  // namespace

VoxelWindow::VoxelWindow(double voxel_size, double reach) : voxel_size_(voxel_size), reach_(reach) {
  if (!(voxel_size > 0.0) || !(reach > 0.0))
    throw std::invalid_argument("voxel_size and reach must be positive");
  if (!(reach / voxel_size < kReach))
    throw std::invalid_argument("voxel_size is too small for this reach");
}

void VoxelWindow::push(const float* points, std::size_t n, const Rigid& T_odom_sensor) {
  if (scans_.size() >= kMostScans) throw std::invalid_argument("too many scans in one window");
  std::vector<Rigid> poses = {T_odom_sensor};
  for (const ThinScan& scan : scans_) poses.push_back(scan.T);
  check_places(poses);
  scans_.push_back({thinned(points, n), T_odom_sensor});
  placed(scans_.back()).add_to(table_);
}

void VoxelWindow::drop(std::size_t position) {
  if (position >= scans_.size()) throw std::invalid_argument("position: there is no such scan");
  placed(scans_[position]).remove_from(table_);
  scans_.erase(scans_.begin() + static_cast<std::ptrdiff_t>(position));
}

void VoxelWindow::move(const std::vector<Rigid>& T_odom_sensor) {
  if (T_odom_sensor.size() != scans_.size())
    throw std::invalid_argument("T_odom_sensor must have one pose for each scan");
  check_places(T_odom_sensor);
  std::vector<std::size_t> moved;
  for (std::size_t i = 0; i < scans_.size(); ++i) {
    const Rigid& T = T_odom_sensor[i];
    if (T.R != scans_[i].T.R || T.t != scans_[i].T.t) moved.push_back(i);
  }
  // All leave before the first returns: cells must never be told apart across both places.
  for (const std::size_t i : moved) placed(scans_[i]).remove_from(table_);
  for (const std::size_t i : moved) {
    scans_[i].T = T_odom_sensor[i];
    placed(scans_[i]).add_to(table_);
  }
}

// Throws unless all that is seen from these places can be told apart.
void VoxelWindow::check_places(const std::vector<Rigid>& T_odom_sensor) const {
  for (std::size_t a = 0; a < 3; ++a) {
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (const Rigid& T : T_odom_sensor) {
      low = std::min(low, T.t[a] / voxel_size_);
      high = std::max(high, T.t[a] / voxel_size_);
    }
    if (high >= kFarthest || low <= -kFarthest)
      throw std::invalid_argument("T_odom_sensor is too far from the origin for this voxel_size");
    if (high - low > kReach)
      throw std::invalid_argument("T_odom_sensor is too far from the other scans");
  }
}

// The mean of every voxel of half the edge within reach.
std::vector<float> VoxelWindow::thinned(const float* points, std::size_t n) const {
  const std::vector<float> near = within_range(points, n, reach_);
  return voxel_grid(near.data(), near.size() / 3, voxel_size_ / 2);
}

// The voxels of a scan where it stands.
const VoxelRuns& VoxelWindow::placed(const ThinScan& scan) {
  const double scale = double(kOne) / voxel_size_;
  runs_.clear();
  for (std::size_t i = 0; i < scan.points.size(); i += 3) {
    const double point[3] = {scan.points[i], scan.points[i + 1], scan.points[i + 2]};
    const std::array<double, 3> q = scan.T.apply(point);
    runs_.append(fixed(q[0], scale), fixed(q[1], scale), fixed(q[2], scale));
  }
  return runs_;
}

std::vector<float> VoxelWindow::cloud(const Rigid& T_local_odom, double radius) const {
  if (scans_.empty()) return {};
  std::array<double, 3> centre;  // of the cloud, in cells
  const auto& [R, t] = T_local_odom;
  std::array<Fixed, 3> near;  // the first scan's
  for (std::size_t a = 0; a < 3; ++a) {
    near[a] = fixed(scans_.front().T.t[a] / voxel_size_, 1.0);
    centre[a] = -(R[a] * t[0] + R[3 + a] * t[1] + R[6 + a] * t[2]) / voxel_size_;
  }
  const Cube cube(centre, kDiagonal * radius / voxel_size_ + 2.0, near);
  std::vector<float> points;
  std::vector<std::uint64_t> numbers;
  points.reserve(3 * table_.size());
  numbers.reserve(table_.size());
  table_.visit([&](std::uint64_t key, const VoxelSum& sum) {
    const std::array<Fixed, 3> cell = cell_near(key, near);
    std::array<double, 3> mean = sum.mean(cell);
    for (double& v : mean) v *= voxel_size_;
    const std::array<double, 3> p = T_local_odom.apply(mean.data());
    if (!is_near_axis(p, radius)) return;
    numbers.push_back(cube.number(cell));
    for (const double v : p) points.push_back(static_cast<float>(v));
  });
  return sorted(points, numbers, cube.bits());
}

std::size_t VoxelWindow::nbytes() const {
  std::size_t bytes = table_.nbytes() + runs_.nbytes();
  for (const ThinScan& scan : scans_) bytes += scan.points.capacity() * sizeof(float);
  return bytes;
}

}  // namespace segloc
