#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The installed tree, as another program meets it: moved to another place after the install, the examples built against it
# with a plain C compiler and with CMake's find_package, and run. With ERNERF_TEST_LONG also all frames by each program, a project with
# ernerf::prepare, a component that there is not, the archive of cpack, and live sessions.
# Usage: test_install.sh SOURCE BUILD NAME, with CC, CFLAGS, CMAKE, LIBDIR of the build in the environment
set -euo pipefail
source=$1 build=$2
work=$build/tests/work/$3
root=$work/moved
steps=45 frames=45 side=64
fail() { echo "FAIL: $*"; exit 1; }
stage() { echo "[$((SECONDS))s] $*"; }
read -ra flags <<<"${CFLAGS:-}"

stage install
rm -rf "$work" && mkdir -p "$work"
"${CMAKE:-cmake}" --install "$build" --prefix "$work/first" >"$work/install.log" || { cat "$work/install.log"; fail install; }
mv "$work/first" "$root"
lib=$root/$LIBDIR
for file in include/ernerf/ernerf.h include/ernerf/media.h bin/ernerf "$LIBDIR/pkgconfig/libernerf.pc" \
  "$LIBDIR/pkgconfig/libernerf-media.pc" "$LIBDIR/cmake/ernerf/ernerf-config.cmake"; do
  [ -f "$root/$file" ] || fail "$file was not installed"
done
for file in LICENSE README.md docs/README.md examples/CMakeLists.txt examples/render_minimal.c; do
  cmp -s "$source/${file}" "$root/share/doc/ernerf/$file" || fail "share/doc/ernerf/$file is not $file"
done
[ -f "$root/share/ernerf/tiny/transforms_train.json" ] || fail "share/ernerf/tiny is no clip"
if [ -d "$build/manual" ]; then # not where programs of the machine do not run
  for page in ernerf $("$build/bin/ernerf" --help | sed -nE 's/^  ([a-z]+) +[a-z].*/ernerf-\1/p'); do
    [ -s "$root/share/man/man1/$page.1" ] || fail "$page(1) is not installed"
  done
  [ -s "$root/share/bash-completion/completions/ernerf" ] && [ -s "$root/share/zsh/site-functions/_ernerf" ] || fail "no completion"
fi
[ -z "$(find "$root" -name '*lab*')" ] || fail "the laboratory was installed: $(find "$root" -name '*lab*')"
for header in "$source"/include/ernerf/*.h; do
  cmp -s "$header" "$root/include/ernerf/$(basename "$header")" || fail "$(basename "$header") was not installed as it is"
done
if [ -e "$lib/libernerf.so" ] && ldd "$lib/libernerf.so" | grep libOpenCL > /dev/null; then
  [ -x "$lib/ernerf/ernerf-probe-opencl" ] || fail "$LIBDIR/ernerf/ernerf-probe-opencl is not installed"
fi
if [ -e "$build/lib/libernerf-vision.so" ]; then # found and opened where it was moved to
  printf '%s' '{"kind":"made","rate":8000,"normalisation":"none","piece_samples":800,"context_samples":0,"row_samples":160,' \
    '"width":1,"window_rows":16}' >"$work/network.json"
  "$root/bin/ernerf" features "$source/data/tiny/aud.wav" --speech-model "$source/tests/fuzz/corpus/onnx/speech_8_khz" \
    --speech-preset "$work/network.json" -o "$work/made.npy" --quiet || fail "the installed program opens no network"
  mkdir "$work/away" && mv "$lib"/libernerf-vision.so.* "$work/away"
  if "$root/bin/ernerf" features "$source/data/tiny/aud.wav" --speech-model "$source/tests/fuzz/corpus/onnx/speech_8_khz" \
    --speech-preset "$work/network.json" -o "$work/none.npy" 2>"$work/network.log"; then
    fail "a network was opened without libernerf-vision"
  fi
  grep -q 'libernerf-vision.*ERNERF_VISION' "$work/network.log" || fail "not said what is missing: $(cat "$work/network.log")"
  mv "$work"/away/* "$lib"
fi
if ls "$lib"/libernerf-media-impl.so.* >/dev/null 2>&1; then # what needs no media works without it
  mkdir "$work/media" && mv "$lib"/libernerf-media-impl.so.* "$work/media"
  "$root/bin/ernerf" info "$source/data/tiny/transforms_val.json" >"$work/info.log" || fail "nothing works without libernerf-media-impl"
  if "$root/bin/ernerf" check "$source/data/tiny" >"$work/media.log" 2>&1; then fail "a clip was read without libernerf-media-impl"; fi
  grep -q 'libernerf-media-impl' "$work/media.log" || fail "not said what is missing: $(cat "$work/media.log")"
  mv "$work"/media/* "$lib"
fi
"$root/bin/ernerf" info devices >"$work/devices.log" 2>"$work/devices.errors" || fail "the installed program does not run"
grep -q "used untried" "$work/devices.errors" && fail "the installed library does not find ernerf-probe-opencl"

stage "pkg-config and a plain compiler"
export PKG_CONFIG_PATH=$lib/pkgconfig
for example in render_minimal train_minimal; do
  read -ra found <<<"$(pkg-config --cflags --libs libernerf)"
  "${CC:-cc}" -std=c17 -O1 -pedantic -Wall -Wextra -Werror "${flags[@]}" "$source/examples/$example.c" "${found[@]}" -lm \
    -Wl,-rpath,"$lib" -o "$work/$example"
done
read -ra found <<<"$(pkg-config --cflags --libs libernerf-media)"
for example in contact_sheet live_minimal; do
  "${CC:-cc}" -std=c17 -O1 -pedantic -Wall -Wextra -Werror "${flags[@]}" "$source/examples/$example.c" "${found[@]}" -pthread \
    -Wl,-rpath,"$lib" -o "$work/$example"
done
needs=$(ldd "$work/render_minimal" "$work/train_minimal" | grep -E 'avcodec|opencv_|OpenImageIO|ernerf-media' || true)
[ -z "$needs" ] || fail "a program that links libernerf alone needs $needs"

if [ -e "$build/lib/libernerf-prepare.so" ]; then # one library is linked, which brings the others
  stage "libernerf-prepare"
  mkdir "$work/prepare"
  cat >"$work/prepare/prepare.c" <<'end'
#include <ernerf/prepare.h>
#include <stdio.h>
int main(int count, char **words) {
  ern_context *context = NULL;
  ern_prepare_options options = ern_prepare_options_default();
  ern_prepare_result result;
  if (count != 3 || ern_context_create(&context, NULL) != ERN_OK) return 2;
  const ern_status status = ern_prepare(context, words[1], words[2], &options, &result);
  printf("%s: %s\n", ern_status_name(status), ern_last_error(context));
  ern_context_free(&context);
  return status == ERN_OK ? 0 : 1;
}
end
  cat >"$work/prepare/CMakeLists.txt" <<'end'
cmake_minimum_required(VERSION 3.16)
project(prepare C)
find_package(ernerf REQUIRED)
add_executable(prepare_cmake prepare.c)
target_link_libraries(prepare_cmake PRIVATE ernerf::prepare)
end
  programs=("$work/prepare_plain")
  if [ -n "${ERNERF_TEST_LONG-}" ]; then
    {
      "${CMAKE:-cmake}" -S "$work/prepare" -B "$work/prepare/build" -DCMAKE_PREFIX_PATH="$root" -DCMAKE_C_COMPILER="${CC:-cc}" \
        -DCMAKE_C_FLAGS="${CFLAGS:-}" && "${CMAKE:-cmake}" --build "$work/prepare/build"
    } >"$work/prepare.log" 2>&1 || { cat "$work/prepare.log"; fail "the project with ernerf::prepare"; }
    programs+=("$work/prepare/build/prepare_cmake")
  fi
  read -ra found <<<"$(pkg-config --cflags --libs libernerf-prepare)"
  "${CC:-cc}" -std=c17 -O1 -pedantic -Wall -Wextra -Werror "${flags[@]}" "$work/prepare/prepare.c" "${found[@]}" \
    -Wl,-rpath,"$lib" -o "$work/prepare_plain"
  for made in "${programs[@]}"; do
    if "$made" "$source/README.md" "$work/clip" >"$work/prepare.log"; then fail "$made made a clip of README.md"; fi
    grep 'README.md' "$work/prepare.log" >/dev/null || fail "$made says: $(cat "$work/prepare.log")"
    [ ! -e "$work/clip" ] || fail "$made leaves a folder"
  done
  # Without the library the program says what is missing, and does all else.
  if "$root/bin/ernerf" prepare "$source/README.md" -o "$work/clip" 2>"$work/prepare.log"; then fail "README.md was prepared"; fi
  grep 'README.md' "$work/prepare.log" >/dev/null || fail "the installed program says: $(cat "$work/prepare.log")"
  mkdir "$work/gone" && mv "$lib"/libernerf-prepare.so* "$work/gone"
  if "$root/bin/ernerf" prepare "$source/README.md" -o "$work/clip" 2>"$work/prepare.log"; then
    fail "a video was prepared without libernerf-prepare"
  fi
  grep 'libernerf-prepare.*ERNERF_PREPARE' "$work/prepare.log" >/dev/null || fail "not said what is missing: $(cat "$work/prepare.log")"
  [ ! -e "$work/clip" ] || fail "a folder is left"
  "$root/bin/ernerf" check "$source/data/tiny" >"$work/check.log" || fail "nothing works without libernerf-prepare"
  mv "$work"/gone/* "$lib"
fi

stage "find_package"
{
  "${CMAKE:-cmake}" -S "$source/examples" -B "$work/project" -DCMAKE_PREFIX_PATH="$root" -DCMAKE_C_COMPILER="${CC:-cc}" \
    -DCMAKE_C_FLAGS="${CFLAGS:-}" && "${CMAKE:-cmake}" --build "$work/project"
} >"$work/project.log" 2>&1 || { cat "$work/project.log"; fail "the project with find_package"; }

if [ -n "${ERNERF_TEST_LONG-}" ]; then
  mkdir "$work/component"
  printf 'cmake_minimum_required(VERSION 3.16)\nproject(c C)\nfind_package(ernerf REQUIRED COMPONENTS media none)\n' \
    >"$work/component/CMakeLists.txt"
  if "${CMAKE:-cmake}" -S "$work/component" -B "$work/component/build" -DCMAKE_PREFIX_PATH="$root" >"$work/component.log" 2>&1; then
    fail "a component that there is none of was found"
  fi
  grep 'no component none' "$work/component.log" >/dev/null || fail "not said which component is missing: $(cat "$work/component.log")"
fi

stage "train"
mkdir "$work/ball"
"$work/train_minimal" "$work/ball" $steps | tee "$work/train.log"
psnr=$(awk '/^.*ball.safetensors: PSNR/ { print $(NF - 1) }' "$work/train.log")
awk -v psnr="$psnr" 'BEGIN { exit !(psnr > 20) }' || fail "PSNR $psnr dB after $steps steps, expected more than 20"
"$root/bin/ernerf" info "$work/ball/ball.safetensors" >"$work/info.log" || fail "ernerf info does not read the model"

stage "render"
inputs=("$work/ball/ball.safetensors" "$work/ball/speech.npy" "$work/ball/poses.json")
"$work/render_minimal" "${inputs[@]}" "$work/ball.rgba"
[ "$(stat -c %s "$work/ball.rgba")" -eq $((frames * side * side * 4)) ] || fail "ball.rgba has another size"
if [ -n "${ERNERF_TEST_LONG-}" ]; then
  "$work/project/render_minimal" "${inputs[@]}" "$work/again.rgba"
  cmp "$work/ball.rgba" "$work/again.rgba" || fail "the program of find_package renders other frames"
  "$work/render_minimal" "${inputs[@]}" "$work/ball.ppm"
  [ "$(stat -c %s "$work/ball.ppm")" -eq $((frames * (side * side * 3 + 13))) ] || fail "ball.ppm has another size"
fi
# The first frame: there where the ball is, clear in the corner.
pixel() { od -An -tu1 -j $((($1 * side * side + $2 * side + $3) * 4)) -N 4 "$work/ball.rgba"; }
read -r red green _ alpha <<<"$(pixel 0 26 32)"
[ "$alpha" -gt 128 ] && [ "$red" -gt "$green" ] || fail "the ball's pixel is $red $green, alpha $alpha"
read -r _ _ _ alpha <<<"$(pixel 0 1 1)"
[ "$alpha" -lt 50 ] || fail "the corner's alpha is $alpha"
# From one pose, so that only the speech can move anything: the mouth is shut in frame 0 and open in frame 12.
{ head -n 2 "$work/ball/poses.json" | sed 's/,$//'; echo ']}'; } >"$work/still.json"
"$work/project/render_minimal" "${inputs[@]:0:2}" "$work/still.json" "$work/still.rgba"
frame() { tail -c +$(($1 * side * side * 4 + 1)) "$work/still.rgba" | head -c $((side * side * 4)); }
moved=$(cmp -l <(frame 0) <(frame 12) | wc -l || true)
[ "$moved" -ge 100 ] || fail "only $moved values differ between two moments of the speech"
echo "$moved values of $((side * side * 4)) differ between two moments of the speech"
if "$work/render_minimal" "$work/ball/speech.npy" "${inputs[@]:1}" "$work/none.rgba" 2>"$work/refused.log"; then
  fail "a model file that is none was accepted"
fi
grep -q 'speech.npy' "$work/refused.log" || fail "the refusal does not name the file: $(cat "$work/refused.log")"

stage "video and media"
"$root/bin/ernerf" render "${inputs[0]}" --audio "${inputs[1]}" --poses "${inputs[2]}" --frames 0:10 -o "$work/ball.mp4" \
  --quiet || fail "the installed program does not render"
for place in "$work" "$work/project"; do
  "$place/contact_sheet" "$work/ball.mp4" "$work/sheet.png" 5 2 32 | tee "$work/sheet.log"
  grep -q ': 160 x 64 pixels$' "$work/sheet.log" || fail "the contact sheet of 5 x 2 frames has another size"
  [ "$(head -c 8 "$work/sheet.png" | od -An -tx1 | tr -d ' ')" = 89504e470d0a1a0a ] || fail "sheet.png is no PNG"
  rm "$work/sheet.png"
done
if "$work/contact_sheet" "$work/none.mp4" "$work/sheet.png" 5 2 32 2>"$work/refused.log"; then
  fail "a video that is not there was accepted"
fi
grep -q 'none.mp4' "$work/refused.log" || fail "the refusal does not name the file: $(cat "$work/refused.log")"

if [ -n "${ERNERF_TEST_LONG-}" ]; then
  stage "cpack"
  "${CMAKE:-cmake}" -E chdir "$build" "${CPACK:-cpack}" -B "$work/cpack" >"$work/cpack.log" || { cat "$work/cpack.log"; fail cpack; }
  mkdir "$work/unpacked" && tar -xzf "$work"/cpack/ernerf-*.tar.gz -C "$work/unpacked" --strip-components=1
  while read -r object; do # found by $ORIGIN alone
    paths=$(readelf -d "$object" 2>/dev/null | sed -nE 's/.*(RUNPATH|RPATH).*\[(.*)\]/\2/p' | tr ':' '\n' | grep -v '^\$ORIGIN' || true)
    [ -z "$paths" ] || fail "$object looks for libraries in $paths"
  done < <(find "$work/unpacked/bin" "$work/unpacked/lib"* -type f -perm -u+x)
  "$work/unpacked/bin/ernerf" check "$work/unpacked/share/ernerf/tiny" >"$work/check.log" || fail "the archive's program does not run: $(cat "$work/check.log")"

  stage "live"
  tiny=$source/data/tiny
  "$root/bin/ernerf" train "$tiny" -o "$work/live.safetensors" --asr-model cepstra --iters 5 --rays 64 --levels 2 --quiet ||
    fail "the installed program does not train"
  live=("$work/live.safetensors" "$tiny/transforms_val.json" 10) # frames a second
  "$work/live_minimal" "${live[@]}" "$tiny/aud.wav" "$work/one.y4m" >"$work/live.log" || fail "live_minimal: $(cat "$work/live.log")"
  "$work/project/live_minimal" "${live[@]}" "$tiny/aud.wav" "$work/two.y4m" "$tiny/aud.wav" "$work/three.y4m" >>"$work/live.log"
  cmp "$work/one.y4m" "$work/two.y4m" && cmp "$work/one.y4m" "$work/three.y4m" || fail "two sessions at once draw other frames than one"
  cat "$work/live.log"
  status=0
  "$work/live_minimal" "${live[@]}" "$tiny/none.wav" "$work/none.y4m" "$tiny/aud.wav" "$work/four.y4m" 2>"$work/refused.log" || status=$?
  [ "$status" = 1 ] && grep -q 'none.wav' "$work/refused.log" || fail "a sound that is not there: $(cat "$work/refused.log")"
  [ ! -e "$work/none.y4m" ] && cmp "$work/one.y4m" "$work/four.y4m" || fail "a session that fails disturbs the other"
fi
stage done
