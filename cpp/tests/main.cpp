// One function for each room of the library.
#include <cstdio>
#include <cstring>

#include "tests/digests.h"

void callers_tests();
void common_tests();
void descriptors_tests();
void io_tests();
void local_cloud_tests();
void matching_tests();
void network_tests();
void occupancy_tests();
void pose_tests();
void registration_tests();
void segmentation_tests();
void training_tests();
void verification_tests();

int main(int count, char** arguments) {
  common_tests();
  descriptors_tests();
  io_tests();
  local_cloud_tests();
  matching_tests();
  network_tests();
  occupancy_tests();
  pose_tests();
  registration_tests();
  segmentation_tests();
  training_tests();
  verification_tests();
  callers_tests();
  if (count > 1 && std::strcmp(arguments[1], "--digests") == 0) segloc::print_digests();
  std::puts("kernel tests: 13 passed, 0 failed");
  return 0;
}
