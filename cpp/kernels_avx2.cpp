#define SEGLOC_ISA avx2
#include "kernel_table.h"
