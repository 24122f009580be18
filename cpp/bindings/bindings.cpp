// The Python module: one function per folder of the library.
#include "bindings/bindings.h"

#include "common/parallel.h"
#include "simd/kernels.h"

namespace segloc::bindings {
namespace {

std::string instruction_set(const std::string& isa) {
  return kIsaNames[static_cast<std::size_t>(parse_isa(isa))];
}

}  // namespace

void bind_local_cloud(nb::module_& m);
void bind_segmentation(nb::module_& m);
void bind_descriptors(nb::module_& m);
void bind_network(nb::module_& m);
void bind_matching(nb::module_& m);
void bind_pose(nb::module_& m);
void bind_registration(nb::module_& m);
void bind_verification(nb::module_& m);
void bind_training(nb::module_& m);
void bind_io(nb::module_& m);
void bind_occupancy(nb::module_& m);

}  // namespace segloc::bindings

NB_MODULE(_native, m) {
  using namespace segloc::bindings;
  m.doc() = "The native kernels of segloc.";
  m.attr("__version__") = SEGLOC_VERSION;
  m.def("resolve_threads", &segloc::resolve_threads, nb::arg("threads"));
  m.def("instruction_set", &instruction_set, nb::arg("isa") = "auto");
  bind_local_cloud(m);
  bind_segmentation(m);
  bind_descriptors(m);
  bind_network(m);
  bind_matching(m);
  bind_pose(m);
  bind_registration(m);
  bind_verification(m);
  bind_training(m);
  bind_io(m);
  bind_occupancy(m);
}
