#include "bindings.h"

#include "parallel.h"

namespace segloc::bindings {

void bind_descriptors(nb::module_& m);
void bind_geometry(nb::module_& m);
void bind_registration(nb::module_& m);
void bind_io(nb::module_& m);
void bind_network(nb::module_& m);
void bind_training(nb::module_& m);
void bind_profile(nb::module_& m);

}  // namespace segloc::bindings

NB_MODULE(_native, m) {
  m.doc() = "The native kernels of segloc.";
  m.attr("__version__") = SEGLOC_VERSION;
  m.def("resolve_threads", &segloc::resolve_threads, nanobind::arg("threads"));
  segloc::bindings::bind_descriptors(m);
  segloc::bindings::bind_geometry(m);
  segloc::bindings::bind_registration(m);
  segloc::bindings::bind_io(m);
  segloc::bindings::bind_network(m);
  segloc::bindings::bind_training(m);
  segloc::bindings::bind_profile(m);
}
