#include "kernels.h"

#include <stdexcept>

namespace segloc {

namespace portable {
extern const Kernels kTable;
}
#if defined(SEGLOC_X86_KERNELS)
namespace avx2 {
extern const Kernels kTable;
}
namespace avx512 {
extern const Kernels kTable;
}
#endif

namespace {

bool available(Isa isa) {
#if defined(SEGLOC_X86_KERNELS)
  __builtin_cpu_init();
  if (isa == Isa::avx2) return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  if (isa == Isa::avx512) {
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("fma");
  }
#endif
  return isa == Isa::portable;
}

}  // namespace

const Kernels& kernels(Isa isa) {
#if defined(SEGLOC_X86_KERNELS)
  if (isa == Isa::avx512) return avx512::kTable;
  if (isa == Isa::avx2) return avx2::kTable;
#endif
  (void)isa;
  return portable::kTable;
}

Isa parse_isa(const std::string& name) {
  if (name == "auto") {
    if (available(Isa::avx512)) return Isa::avx512;
    return available(Isa::avx2) ? Isa::avx2 : Isa::portable;
  }
  Isa isa = Isa::portable;
  if (name == "avx2") {
    isa = Isa::avx2;
  } else if (name == "avx512") {
    isa = Isa::avx512;
  } else if (name != "portable") {
    throw std::invalid_argument("isa must be auto, portable, avx2 or avx512, not '" + name + "'");
  }
  if (!available(isa)) throw std::invalid_argument("this machine does not run " + name);
  return isa;
}

}  // namespace segloc
