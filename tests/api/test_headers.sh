#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Each public header compiles alone, twice in a row, as C17 and as C++17 without a warning.
# Usage: test_headers.sh SOURCE CC CXX
set -euo pipefail
source=$1 cc=$2 cxx=$3
flags=(-pedantic -Wall -Wextra -Werror -fsyntax-only -I "$source/include")
count=0
for header in "$source"/include/ernerf/*.h; do
  name=ernerf/$(basename "$header")
  twice=$(printf '#include "%s"\n#include "%s"\nint alone;' "$name" "$name")
  "$cc" -std=c17 "${flags[@]}" -x c - <<<"$twice" || { echo "FAIL: $name as C17"; exit 1; }
  "$cxx" -std=c++17 "${flags[@]}" -x c++ - <<<"$twice" || { echo "FAIL: $name as C++17"; exit 1; }
  count=$((count + 1))
done
[ "$count" -ge 8 ] || { echo "FAIL: only $count headers in $source/include/ernerf"; exit 1; }
echo "$count headers compile alone"
