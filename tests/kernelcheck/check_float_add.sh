#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Compiles the grids' kernels for GPUs that are not here, with each way to add to a float in memory (kernels/float_add.cl),
# and looks for the one instruction, and for no loop, in what comes out. Skipped (77) without clang 14 or later.
# Usage: check_float_add.sh SOURCE
set -euo pipefail
export LC_ALL=C
kernels=$1/src/backend_opencl/kernels

clang=""
for name in clang clang-14 clang-15 clang-16 clang-17 clang-18 clang-19; do
  if [ -z "$clang" ] && command -v $name >/dev/null && $name -print-targets | grep -q amdgcn; then clang=$name; fi
done
[ -n "$clang" ] || { echo "skipped: no clang with the targets of GPUs (Debian's package clang)"; exit 77; }

faults=0
# what, the way, version of OpenCL C, -S or -emit-llvm, word that the output has; options of the target
expect() {
  local name=$1 way=$2 standard=$3 form=$4 word=$5
  shift 5
  if ! cat "$kernels"/{common,float_add,hashgrid}.cl | $clang -x cl -cl-std="$standard" "$@" -S $form -O2 -w -nogpulib -Xclang \
    -finclude-default-header -D WIDTH=1 -D CPU=0 -D NVIDIA=$((way == 1)) -D FLOAT_ADD="$way" -D DIMS=2 -D FEATURES=1 -D INVERSE=1 \
    -D DIVIDE=0 -D OWNERS=512 -D GROUP=64 -D VECTORS=1 -o out - 2>errors; then
    [ "$word" = refused ] && grep -q atomic_fadd errors && return
    echo "$name: does not compile: $(head -n 3 errors)"
    faults=$((faults + 1))
  elif ! grep -q "$word" out; then
    echo "$name: no $word"
    faults=$((faults + 1))
  elif [ "$way" -ne 0 ] && grep -q "cmpxchg\|cmpswap\|atom.*cas" out; then
    echo "$name: a loop"
    faults=$((faults + 1))
  fi
}
expect "the loop" 0 CL1.2 -emit-llvm cmpxchg -target spir64
expect cl_ext_float_atomics 2 CL3.0 -emit-llvm atomic_fetch_add_explicit -target spir64
expect "AMD gfx90a" 3 CL1.2 "" global_atomic_add_f32 -target amdgcn-amd-amdhsa -mcpu=gfx90a
expect "AMD gfx906, which has no such instruction" 3 CL1.2 "" refused -target amdgcn-amd-amdhsa -mcpu=gfx906
expect "AMD gfx906, the loop" 0 CL1.2 "" cmpxchg -target amdgcn-amd-amdhsa -mcpu=gfx906
expect "NVIDIA" 1 CL1.2 "" red.global.add.f32 -target nvptx64-nvidia-nvcl -D asm=__asm__
[ "$faults" -eq 0 ]
