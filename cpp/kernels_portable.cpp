#define SEGLOC_ISA portable
#include "kernel_table.h"
