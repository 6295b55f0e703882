#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# `doxygen docs/Doxyfile` makes its pages without a warning, and refuses a header with a function or a member that has no
# comment. Usage: test_doxygen.sh SOURCE FOLDER
set -euo pipefail
source=$1 work=$2
for tool in doxygen python3; do command -v $tool >/dev/null || { echo "skipped: there is no $tool"; exit 77; }; done
rm -rf "$work"
mkdir -p "$work/include"
cd "$source"
pages() { (cat docs/Doxyfile; printf '%s\n' "$@") | doxygen - >"$work/log" 2>&1; }

pages OUTPUT_DIRECTORY="$work/doc" || { cat "$work/log"; echo "FAIL: doxygen"; exit 1; }
for name in ern_renderer_frame ern_video_options_default ern_features ERN_FINE_ALL; do
  grep -rqF ">$name<" "$work/doc/html" || { echo "FAIL: $name is on no page"; exit 1; }
done

cp -r include/ernerf "$work/include"
sed -i '/^} ern_features;/i \  int bare_member, bare_too;' "$work/include/ernerf/data.h"
sed -i '/^\/\* Reads a .npy file/i ERN_API int ern_bare(int a);\n' "$work/include/ernerf/data.h"
if pages OUTPUT_DIRECTORY="$work/bad" INPUT="$work/include/ernerf" STRIP_FROM_INC_PATH="$work/include"; then
  echo "FAIL: what has no comment was accepted"
  exit 1
fi
for name in bare_member bare_too ern_bare; do
  grep -qE "Member $name.*not documented" "$work/log" || { cat "$work/log"; echo "FAIL: $name is not named"; exit 1; }
done
[ "$(wc -l <"$work/log")" -eq 3 ] || { cat "$work/log"; echo "FAIL: expected three lines"; exit 1; }
echo "$(find "$work/doc/html" -name '*.html' | wc -l) pages"
