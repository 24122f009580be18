// The scans of a window as one thinned cloud; work is proportional to the scans added and dropped.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

#include "common/rigid.h"
#include "frontend/voxel_table.h"

namespace segloc {

// Each scan is thinned once, in its own frame, to the mean of every voxel of half the edge. The
// remaining points are summed in voxels of a lattice fixed in the odometry's frame. The sums are
// integers, so the window depends only on its scans and their poses, not on dropped scans.
class VoxelWindow {
 public:
  static constexpr std::size_t kMostScans = 8192;  // their sums do not overflow
  static constexpr double kReach = 1 << 18;        // cells that scans see, or lie apart, at most
  static constexpr double kFarthest = 1ll << 38;   // cells from the odometry's origin

  // Voxels of edge `voxel_size`, metres; points farther from the sensor than `reach` are left out.
  // Throws std::invalid_argument where the lattice is too fine for the reach.
  VoxelWindow(double voxel_size, double reach);

  // Adds a scan behind all others. Points are (n, 3) row-major, finite, in the sensor's frame.
  // Throws std::invalid_argument where there are too many scans, or the pose lies too far off.
  void push(const float* points, std::size_t n, const Rigid& T_odom_sensor);

  // Drops the scan at a position, 0 for the first.
  void drop(std::size_t position);

  // Puts the scans to other poses, one for each, first scan first; those of the same pose stay.
  // Throws std::invalid_argument, and changes nothing, where poses lie too far off.
  void move(const std::vector<Rigid>& T_odom_sensor);

  // The mean of every voxel, in the frame T_local_odom leads to, in the order of the voxels (x runs
  // fastest). Those farther than `radius` from its z axis, or from its x-y plane, are left out.
  std::vector<float> cloud(const Rigid& T_local_odom, double radius) const;

  std::size_t scans() const { return scans_.size(); }
  std::size_t voxels() const { return table_.size(); }
  std::size_t nbytes() const;

 private:
  struct ThinScan {
    std::vector<float> points;
    Rigid T;
  };

  void check_places(const std::vector<Rigid>& T_odom_sensor) const;
  std::vector<float> thinned(const float* points, std::size_t n) const;
  const VoxelRuns& placed(const ThinScan& scan);

  double voxel_size_, reach_;
  std::deque<ThinScan> scans_;
  VoxelTable table_;
  VoxelRuns runs_;
};

}  // namespace segloc
