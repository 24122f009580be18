// Helpers of the readers of scans and maps.
#include "bindings/bindings.h"
#include "io/lzf.h"
#include "io/octree.h"

namespace segloc::bindings {
namespace {

Out<std::uint8_t> lzf_decompress_(const In1<std::uint8_t>& data, std::size_t size) {
  std::vector<std::uint8_t> out;
  {
    nb::gil_scoped_release release;
    out = lzf_decompress(data.data(), data.size(), size);
  }
  return to_numpy(std::move(out));
}

Out<std::uint8_t> octree_encode_(const In2<std::int32_t>& cells, int levels) {
  require(cells.shape(1) == 3, "cells must have shape (N, 3)");
  require(cells.shape(0) <= std::numeric_limits<std::uint32_t>::max(), "cells has too many rows");
  std::vector<std::uint8_t> codes;
  {
    nb::gil_scoped_release release;
    codes = octree_encode(cells.data(), cells.shape(0), levels);
  }
  return to_numpy(std::move(codes));
}

Out<float> octree_points_(const In1<std::uint8_t>& codes, int levels, std::size_t count,
                          const In1<std::uint8_t>& parts, int bits, const In1<std::int64_t>& low,
                          const In1<double>& origin, double voxel) {
  require(bits == 0 || bits == 1 || bits == 2 || bits == 4, "bits must be 0, 1, 2 or 4");
  require(low.size() == 3 && origin.size() == 3, "low and origin must have shape (3,)");
  require(count <= std::numeric_limits<std::uint32_t>::max(), "count is too large");
  require(parts.size() == (3 * count * std::size_t(bits) + 7) / 8, "parts has a wrong length");
  require_usable(origin.data(), 3, "origin");
  require_length(voxel, "voxel");
  VoxelGrid grid{{}, {}, voxel, bits};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    grid.low[axis] = low.data()[axis];
    grid.origin[axis] = origin.data()[axis];
    require(std::abs(double(grid.low[axis])) <= 1e15, "low lies beyond 1e15");
  }
  std::vector<float> points;
  {
    nb::gil_scoped_release release;
    points = octree_points(codes.data(), codes.size(), levels, count, parts.data(), grid);
  }
  return to_numpy(std::move(points), {count, 3});
}

}  // namespace

void bind_io(nb::module_& m) {
  m.def("lzf_decompress", &lzf_decompress_, nb::arg("data").noconvert(), nb::arg("size"));
  m.def("octree_encode", &octree_encode_, nb::arg("cells").noconvert(), nb::arg("levels"));
  m.def("octree_points", &octree_points_, nb::arg("codes").noconvert(), nb::arg("levels"),
        nb::arg("count"), nb::arg("parts").noconvert(), nb::arg("bits"), nb::arg("low").noconvert(),
        nb::arg("origin").noconvert(), nb::arg("voxel"));
}

}  // namespace segloc::bindings
