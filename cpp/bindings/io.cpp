// Helpers of the scan readers.
#include "bindings/bindings.h"
#include "io/lzf.h"

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

}  // namespace

void bind_io(nb::module_& m) {
  m.def("lzf_decompress", &lzf_decompress_, nb::arg("data").noconvert(), nb::arg("size"));
}

}  // namespace segloc::bindings
