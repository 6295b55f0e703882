#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The libraries against those of the last release, by abidiff: what a program of that release relies on is still there.
# The base is the last tag vX.Y.Z; without one, or without abidiff, the test is skipped.
# Usage: check_abidiff.sh SOURCE WORK, with CMAKE in the environment
set -euo pipefail
source=$1 work=$2
fail() { echo "FAIL: $*"; exit 1; }
command -v abidiff >/dev/null || { echo "abidiff is missing (abigail-tools)"; exit 77; }
base=$(git -C "$source" describe --tags --abbrev=0 --match 'v[0-9]*' 2>/dev/null) || { echo "no release to compare with"; exit 77; }
rm -rf "$work" && mkdir -p "$work/base" "$work/now"
git -C "$source" archive "$base" | tar -x -C "$work/base"
(cd "$source" && git ls-files -z --cached | xargs -0 cp --parents -t "$work/now")
for place in base now; do
  {
    "$CMAKE" -S "$work/$place" -B "$work/$place/build" -G Ninja -DCMAKE_BUILD_TYPE=RelWithDebInfo -DERNERF_TESTS=OFF
    "$CMAKE" --build "$work/$place/build"
  } >"$work/build.log" 2>&1 || { tail -n 20 "$work/build.log"; fail "$place"; }
done
for library in libernerf libernerf-media libernerf-prepare; do
  status=0
  abidiff --headers-dir1 "$work/base/include" --headers-dir2 "$work/now/include" --drop-private-types \
    "$work/base/build/lib/$library.so" "$work/now/build/lib/$library.so" >"$work/$library.txt" || status=$?
  # 4: something has changed, 8: so that programs break (abidiff(1)); 1 and 2 are errors
  [ $((status & 11)) = 0 ] || { cat "$work/$library.txt"; fail "$library since $base"; }
done
echo "compatible with $base"
