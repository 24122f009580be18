#define SEGLOC_ISA avx512
#include "kernel_table.h"
