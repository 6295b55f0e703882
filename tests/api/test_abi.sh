#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The binary interface (docs/abi.md) of the built shared libraries: which symbols they export, under which version, what
# the program loads before it is asked for a video, and that the loader refuses libraries of another build.
# Usage: test_abi.sh SOURCE BUILD VERSION PROGRAM; skipped where the libraries are static
set -euo pipefail
source=$1 build=$2 version=$3 program=$4
work=$build/tests/work/test_abi
fail() { echo "FAIL: $*"; exit 1; }
interface=$(sed -n 's/^#define ERN_INTERFACE_VERSION "\(.*\)"$/\1/p' "$build/src/core/interface_version.h")
[[ $interface =~ ^${version//./\\.}_[0-9a-f]{12}$ ]] || fail "the version of the interfaces is $interface"
private=LIBERNERF_PRIVATE_$interface media_private=LIBERNERF_MEDIA_PRIVATE_$interface
[ -e "$build/lib/libernerf.so" ] || { echo "the libraries are static"; exit 77; }
rm -rf "$work" && mkdir -p "$work/other"

# The functions that a header marks with ERN_API.
declared() { cat "$@" | tr '\n' ' ' | grep -oE 'ERN_API [^;({]*\(' | grep -oE 'ern_[a-z0-9_]+\($' | tr -d '(' | sort; }
exported() { nm -D --defined-only "$1" | awk '{ print $3 }' | grep -vE '^(__(asan|odr|ubsan|tsan|lsan)|_(init|fini|edata|end)|__bss)' | sort; }
at() { sed -n "s/@@*$1\$//p" | sort; }
same() { diff "$1" "$2" >"$work/diff" || fail "$3 (< $1, > $2): $(cat "$work/diff")"; }

media=("$source/include/ernerf/"{media,speech,live,stream}.h)
prepare=$source/include/ernerf/prepare.h
impl=$build/lib/libernerf-media-impl.so
libraries=("$build/lib/libernerf-media.so")
[ ! -e "$build/lib/libernerf-prepare.so" ] || libraries+=("$build/lib/libernerf-prepare.so")
for header in "$source"/include/ernerf/*.h; do
  [[ " ${media[*]} $prepare " == *" $header "* ]] || echo "$header"
done | xargs cat >"$work/engine.h"
declared "$work/engine.h" >"$work/engine.declared"
declared "${media[@]}" >"$work/media.declared"
exported "$build/lib/libernerf.so" >"$work/engine.exported"
exported "$build/lib/libernerf-media.so" >"$work/media.exported"
[ "$(wc -l <"$work/engine.declared")" -ge 40 ] || fail "few functions in the headers"
at LIBERNERF_0 <"$work/engine.exported" >"$work/engine.public"
at LIBERNERF_MEDIA_0 <"$work/media.exported" >"$work/media.public"
same "$work/engine.declared" "$work/engine.public" "libernerf does not export what its headers declare"
same "$work/media.declared" "$work/media.public" "libernerf-media does not export what its headers declare"
nodes="LIBERNERF_0|LIBERNERF_MEDIA_0|LIBERNERF_PREPARE_0|$private|$media_private"
if [ "${#libraries[@]}" -eq 2 ]; then
  declared "$prepare" >"$work/prepare.declared"
  exported "${libraries[1]}" >"$work/prepare.exported"
  at LIBERNERF_PREPARE_0 <"$work/prepare.exported" >"$work/prepare.public"
  same "$work/prepare.declared" "$work/prepare.public" "libernerf-prepare does not export what prepare.h declares"
  at "$media_private" <"$work/media.exported" >"$work/media.private"
  nm -D --undefined-only "${libraries[1]}" | awk '{ print $2 }' | at "$media_private" >"$work/media.used"
  same "$work/media.private" "$work/media.used" "exported internals of libernerf-media that libernerf-prepare does not use"
fi
others=$(cat "$work"/*.exported | grep -vE "@@($nodes)\$|^($nodes)\$" || true)
[ -z "$others" ] || fail "symbols without a version: $others"

# debian/libernerf0.symbols lists the public ones.
for node in LIBERNERF_0 LIBERNERF_MEDIA_0 LIBERNERF_PREPARE_0; do
  sed -n "s/^ \\(ern_[a-z0-9_]*\\)@$node 0.*/\\1/p" "$source/debian/libernerf0.symbols"
done | sort >"$work/debian"
cat "$work"/*.declared | sort >"$work/all"
[ "${#libraries[@]}" -ne 2 ] || same "$work/debian" "$work/all" "debian/libernerf0.symbols is not what the headers declare"

# Internals: no more than libernerf-media, libernerf-prepare and the program's laboratory use, where each instruction set and OpenCL are built.
at "$private" <"$work/engine.exported" | grep -v '^ern_peak_' >"$work/private"
for file in "${libraries[@]}" "$impl" "$program"; do nm -D --undefined-only "$file"; done | awk '{ print $2 }' |
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

# A library without private functions of libernerf, of the same version, that was built from other headers.
rm "$work/other/libernerf-media.so.${version%%.*}"
if [ -e "$build/lib/libernerf-mpi.so" ]; then
  sed "s/$interface/${other#LIBERNERF_PRIVATE_}/g" "$build/lib/libernerf-mpi.so" >"$work/other/libernerf-mpi.so.${version%%.*}"
  if OMPI_COMM_WORLD_SIZE=2 LD_LIBRARY_PATH=$work/other "$program" train "$work" -o "$work/x.safetensors" 2>"$work/refused"; then
    fail "a libernerf-mpi of ${other#LIBERNERF_PRIVATE_} was loaded"
  fi
  grep -q "mpi.*is of version ${other#LIBERNERF_PRIVATE_}, expected $interface" "$work/refused" ||
    fail "the refusal does not name both versions: $(cat "$work/refused")"
fi

# libernerf-media-impl has one symbol, and nobody links it.
[ "$(exported "$impl")" = ern_media_functions ] || fail "libernerf-media-impl exports $(exported "$impl")"
needs=$(ldd "$program" "$build/lib/libernerf-media.so" | grep -E 'avcodec|OpenImageIO|opencv|media-impl' || true)
[ -z "$needs" ] || fail "the program needs $needs"
ldd "$impl" | grep OpenImageIO >/dev/null || fail "libernerf-media-impl needs no OpenImageIO: is it this library?"

# The program brings Ceres Solver and OpenCV's detectors along when it prepares a video, and not before.
needs=$(ldd "$program" "$build/lib/libernerf.so" "$impl" | grep -E 'ceres|cholmod|opencv_objdetect|ernerf-prepare' || true)
[ -z "$needs" ] || fail "the program needs $needs"
if [ "${#libraries[@]}" -eq 2 ]; then
  ldd "${libraries[1]}" | grep opencv_objdetect >/dev/null || fail "libernerf-prepare needs no detector: is it this library?"
  sed "s/$private/$other/g" "${libraries[1]}" >"$work/other/libernerf-prepare.so.${version%%.*}"
  if LD_LIBRARY_PATH=$work/other "$program" prepare "$source/README.md" -o "$work/clip" 2>"$work/refused"; then
    fail "a libernerf-prepare that wants $other was loaded"
  fi
  grep -q "libernerf-prepare.*$other" "$work/refused" || fail "the refusal does not name $other: $(cat "$work/refused")"
fi
echo "$(wc -l <"$work/engine.public") + $(wc -l <"$work/media.public") public functions, $(wc -l <"$work/private") internals"
