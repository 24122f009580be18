// What a map knows about points: space that was seen from where its sensor has been.
#pragma once

#include <cstddef>
#include <cstdint>
#include <list>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "likelihood/point_index.h"
#include "likelihood/visibility.h"

namespace segloc {

enum class Known : std::uint8_t {
  kUnknown = 0,  // hidden from all viewpoints, or beyond their range
  kHit = 1,      // on the map
  kThrough = 2,  // in free space before what a viewpoint saw
  kMissed = 3,   // beside what a viewpoint saw there
};

struct KnownSpaceOptions {
  double range = 30;          // of the view from a viewpoint, metres
  double bin_deg = 2;         // width of a pixel of a range image, degrees
  double margin = 0.7;        // distance of free space before a map point, metres
  double half_width = 0.2;    // half width of a point of the thinned map, metres
  std::size_t most = 8;       // nearest viewpoints used
  double storey = 1.5;        // height difference of a viewpoint on another storey, metres
  std::size_t images = 256;   // range images that are kept
};

// Range images of a map from viewpoints, (v, 3), where the sensor was when it was made. G. Kim,
// A. Kim ("Remove, then Revert", IROS 2020) compare range images of a map and of its scans in the
// same way. Images are rendered on first use, and the last ones used are kept: the results do not
// depend on that. Several threads may call at once.
class KnownSpace {
 public:
  // `map` is kept by reference.
  KnownSpace(const PointIndex& map, const double* viewpoints, std::size_t v,
             const KnownSpaceOptions& options);

  // Codes of query points, (m, 3), through a row-major 4 x 4 transform to the map's frame, by the
  // viewpoints nearest to the query's origin. `radius`: within which a point is on the map.
  std::vector<std::uint8_t> codes(const float* points, std::size_t m, const double* transform,
                                  double radius) const;
  double radius() const { return map_.radius(); }

 private:
  using Image = std::shared_ptr<const FreeSpace>;

  std::vector<std::size_t> nearest(const double* place) const;
  Image image(std::size_t viewpoint) const;

  const PointIndex& map_;
  std::vector<double> viewpoints_;
  KnownSpaceOptions options_;
  mutable std::mutex mutex_;
  mutable std::list<std::size_t> used_;  // the last one first
  struct Kept {
    Image image;
    std::list<std::size_t>::iterator place;
  };
  mutable std::unordered_map<std::size_t, Kept> kept_;
};

}  // namespace segloc
