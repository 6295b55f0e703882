#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# No two files need each other, also not by way of others. NAME.c, NAME.cpp and NAME.h are one; an arrow is an #include.
set -euo pipefail
source=$1
arrows() { # in folder $1: "a b" for each file a that includes b; names in includes begin there
  cd "$1"
  grep -rE --include='*.c' --include='*.cpp' --include='*.h' '^ *# *include "' . |
    sed -E 's|^\./||; s|\.[a-z]+: *# *include "([^"]*)\.h".*| \1|' | awk '$1 != $2'
}
trap 'rm -f "$list"' EXIT
list=$(mktemp)
for folder in include src tools/ernerf-cli; do
  (arrows "$source/$folder") >"$list"
  if [ "$(wc -l <"$list")" -lt 5 ]; then
    echo "FAIL: $folder: hardly an include was found"
    exit 1
  fi
  if ! tsort "$list" >/dev/null; then # names the files of the circle
    echo "FAIL: $folder: these files include each other"
    exit 1
  fi
done
printf 'a b\nb c\nc a\n' >"$list" # a circle is seen
if tsort "$list" >/dev/null 2>&1; then
  echo "FAIL: tsort finds no circle"
  exit 1
fi
echo "ok: no circle"
