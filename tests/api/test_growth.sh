#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Programs of old headers on the new library (docs/abi.md). Old headers are made of include/ by taking the last members of
# every struct that may grow; growth.c and the examples are built with both, linked to the same libraries, and do the same.
# Usage: test_growth.sh SOURCE BUILD, with CC and CFLAGS of the build in the environment
set -euo pipefail
source=$1 build=$2
work=$build/tests/work/test_growth
fail() { echo "FAIL: $*"; exit 1; }
read -ra flags <<<"${CFLAGS:-}"
[ -e "$build/lib/libernerf.so" ] || { echo "the libraries are static"; exit 77; }
rm -rf "$work" && mkdir -p "$work"

# Every public type says what it is: a struct that it is final or may grow, an object what threads may do with it.
kinds() { # of a header: "grows NAME", "final NAME", "object NAME" or "unknown NAME"
  awk '
    /^\/\*/ { comment = "" }
    { was = comment; line = $0; sub(/^ \* /, "", line); comment = comment " " line }
    /^typedef struct/ {
      name = $3; sub(/;/, "", name)
      if ($0 ~ /;$/) print (was ~ /thread/ ? "object" : "unknown"), name
      else print (was ~ /Plain data, may grow/ ? "grows" : was ~ /Plain data, final/ ? "final" : "unknown"), name
    }
    !/^typedef/ && /[;}]$/ { comment = "" }' "$1"
}
for header in "$source"/include/ernerf/*.h; do kinds "$header"; done >"$work/kinds"
grep '^unknown' "$work/kinds" && fail "types whose comments do not say what they are: threads, final or may grow"
grows=$(sed -n 's/^grows //p' "$work/kinds")
[ "$(wc -w <<<"$grows")" -ge 15 ] || fail "few structs that may grow"
while read -r kind name; do # each is used here
  [ "$kind" != grows ] || grep -q "\b$name\b" "$source/tests/api/growth.c" || fail "growth.c does not use $name"
done <"$work/kinds"

# Headers whose struct NAME lacks COUNT members at its end, for each line "NAME COUNT" of a list.
older() { # list from to
  mkdir -p "$3"
  for header in "$2"/*.h; do
    awk '
      FNR == NR { take[$1] = $2; next }
      /^typedef struct ern_[a-z_]* \{/ { name = $3; body = ""; inside = 1; next }
      inside && /^\} ern_/ {
        inside = 0
        gsub(/\/\*([^*]|\*[^\/])*\*\//, "", body)
        for (k = 0; k < take[name]; k++) { # the last declaration, or the last name of it
          sub(/[ \t\n]*;[ \t\n]*$/, "", body)
          if (match(body, /,[^,();]*$/)) body = substr(body, 1, RSTART - 1) ";"
          else { match(body, /;[^;]*$/); body = substr(body, 1, RSTART) }
        }
        print "typedef struct " name " {" body "\n} " name ";"
        next
      }
      inside { body = body "\n" $0; next }
      { print }' "$1" "$header" >"$3/$(basename "$header")"
  done
}
compile() { # headers source program flags...
  local headers=$1 from=$2 to=$3
  shift 3
  "${CC:-cc}" -std=c17 -O1 -Wall -Wextra "${flags[@]}" -D_POSIX_C_SOURCE=200809L -I "$headers" "$from" -o "$to" -L "$build/lib" "$@" \
    -Wl,-rpath,"$build/lib"
}
sizes() { # headers: "NAME BYTES" for each
  {
    printf '#include <ernerf/ernerf.h>\n#include <ernerf/live.h>\n#include <ernerf/media.h>\n#include <ernerf/prepare.h>\n#include <ernerf/stream.h>\n#include <stdio.h>\nint main(void) {\n'
    for name in $grows; do echo "printf(\"$name %zu\\n\", sizeof($name));"; done
    echo '}'
  } >"$work/sizes.c"
  compile "$1" "$work/sizes.c" "$work/sizes" && "$work/sizes"
}

# As many members as it takes to make each struct smaller; what lies in the library's own memory may keep its padding.
sizes "$source/include" >"$work/now"
for name in $grows; do echo "$name 1"; done >"$work/take"
for round in 1 2 3 4 5 6 7 8; do
  older "$work/take" "$source/include/ernerf" "$work/include/ernerf"
  sizes "$work/include" >"$work/before"
  join <(sort "$work/now") <(sort "$work/before") | join - <(sort "$work/take") |
    awk '{ same = $2 <= $3; print $1, $4 + same >list; if (same) print $1 }' list="$work/next" >"$work/same"
  [ -s "$work/same" ] || break
  mv "$work/next" "$work/take"
done
[ ! -s "$work/same" ] || fail "not smaller after $round rounds: $(cat "$work/same")"
awk '{ printf "%s%s -%d", (NR > 1 ? ", " : ""), $1, $2 } END { print "" }' "$work/take"

# train_minimal uses the last members of two structs.
grep -vE '^(ern_dataset_frame|ern_train_hooks) ' "$work/take" >"$work/take.examples"
older "$work/take.examples" "$source/include/ernerf" "$work/examples/ernerf"

prepare=()
[ ! -e "$build/lib/libernerf-prepare.so" ] || prepare=(-DERN_PREPARE -lernerf-prepare)

for age in now before; do
  headers=$source/include examples=$source/include
  [ $age = now ] || headers=$work/include examples=$work/examples
  folder=$work/$age.run
  mkdir -p "$folder/ball" "$folder/growth"
  compile "$headers" "$source/tests/api/growth.c" "$folder/growth_program" "${prepare[@]}" -lernerf-media -lernerf
  compile "$examples" "$source/examples/train_minimal.c" "$folder/train_minimal" -lernerf -lm
  compile "$examples" "$source/examples/render_minimal.c" "$folder/render_minimal" -lernerf -lm
  compile "$examples" "$source/examples/contact_sheet.c" "$folder/contact_sheet" -lernerf-media -lernerf
  (
    cd "$folder" &&
      ./growth_program "$source/data/tiny" growth >growth.txt &&
      ./train_minimal ball 10 | tail -1 >train.txt && # what it says now and then is not the same
      ./render_minimal ball/ball.safetensors ball/speech.npy ball/poses.json ball.rgba &&
      ./contact_sheet growth/video.mp4 sheet.png 1 1 32
  ) >"$folder/log" 2>&1 || fail "a program with the headers of $age: $(tail -3 "$folder/log")"
done
for file in growth.txt train.txt ball.rgba ball/ball.safetensors growth/model.safetensors sheet.png; do
  cmp "$work/now.run/$file" "$work/before.run/$file" || fail "$file is another with old headers"
done
echo "$(wc -w <<<"$grows") structs that may grow; programs of shorter ones do the same"
