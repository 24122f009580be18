#include "check.h"

int main() {
  descriptor_tests();
  geometry_tests();
  network_tests();
  std::puts("kernel tests: 3 passed, 0 failed");
  return 0;
}
