# The kernels of backend_cpu/simd are compiled once for each instruction set, whose name is ERN_ISA_NAME (simd/isa.h).
# The library selects one at run time. Appends to engine_objects.
set(ERN_X86_KERNELS OFF)
set(ERN_ARM_KERNELS OFF)
set(simd ${CMAKE_CURRENT_SOURCE_DIR}/backend_cpu/simd)
file(GLOB simd_sources CONFIGURE_DEPENDS ${simd}/*.c)
list(REMOVE_ITEM simd_sources ${simd}/peak_avx512bf16.c)
function(ern_instruction_set name sources) # ... flags
  add_library(ernerf_${name} OBJECT ${sources})
  target_compile_definitions(ernerf_${name} PRIVATE ERN_ISA_NAME=${name})
  target_compile_options(ernerf_${name} PRIVATE -O3 -ffp-contract=fast ${ARGN})
endfunction()
if(CMAKE_SYSTEM_PROCESSOR MATCHES "^(x86_64|AMD64)$" AND NOT ERNERF_REF_ONLY)
  set(ERN_X86_KERNELS ON)
  ern_instruction_set(avx2 "${simd_sources}" -mavx2 -mfma)
  set(avx512 -mavx512f -mavx512dq -mavx512bw -mavx512vl -mfma -mprefer-vector-width=512)
  ern_instruction_set(avx512 "${simd_sources}" ${avx512})
  # bf16 pairs in rendering, and in training on request
  ern_instruction_set(avx512bf16 "${simd}/render.c;${simd}/step.c;${simd}/peak_avx512bf16.c" ${avx512} -mavx512bf16)
  target_compile_definitions(ernerf_avx512bf16 PRIVATE ERN_TILE_PAIRS)
  list(APPEND engine_objects ernerf_avx2 ernerf_avx512 ernerf_avx512bf16)
elseif(CMAKE_SYSTEM_PROCESSOR MATCHES "^(aarch64|arm64)$" AND NOT ERNERF_REF_ONLY)
  set(ERN_ARM_KERNELS ON)
  ern_instruction_set(neon "${simd_sources}") # part of every aarch64
  list(APPEND engine_objects ernerf_neon)
endif()
