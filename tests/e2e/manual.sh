#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The pages of the manual and the completion of bash and zsh say what the help says, word by word.
# Usage: manual.sh ERNERF FOLDER
set -euo pipefail
ernerf=$1 work=$2
rm -rf "$work" && mkdir -p "$work" && cd "$work"
fail() { echo "FAIL: $*"; exit 1; }
words() { tr -s ' \n' '\n' | sed '/^$/d'; }
plain() { # a page without its macros, headings and links
  sed -E -e '/^\.(TH|SH|TP|PP|nf|fi|BR)/d' -e 's/^\.SS //' -e 's/\\f[BIR]//g; s/\\-/-/g; s/\\&//g; s/\\e/\\/g' -e 's/^ernerf(-[a-z]+)? - //'
}
check_page() { # page, help
  diff <(plain <"$1" | words) <(words <"$2") >diff.txt || fail "$1 (<) and the help (>) differ: $(cat diff.txt)"
  if command -v mandoc >/dev/null; then
    faults=$(mandoc -T lint -W warning "$1" | grep -v 'missing date' || true)
    [ -z "$faults" ] || fail "$faults"
  fi
}

"$ernerf" --help >help.txt
"$ernerf" help --man >ernerf.1
check_page ernerf.1 help.txt
"$ernerf" help --bash >ernerf.bash
"$ernerf" help --zsh >_ernerf
if command -v zsh >/dev/null; then zsh -n _ernerf; fi
verbs=$(sed -nE 's/^  ([a-z]+) +[a-z].*/\1/p' help.txt)
[ "$(wc -w <<<"$verbs")" -ge 15 ] || fail "few verbs: $verbs"

. ./ernerf.bash
complete_words() { # the words of the line, the last one to be completed
  COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMPREPLY=()
  _ernerf
  printf '%s\n' "${COMPREPLY[@]}"
}
for verb in $verbs; do
  "$ernerf" "$verb" --help >"$verb.txt"
  "$ernerf" help --man "$verb" >"ernerf-$verb.1"
  check_page "ernerf-$verb.1" "$verb.txt"
  grep "^\.BR ernerf\\\\-$verb (1)" ernerf.1 >/dev/null || fail "ernerf.1 does not name ernerf-$verb"
  # the options of the help: what a line begins with, up to two blanks
  { grep -E '^  -' "$verb.txt" | sed -E 's/^  //; s/   *.*//' | grep -oE -- '(^|, )--?[a-zA-Z_-]+' | tr -d ', '; echo --help; } | sort >options.txt
  complete_words ernerf "$verb" - | sort >completed.txt
  diff options.txt completed.txt >diff.txt || fail "options of $verb (<) and what bash completes (>): $(cat diff.txt)"
  sed -n "/^  $verb)/,/^    ;;/p" _ernerf | grep -oE -- "'--?[a-zA-Z_-]+\[" | tr -d "'[" | sort >zsh.txt
  diff options.txt zsh.txt >diff.txt || fail "options of $verb (<) and those of zsh (>): $(cat diff.txt)"
done
[ "$(complete_words ernerf ren)" = render ] || fail "ren is not completed"
[ "$(complete_words ernerf render --fit c | tr '\n' ' ')" = 'contain cover ' ] || fail "the values of --fit are not completed"
[ -z "$(complete_words ernerf render --clip da)" ] || fail "files are not left to bash"
"$ernerf" help --man rendr 2>err.txt && fail "there is a page of rendr"
grep 'nearest is render' err.txt >/dev/null || fail "$(cat err.txt)"
