#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# What reads untrusted files, built apart with the address and undefined-behaviour sanitizers: fuzz targets over their
# corpora, and unit tests. The quick part of what check_preset.sh does with everything.
# Usage: check_small.sh SOURCE WORK CC
set -euo pipefail
source=$1 work=$2 cc=$3
targets=(npy transforms csv landmarks safetensors torch_zip pareto onnx)
tests=(test_npy test_transforms test_csv test_landmarks test_safetensors test_torch_zip test_pickle test_onnx)

flags="-std=c17 -O0 -g1 -fsanitize=address,undefined -fno-sanitize-recover=undefined -D_POSIX_C_SOURCE=200809L
  -I. -I$source/include -I$source/src -I$source/tests -I$source/tests/fuzz -I$source/tools/ernerf-cli"
libraries="-ljansson -lzip -lcmocka -lpthread -lm"
rm -rf "$work" && mkdir -p "$work/objects" "$work/run" && cd "$work"
echo 'int main(void) { return 0; }' >probe.c
if ! $cc $flags probe.c -o probe 2>/dev/null || ! ./probe; then
  echo "skipped: $cc has no sanitizers here"
  exit 77
fi

list=("$source"/src/core/*.c "$source"/src/io/*.c "$source"/tools/ernerf-cli/{session/pareto_read,session/settings,bytes}.c)
for name in "${targets[@]}"; do list+=("$source/tests/fuzz/fuzz_$name.c"); done
for name in "${tests[@]}"; do list+=("$source/tests/files/$name.c"); done
list+=("$source/tests/fuzz/silent_session.c" "$source/tests/fuzz/replay.c" "$source/tests/programs.c")
printf 'TARGET(%s)\n' "${targets[@]}" >target_list.h
printf 'PROGRAM(%s)\n' "${tests[@]}" >program_list.h
printf '%s\n' "${list[@]}" | CC="$cc" FLAGS="$flags" xargs -P 2 -I{} sh -c 'name=$(basename "{}" .c)
  case $name in fuzz_*) more=-DLLVMFuzzerTestOneInput=$name ;; test_*) more=-Dmain=${name}_main ;; *) more= ;; esac
  $CC $FLAGS $more -c "{}" -o "objects/$name.o"'
ar rcs base.a $(for file in "${list[@]}"; do
  case $file in */tests/*) ;; *) echo "objects/$(basename "$file" .c).o" ;; esac
done)
$cc $flags objects/{fuzz_*,silent_session,replay}.o base.a $libraries -o replay
$cc $flags objects/{test_*,programs}.o base.a $libraries -o programs

failed=0
run() { # a program and its words
  (cd run && "$@") >log 2>&1 && return
  echo "FAIL: $*"
  tail -n 60 log
  failed=1
}
for name in "${targets[@]}"; do
  run "$work/replay" "$name" "$source/tests/fuzz/corpus/$name"
done
for name in "${tests[@]}"; do
  run "$work/programs" "$name"
done
[ $failed -eq 0 ] && echo "${#targets[@]} fuzz targets and ${#tests[@]} unit tests: clean"
exit $failed
