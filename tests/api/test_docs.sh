#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The documents beside the program: every `ernerf VERB --option` of README, docs and tools' usage names a verb and options that
# `ernerf VERB --help` lists, every link leads to a file, every document is under 250 lines and is named by docs/README.md.
# Usage: test_docs.sh SOURCE ERNERF
set -euo pipefail
cd "$1"
ernerf=$2 faults=0 commands=0
fault() { echo "FAIL: $1"; faults=$((faults + 1)); }

declare -A options=([help]=$'--man\n--bash\n--zsh')
for verb in $("$ernerf" --help | sed -nE 's/^  ([a-z]+) +[a-z].*/\1/p'); do
  options[$verb]=$("$ernerf" "$verb" --help | grep -oE -- '--?[A-Za-z][A-Za-z_-]*' | sort -u)
done
[ ${#options[@]} -ge 10 ] || { echo "FAIL: ${#options[@]} verbs, expected 10 at least"; exit 1; }

while IFS=: read -r file line text; do
  read -r verb rest <<<"$text"
  [ -n "${options[$verb]-}" ] || { fault "$file:$line: ernerf has no verb $verb"; continue; }
  commands=$((commands + 1))
  for option in $(grep -oE -- '(^| )--?[A-Za-z][A-Za-z_-]*' <<<"$rest" || true); do
    grep -qxF -e "$option" <<<"${options[$verb]}" || fault "$file:$line: ernerf $verb has no option $option"
  done
done < <(grep -noE '(^ {4}|`|bin/)ernerf [a-z]+ [^`#]*' README.md docs/*.md CONTRIBUTING.md | sed -E 's/(:[0-9]+:).*ernerf /\1/')
[ "$commands" -ge 40 ] || fault "$commands commands, expected 40 at least: the search for them is broken"

for file in README.md CONTRIBUTING.md docs/*.md; do
  for link in $(grep -oE '\]\([^)#]+' "$file" | cut -c3- | grep -v '^http' || true); do
    [ -e "$(dirname "$file")/$link" ] || fault "$file: leads to $link, which is not there"
  done
done
for file in docs/*.md; do
  [ "$(wc -l < "$file")" -le 250 ] || fault "$file: $(wc -l < "$file") lines, expected 250 at most"
  [ "$file" = docs/README.md ] || grep -qF "]($(basename "$file"))" docs/README.md || fault "docs/README.md does not name $file"
done
[ "$faults" = 0 ] || exit 1
echo "$commands commands, all links and all documents"
