#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Two builds of the tree, in folders of different names, install the same bytes, and cpack packs the same archive.
# Usage: check_reproducible.sh SOURCE WORK, with CMAKE in the environment
set -euo pipefail
source=$1 work=$2
fail() { echo "FAIL: $*"; exit 1; }
rm -rf "$work" && mkdir -p "$work"
export SOURCE_DATE_EPOCH=1700000000
for place in one another/deeper; do
  mkdir -p "$work/$place/source"
  (cd "$source" && git ls-files -z --cached | xargs -0 cp --parents -t "$work/$place/source") || exit 77 # no clone
  {
    "$CMAKE" -S "$work/$place/source" -B "$work/$place/build" -G Ninja -DCMAKE_BUILD_TYPE=Release -DERNERF_TESTS=OFF
    "$CMAKE" --build "$work/$place/build"
    "$CMAKE" --install "$work/$place/build" --prefix "$work/$place/root"
    (cd "$work/$place/build" && "$(dirname "$CMAKE")/cpack" -B "$work/$place/packed")
  } >"$work/build.log" 2>&1 || { tail -n 20 "$work/build.log"; fail "$place"; }
done
diff -r "$work/one/root" "$work/another/deeper/root" || fail "two builds install other files"
cmp "$work/one/packed/"*.tar.gz "$work/another/deeper/packed/"*.tar.gz || fail "two archives differ"
echo "$(find "$work/one/root" -type f | wc -l) files are the same"
