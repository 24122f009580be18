#include "simd/kernels.h"

#include <cstddef>
#include <iterator>
#include <stdexcept>

#include "common/portability.h"

namespace segloc {

#define SEGLOC_DECLARE(name, runs) \
  namespace name {                 \
  extern const Kernels kTable;     \
  }
#define SEGLOC_NOTHING(name)
SEGLOC_ISAS(SEGLOC_DECLARE, SEGLOC_NOTHING)
#undef SEGLOC_DECLARE
#undef SEGLOC_NOTHING

namespace {

struct IsaRow {
  const char* name;
  const Kernels* table;  // null where it is not part of this build
  bool runs;             // on this processor
};

constexpr std::size_t kIsas = std::size(kIsaNames);

// In the order of the enumeration. Not a function's static variable, whose guard could be locked
// when another thread forks.
#define SEGLOC_BUILT(name, runs) IsaRow{#name, &name::kTable, runs},
#define SEGLOC_MISSING(name) IsaRow{#name, nullptr, false},
const IsaRow kRows[] = {SEGLOC_ISAS(SEGLOC_BUILT, SEGLOC_MISSING)};
#undef SEGLOC_BUILT
#undef SEGLOC_MISSING

// "portable, avx2 or avx512"
std::string all_names() {
  std::string names;
  for (std::size_t i = 0; i < kIsas; ++i) {
    names += i == 0 ? "" : i + 1 == kIsas ? " or " : ", ";
    names += kIsaNames[i];
  }
  return names;
}

}  // namespace

const Kernels& kernels(Isa isa) {
  const Kernels* table = kRows[static_cast<std::size_t>(isa)].table;
  return table != nullptr ? *table : portable::kTable;
}

const Kernels& best_kernels() {
  std::size_t best = kIsas - 1;
  while (!kRows[best].runs) --best;
  return *kRows[best].table;
}

Isa parse_isa(const std::string& name) {
  for (std::size_t i = kIsas; i-- > 0;) {
    if (name == "auto" ? kRows[i].runs : name == kRows[i].name) {
      if (!kRows[i].runs) throw std::invalid_argument("this machine does not run " + name);
      return static_cast<Isa>(i);
    }
  }
  throw std::invalid_argument("isa must be auto, " + all_names() + ", not '" + name + "'");
}

}  // namespace segloc
