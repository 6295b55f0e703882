#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# No two files need each other, also not by way of others. NAME.c, NAME.cpp and NAME.h are one. An arrow is an #include;
# and, by the objects of the build, a function or table of another file, however it is declared.
set -euo pipefail
source=$1 build=$2
excepted=() # "a b": arrows that do not count, each with its reason beside it; none

includes() { # in folder $1: "a b" for each file a that includes b; names in includes begin there
  cd "$1"
  grep -rE --include='*.c' --include='*.cpp' --include='*.h' '^ *# *include "' . |
    sed -E 's|^\./||; s|\.[a-z]+: *# *include "([^"]*)\.h".*| \1|' | awk '$1 != $2'
}
objects() { # those whose source is still there, below the build; generated sources are left out
  cd "$build"
  find src tools -name '*.o' | while read -r object; do
    name=${object%.o}
    if [ -f "$source/${name%%CMakeFiles/*}${name#*.dir/}" ]; then echo "$object"; fi
  done
}
calls() { # of the objects in $1, one a line: "a b" for each file a that names a symbol which only b defines
  (cd "$build" && xargs nm -A -g <"$1" 2>/dev/null) |
    sed -E 's#CMakeFiles/[^/]*\.dir/##; s#\.(c|cpp)\.o:[0-9a-f ]*# #' |
    awk '$2 == "U" { needs[$1 " " $3] }
         $2 ~ /^[TDBRC]$/ { if ($3 in owner && owner[$3] != $1) several[$3]; owner[$3] = $1 }
         END { for (need in needs) { split(need, part, " ")
                 if (part[2] in owner && owner[part[2]] != part[1] && !(part[2] in several)) print part[1], owner[part[2]] } }'
}
check() { # the arrows in file $1, of which there are $2 or more; $3: what they are of
  if [ "${#excepted[@]}" -gt 0 ]; then
    printf '%s\n' "${excepted[@]}" | grep -vxFf - "$1" >"$1.rest" && mv "$1.rest" "$1"
  fi
  if [ "$(wc -l <"$1")" -lt "$2" ]; then
    echo "FAIL: $3: hardly an arrow was found"
    exit 1
  fi
  if ! tsort "$1" >/dev/null; then # names the files of the circle
    echo "FAIL: $3: these files need each other"
    exit 1
  fi
}

list=$(mktemp -d)
trap 'rm -rf "$list"' EXIT
for folder in include src tools/ernerf-cli; do
  (includes "$source/$folder") >"$list/arrows"
  check "$list/arrows" 5 "includes of $folder"
done
(objects) >"$list/objects"
calls "$list/objects" >"$list/arrows"
check "$list/arrows" 300 "calls"
printf 'a b\nb c\nc a\n' >"$list/arrows" # a circle is seen
if (check "$list/arrows" 3 "a made-up circle") >/dev/null 2>&1; then
  echo "FAIL: tsort finds no circle"
  exit 1
fi
echo "ok: no circle"
