#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# One person of many: INPUT, a video (which is prepared first) or a prepared clip, becomes OUT/NAME/head.safetensors and
# OUT/NAME/eval.json. What fails is told in OUT/NAME/failed.txt, and the exit status is 0, so that the others go on; the same
# command again begins where it failed. Options are those of ernerf train. Usage: person.sh INPUT OUT [options]
set -uo pipefail
export LC_ALL=C
input=${1%/} out=$2
shift 2
name=${input##*/}
[ -d "$input" ] || name=${name%.*}
own=$out/$name clip=$out/$name/clip ernerf=${ERNERF:-ernerf}
mark=$own/person.txt
if [ -n "$(ls -A "$own" 2> /dev/null)" ] && [ "$(cat "$mark" 2> /dev/null)" != "$input" ]; then
  echo "person.sh: $own is not of $input, as its person.txt would say; expected another OUT, or inputs of different names" >&2
  exit 1
fi
mkdir -p "$own" && printf '%s\n' "$input" > "$mark" || exit 1
step() { # WHAT COMMAND...
  local what=$1
  shift
  "$@" > "$own/$what.log" 2>&1 && return 0
  { echo "$what"; tail -n 1 "$own/$what.log"; } > "$own/failed.txt"
  echo "person.sh: $name: $what failed: $(tail -n 1 "$own/$what.log")" >&2
  exit 0
}
rm -f "$own/failed.txt"
if [ -d "$input" ]; then clip=$input; else step prepare "$ernerf" prepare "$input" -o "$clip"; fi
resume=()
for state in "$own"/head{.head,}.run/state{,.next,.previous}.safetensors; do # with --time the head's training is head.head.run
  [ ! -e "$state" ] || resume=(--resume)
done
step train "$ernerf" train "$clip" -o "$own/head.safetensors" "${resume[@]}" "$@"
step eval "$ernerf" eval "$own/head.safetensors" "$clip" --json "$own/eval.json" --overwrite
