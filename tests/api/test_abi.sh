#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The binary interface (docs/abi.md) of the built shared libraries: which symbols they export, under which version, and
# that the loader refuses a libernerf-media of another build.
# Usage: test_abi.sh SOURCE BUILD VERSION PROGRAM; skipped where the libraries are static
set -euo pipefail
source=$1 build=$2 version=$3 program=$4
work=$build/tests/work/test_abi
private=LIBERNERF_PRIVATE_$version
fail() { echo "FAIL: $*"; exit 1; }
[ -e "$build/lib/libernerf.so" ] || { echo "the libraries are static"; exit 77; }
rm -rf "$work" && mkdir -p "$work/other"

# The functions that a header marks with ERN_API.
declared() { cat "$@" | tr '\n' ' ' | grep -oE 'ERN_API [^;({]*\(' | grep -oE 'ern_[a-z0-9_]+\($' | tr -d '(' | sort; }
exported() { nm -D --defined-only "$1" | awk '{ print $3 }' | grep -vE '^(__(asan|odr|ubsan|tsan|lsan)|_(init|fini|edata|end)|__bss)' | sort; }
at() { sed -n "s/@@*$1\$//p" | sort; }
same() { diff "$1" "$2" >"$work/diff" || fail "$3 (< $1, > $2): $(cat "$work/diff")"; }

media=("$source/include/ernerf/media.h" "$source/include/ernerf/speech.h")
for header in "$source"/include/ernerf/*.h; do
  [[ " ${media[*]} " == *" $header "* ]] || echo "$header"
done | xargs cat >"$work/engine.h"
declared "$work/engine.h" >"$work/engine.declared"
declared "${media[@]}" >"$work/media.declared"
exported "$build/lib/libernerf.so" >"$work/engine.exported"
exported "$build/lib/libernerf-media.so" >"$work/media.exported"
[ "$(wc -l <"$work/engine.declared")" -ge 40 ] || fail "few functions in the headers"
at LIBERNERF_0 <"$work/engine.exported" >"$work/engine.public"
at LIBERNERF_MEDIA_0 <"$work/media.exported" >"$work/media.public"
same "$work/engine.declared" "$work/engine.public" "libernerf does not export what its headers declare"
same "$work/media.declared" "$work/media.public" "libernerf-media does not export what media.h and speech.h declare"
others=$(cat "$work"/*.exported | grep -vE "@@(LIBERNERF_0|LIBERNERF_MEDIA_0|$private)\$|^(LIBERNERF_0|LIBERNERF_MEDIA_0|$private)\$" || true)
[ -z "$others" ] || fail "symbols without a version: $others"

# Internals: no more than libernerf-media and the program's laboratory use, where each instruction set and OpenCL are built.
at "$private" <"$work/engine.exported" | grep -v '^ern_peak_' >"$work/private"
for file in "$build/lib/libernerf-media.so" "$program"; do nm -D --undefined-only "$file"; done | awk '{ print $2 }' |
  at "$private" | grep -v '^ern_peak_' | uniq >"$work/used"
same "$work/private" "$work/used" "exported internals that nobody uses"

# A libernerf-media of another build.
other=$(printf '%s' "$private" | sed 's/.$/x/')
sed "s/$private/$other/g" "$build/lib/libernerf-media.so" >"$work/other/libernerf-media.so.${version%%.*}"
chmod +x "$work/other/"*
"$program" --version >"$work/version" || fail "the program does not run"
if LD_LIBRARY_PATH=$work/other "$program" --version >"$work/version" 2>"$work/refused"; then
  fail "a libernerf-media that wants $other was loaded"
fi
grep -q "$other" "$work/refused" || fail "the refusal does not name $other: $(cat "$work/refused")"
echo "$(wc -l <"$work/engine.public") + $(wc -l <"$work/media.public") public functions, $(wc -l <"$work/private") internals"
