#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# What a reviewer should not have to look for; CONTRIBUTING.md gives the rules. Prints every place, fails if there is one.
# clang-format reads what the last 50 commits and the working tree changed; with ERNERF_TEST_LONG, or without git, everything.
# Usage: test_style.sh SOURCE
set -euo pipefail
export LC_ALL=C
cd "$1"

# All files of ours that are text; the pictures and data of docs/ and data/ and the inputs of fuzz targets are not.
mapfile -t texts < <(find include src tools tests examples python cmake docs .ci ./*.md ./*.txt ./*.json .clang-format .editorconfig \
  .gitignore LICENSE -type f ! -name '*.png' ! -name '*.pyc' ! -name '*.npy' ! -name '*.safetensors' ! -path 'tests/fuzz/corpus/*' | sort)
mapfile -t code < <(printf '%s\n' "${texts[@]}" | grep -E '\.(c|h|cpp|cl)$')
mapfile -t library < <(printf '%s\n' "${code[@]}" | grep -E '^src/')
[ "${#library[@]}" -gt 60 ] || { echo "FAIL: only ${#library[@]} files in src/"; exit 1; }

faults=0
fault() { # what; the places on standard input
  local places
  places=$(cat)
  [ -z "$places" ] && return
  printf '%s:\n%s\n' "$1" "$(sed 's/^/  /' <<<"$places")"
  faults=$((faults + $(wc -l <<<"$places")))
}

fault 'a tab' < <(grep -nH $'\t' "${texts[@]}" || true)
fault 'blanks at the end of a line' < <(grep -nHE ' +$' "${texts[@]}" || true)
fault 'a carriage return' < <(grep -nH $'\r' "${texts[@]}" || true)
fault 'no newline at the end of the file' < <(perl -0777 -ne 'print "$ARGV\n" unless /\n\z/' "${texts[@]}")
fault 'more than 600 lines' < <(wc -l "${code[@]}" | awk '$2 != "total" && $1 > 600 { print $2 ": " $1 }')
# Tables, code, headings, HTML and lines with an address have no place to break.
fault 'a line of more than 120 columns in a document' < <(
  perl -CSD -ne '$code = 0 if $. == 1; $code = !$code if /^ *```/; chomp;
    print "$ARGV:$.\n" if length > 120 && !$code && !m{^(?:\||#|<|    )|https?://};
    close ARGV if eof' ./*.md docs/*.md)
fault 'unfinished by its own words' < <(
  grep -nHE 'TODO|FIXME|XXX' "${texts[@]}" | grep -vE '^(tests/api/test_style\.sh|CONTRIBUTING\.md):' || true)
fault 'the library prints or ends the process' < <(
  grep -nHE '\b(abort|exit|_exit|quick_exit|printf|vprintf|puts|putchar|perror|assert) *\(|fprintf *\( *std(out|err)' \
    "${library[@]}" | grep -vE 'static_assert|_exit\(.*\); +/\* the forked child' || true)
# Some locales write 0,5. core/format.h has the C library's functions without a locale, and the program never takes one.
# What the program itself reads and writes is right as long as that is so.
fault 'a number that depends on the locale: core/format.h or io/number.h' < <(
  perl -0777 -ne 'while (/\b(v\w*printf|strto[fd]|strtold|ato[f]|stod|stof|std::(?:o|i)?f?stringstream)\s*\(|\b(?:s?n?printf|sscanf)\s*\([^;]*?%[-+ #0-9.*]*l?[aefgAEFG][^;]*;/g)
    { print "$ARGV:", 1 + (substr($_, 0, $-[0]) =~ tr/\n//), "\n" }' $(printf '%s\n' "${library[@]}" | grep -v '^src/core/format\.c$'))
fault 'a locale of the environment' < <(grep -nHE '\b(setlocale|std::locale)\b' "${library[@]}" $(printf '%s\n' "${code[@]}" | grep '^tools/') || true)
# Public headers may share a name with an inner one: they are always written ernerf/NAME. A backend has a file a noun, by
# the same name in each of its folders.
fault 'two files of one name' < <(printf '%s\n' "${code[@]}" | grep -vE '^(include|src/backend_cpu|src/backend_opencl|tests/kernelcheck)/' |
  sed 's|.*/||' | sort | uniq -d)
fault 'more than 40 files in a folder' < <(printf '%s\n' "${code[@]%/*}" | sort | uniq -c | awk '$1 > 40')
fault 'no licence line at the top' < <(awk 'FNR == 1 && !/SPDX-License-Identifier: MIT/ { print FILENAME }' "${code[@]}")
fault 'a path that a user does not have' < <(grep -nHE '(^|[ "'"'"'=:(])(/work/|/root/|/home/)' "${texts[@]}" |
  grep -v '^tests/api/test_style\.sh:' || true)

# What a test or a program leaves where it is run is easily committed with the rest.
known='CMakeLists.txt|CMakePresets.json|CONTRIBUTING.md|LICENSE|NEWS.md|README.md|[.].*|(cmake|data|debian|docs|examples|include|python|src|tests|tools)/.*'
fault 'a file that does not belong in the root' < <(git ls-files 2>/dev/null | grep -vE "^($known)$" || true)

fault 'a script that sorts, compares or writes numbers by the locale, without "export LC_ALL=C"' < <(
  git ls-files tools examples 2>/dev/null | while read -r file; do
    ! head -n 1 "$file" | grep -q '^#!.*sh' || grep -qx 'export LC_ALL=C' "$file" || echo "$file"
  done)
# With it cd may change to a folder of that name elsewhere, where a script would then write.
fault 'a script that calls cd, without "unset CDPATH"' < <(
  git ls-files tools examples 2>/dev/null | while read -r file; do
    ! head -n 1 "$file" | grep -q '^#!.*sh' || ! grep -q '\bcd ["$]' "$file" || grep -q '^unset CDPATH' "$file" || echo "$file"
  done)

# Three check more than an operation: whole heads, a fused pass, and what moves bytes.
fault 'a noun of operations without its kernelcheck, or the reverse' < <(
  diff <({ git ls-files 'src/*_ops.h' | sed 's|.*/||; s|_ops[.]h||' | grep -vx tile_culling
    printf '%s\n' head memory torso_pass; } | sort) \
    <(git ls-files tests/kernelcheck | sed -n 's|.*/\([a-z0-9_]*\)[.]c$|\1|p' | grep -vE '^(check|bf16)_|^(harness|kernelcheck)$' | sort) || true)

version() { grep -oE "$2" "$1" | grep -oE '[0-9]+(\.[0-9]+)*' | tail -n 1; }
header=include/ernerf/base.h
declared=$(version $header 'VERSION_MAJOR [0-9]+').$(version $header 'VERSION_MINOR [0-9]+').$(version $header 'VERSION_PATCH [0-9]+')
configured=$(version CMakeLists.txt 'VERSION [0-9.]+ LANGUAGES')
compiled=$(version src/core/context.c 'ern_version\(void\) \{ return "[0-9.]+"')
packed=$(version python/pyproject.toml '^version = "[0-9.]+"')
if [ "$declared" != "$configured" ] || [ "$declared" != "$compiled" ] || [ "$declared" != "$packed" ]; then
  fault 'versions differ' <<<"$header $declared, CMakeLists.txt $configured, src/core/context.c $compiled, python/pyproject.toml $packed"
fi

formatter=$(command -v clang-format-14 || command -v clang-format || true)
if [ -n "$formatter" ] && "$formatter" --version | grep -q 'version 14\.'; then
  recent=.
  if [ -z "${ERNERF_TEST_LONG-}" ] && git rev-parse HEAD >/dev/null 2>&1; then
    recent=$({ git log -n 50 --name-only --format=; git diff --name-only HEAD; git ls-files --others --exclude-standard; } | sort -u)
  fi
  mapfile -t formatted < <(printf '%s\n' "${code[@]}" | grep -E '\.(c|h|cpp)$' | if [ "$recent" = . ]; then cat; else grep -xFf <(echo "$recent"); fi)
  [ "${#formatted[@]}" -eq 0 ] || fault "not as $(basename "$formatter") would have it" < <(
    "$formatter" --dry-run "${formatted[@]}" 2>&1 | grep -oE '^[^ :]+:[0-9]+:[0-9]+: warning' | cut -d: -f1 | sort | uniq -c |
      awk '{ print $2 ": " $1 " places" }' || true)
else
  echo "clang-format 14 is not here: its part is skipped"
fi

[ "$faults" -eq 0 ] || { echo "FAIL: $faults faults of style"; exit 1; }
echo "${#texts[@]} files are in style"
