#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The tests once more, built otherwise: those labelled quick or minutes with `clang`, the second compiler, and with `asan` (address,
# undefined behaviour, leaks); with `tsan` (data races) those that train and render in threads; with `msan` (clang: values
# that were never set) the kernels and their tests. Builds in WORK, which is kept: half an hour the first time.
# OpenCL stays out of `tsan`: its driver is not built with it, and each of its locks would be reported. So does `serve`: the
# locks of GLib under GStreamer would be, and a machine is too slow with it for a second session.
# What msan reports counts, a test that fails does not: its code contracts products in other places, so a value may
# differ from that beside it by a rounding.
# Usage: check_preset.sh SOURCE WORK CMAKE asan|tsan|msan|clang
set -euo pipefail
source=$1 work=$2 cmake=$3 preset=$4
case $preset in
  asan | clang) choice=(-L '^(quick|minutes)$' -E 'check_neon|sanitize/|api/test_install') ;;
  tsan) choice=(-R '(unit|files)/test_(two_renderers|ray_reuse|trainer|torso|occupancy_prune|silence|video|live|stream)(_long)?$|e2e/live$|e2e/test_cli_train_render') ;;
  msan) choice=() ;;
  *) echo "FAIL: no preset $preset"; exit 1 ;;
esac
case $preset in msan | clang) command -v clang >/dev/null || { echo "skipped: no clang (Debian's packages clang, libclang-rt-14-dev)"; exit 77; } ;; esac
cd "$source"
"$cmake" --preset "$preset" -B "$work" >/dev/null
"$cmake" --build "$work" --parallel 2 | tail -n 3
# A sanitizer's dlopen looks beside the sanitizer's own library, not beside the caller's.
export LD_LIBRARY_PATH=$work/lib${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
if [ "$preset" = msan ]; then # cmocka, which is not built with it, formats its messages with strlen
  MSAN_OPTIONS=intercept_strlen=0 ctest --test-dir "$work" --output-on-failure --no-tests=error >"$work/log" || true
  tail -n 20 "$work/log"
  if grep -E -A20 'MemorySanitizer|\*\*\*(Exception|Timeout|Not Run)' "$work/log"; then exit 1; fi
  grep -q ' tests passed' "$work/log"
  exit
fi
exec ctest --test-dir "$work" "${choice[@]}" --output-on-failure --no-tests=error
