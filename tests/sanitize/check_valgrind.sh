#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# A small way from a clip to a picture under valgrind's memcheck: values that were never set, accesses out of bounds,
# leaks. Valgrind knows AVX2 and not AVX-512, and says so to programs that ask, as ours does.
# Skipped (77) where valgrind is missing. Usage: check_valgrind.sh ERNERF WORK
set -euo pipefail
ernerf=$1 work=$2 known=$(cd "$(dirname "$0")" && pwd)/valgrind.supp
command -v valgrind >/dev/null || { echo "skipped: no valgrind (Debian's package valgrind)"; exit 77; }
rm -rf "$work" && mkdir -p "$work" && cd "$work"
watched() {
  valgrind --quiet --error-exitcode=9 --leak-check=full --errors-for-leak-kinds=definite --show-leak-kinds=definite \
    --num-callers=24 --suppressions="$known" "$ernerf" "$@"
}
"$ernerf" synth clip --size 64 --frames 8 --seed 5 --quiet
watched train clip -o head.safetensors --iters 3 --rays 32 --levels 2 --threads 2 --backend cpu --quiet
watched render head.safetensors --clip clip --frames 0:1 -o %d.png --threads 2 --backend cpu --quiet
echo "clean"
