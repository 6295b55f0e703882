#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The kernels for NEON: cross-built for aarch64 with the checks of this folder and hard cases of tests/numerics, or with
# those of the environment's NOUNS alone, which then run under qemu's user-mode emulation. That shows what they compute,
# not how fast. Skipped (77) where a tool or a library for it is missing; `tools/install-packages --arm64` installs them.
# Usage: check_neon.sh SOURCE BUILD CMAKE GENERATOR WERROR
set -euo pipefail
source=$1 build=$2 cmake=$3 generator=$4 werror=$5

skip() {
  echo "skipped: $*"
  exit 77
}
[ "$(uname -m)" != aarch64 ] || skip "this machine has NEON; the other checks of this folder run its kernels"
hint="tools/install-packages --arm64 installs it"
command -v aarch64-linux-gnu-gcc >/dev/null || skip "no aarch64-linux-gnu-gcc ($hint)"
echo '#include <math.h>' | aarch64-linux-gnu-gcc -E - >/dev/null 2>&1 || skip "no C library for aarch64-linux-gnu-gcc ($hint)"
command -v qemu-aarch64 >/dev/null || skip "no qemu-aarch64 ($hint)"
[ -e "$source/build/arm64/usr/lib/aarch64-linux-gnu/libcmocka.so" ] || skip "no cmocka for arm64 ($hint)"

unset CC CFLAGS LDFLAGS CMAKE_TOOLCHAIN_FILE # they are meant for the build for this machine
"$cmake" -S "$source" -B "$build" -G "$generator" --toolchain "$source/cmake/aarch64-linux-gnu.cmake" \
  -DCMAKE_BUILD_TYPE=Release -DCMAKE_C_FLAGS_RELEASE=-O1 -DERNERF_KERNELCHECK_ONLY=ON -DERNERF_WERROR="$werror" -DERNERF_KERNELCHECK_NOUNS="${NOUNS-}"
"$cmake" --build "$build" --parallel "$(nproc)"
"$(dirname "$cmake")/ctest" --test-dir "$build" --parallel "$(nproc)" --output-on-failure --no-tests=error
