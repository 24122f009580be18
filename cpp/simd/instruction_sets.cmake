# The instruction sets. simd/kernel_table.cpp is compiled once for each of them, and one is chosen at
# run time (simd/kernels.h). This is the only list: the header simd/isa_list.h is made from it.
#
#   segloc_isa(NAME PROCESSORS <regex> FEATURES <feature>... FLAGS <flag>...
#              GNU_FLAGS <flag>...)
#
# PROCESSORS: where it exists (CMAKE_SYSTEM_PROCESSOR); everywhere without it. FEATURES: each is a
# flag of the compiler (-mavx2) and a property that the processor is tested for. FLAGS: further ones;
# GNU_FLAGS: those for GCC only.
include(CheckCXXCompilerFlag)
set(SEGLOC_ISA_ROWS)

macro(segloc_isa name)
  cmake_parse_arguments(ISA "" "PROCESSORS" "FEATURES;FLAGS;GNU_FLAGS" ${ARGN})
  set(isa_flags ${ISA_FEATURES})
  list(TRANSFORM isa_flags PREPEND "-m")
  list(APPEND isa_flags ${ISA_FLAGS})
  if(MSVC)
    list(TRANSFORM isa_flags PREPEND "/clang:")
  endif()
  set(isa_built TRUE)
  if(ISA_PROCESSORS AND NOT CMAKE_SYSTEM_PROCESSOR MATCHES "${ISA_PROCESSORS}")
    set(isa_built FALSE)
  elseif(isa_flags)
    string(JOIN " " isa_line ${isa_flags})
    check_cxx_compiler_flag("${isa_line}" SEGLOC_COMPILER_HAS_${name})
    set(isa_built ${SEGLOC_COMPILER_HAS_${name}})
  endif()

  if(isa_built)
    add_library(segloc_kernels_${name} OBJECT simd/kernel_table.cpp)
    target_include_directories(segloc_kernels_${name} PRIVATE ${SEGLOC_INCLUDES})
    target_compile_definitions(segloc_kernels_${name} PRIVATE SEGLOC_ISA=${name})
    target_compile_options(segloc_kernels_${name} PRIVATE ${SEGLOC_SANITIZERS} ${SEGLOC_OPTIONS} ${isa_flags})
    if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
      target_compile_options(segloc_kernels_${name} PRIVATE ${ISA_GNU_FLAGS})
    endif()
    target_sources(segloc_kernels PRIVATE $<TARGET_OBJECTS:segloc_kernels_${name}>)
    set(isa_test "true")
    foreach(feature IN LISTS ISA_FEATURES)
      string(APPEND isa_test " && cpu_features().${feature}")
    endforeach()
    string(APPEND SEGLOC_ISA_ROWS "  BUILT(${name}, ${isa_test}) \\\n")
  else()
    string(APPEND SEGLOC_ISA_ROWS "  MISSING(${name}) \\\n")
  endif()
endmacro()

# The best one last.
set(SEGLOC_X86 "^(x86_64|AMD64|amd64)$")
segloc_isa(portable)
segloc_isa(avx2 PROCESSORS "${SEGLOC_X86}" FEATURES avx2 fma)
segloc_isa(avx512 PROCESSORS "${SEGLOC_X86}" FEATURES avx512f avx512vl avx512bw avx512dq fma
           FLAGS -mprefer-vector-width=512
           GNU_FLAGS -Wno-uninitialized -Wno-maybe-uninitialized)  # GCC warns of its own header

configure_file(simd/isa_list.h.in generated/simd/isa_list.h @ONLY)
