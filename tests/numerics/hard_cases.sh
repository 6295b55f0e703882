#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Prints the hard cases of tests/numerics as Markdown tables, one for each file, from the comments of the test functions
# (docs/numerics.md). A comment is: case: INPUT | plain code: WHAT IT DOES | here: WHAT IS DONE | bound: ALLOWED ERROR.
set -euo pipefail
export LC_ALL=C
unset CDPATH
cd "$(dirname "$0")"
awk '
  FNR == 1 { head = ""; text = ""; printed = 0 }
  FNR > 1 && head !~ /[*][/]$/ { head = head " " $0; next }
  /^[/][*] case: / { text = ""; inside = 1 }
  inside { line = $0; sub(/^ [*] /, " ", line); text = text line; if (line ~ /[*][/]$/) inside = 0 }
  /^static void test_[a-z0-9_]*[(]void [*][*]/ {
    name = $3; sub(/[(].*/, "", name)
    if (!printed++) {
      about = head; gsub(/ +[*][/]? */, " ", about)
      printf "\n## %s\n\n%s\n\n| case | plain code | here | bound | test |\n| --- | --- | --- | --- | --- |\n", FILENAME, substr(about, 2)
    }
    sub(/ +[*][/]$/, "", text)
    text = substr(text, 10) # behind "/* case: "
    gsub(/ [|] (plain code|here|bound): /, " | ", text)
    printf "| %s | `%s` |\n", text, name
    text = ""
  }' test_*.c
