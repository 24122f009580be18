#include "bindings.h"

#include "lzf.h"
#include "parallel.h"

namespace {

segloc::bindings::Out<std::uint8_t> lzf_decompress(segloc::bindings::In1<std::uint8_t> data,
                                                   std::size_t size) {
  std::vector<std::uint8_t> out;
  {
    nanobind::gil_scoped_release release;
    out = segloc::lzf_decompress(data.data(), data.size(), size);
  }
  return segloc::bindings::to_numpy(std::move(out));
}

}  // namespace

NB_MODULE(_native, m) {
  m.doc() = "The native kernels of segloc.";
  m.attr("__version__") = SEGLOC_VERSION;
  m.def("resolve_threads", &segloc::resolve_threads, nanobind::arg("threads"));
  m.def("lzf_decompress", &lzf_decompress, nanobind::arg("data").noconvert(),
        nanobind::arg("size"));
}
