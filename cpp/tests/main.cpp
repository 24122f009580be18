#include "check.h"

int main() {
  descriptor_tests();
  geometry_tests();
  network_tests();
  training_tests();
  std::puts("kernel tests: 4 passed, 0 failed");
  return 0;
}
