#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Prepares made-up videos and holds each clip against its truth: a table, and status 1 where a bound is broken.
# Usage: made_up.sh ERNERF PREPARECHECK FOLDER [N]: the first N videos of the list, 10 by default. What FOLDER holds from an
# earlier run is not made again, but for the prepared clips. Ends with 77 where ERNERF has no verb prepare.
set -euo pipefail
ernerf=$1 preparecheck=$2 folder=$3 most=${4-10}

# seed, pixels a side, frames (25 a second), CRF, room, largest turn in degrees
videos=(
  '101  256 250 18 plain      8'
  '102  512 250 23 cluttered 15'
  '103  400 300 20 books     12'
  '104  360 250 28 plain     25'
  '105  450 200 25 cluttered 20'
  '106  288 300 22 cluttered 10'
  '107  512 225 18 plain     18'
  '108  320 275 26 books     25'
  '109  720 200 21 cluttered 12'
  '110 1080 200 23 plain     22'
)
(( most >= 1 && most <= ${#videos[@]} )) || { echo "made_up.sh: N is $most, expected 1 to ${#videos[@]}" >&2; exit 2; }
if ! "$ernerf" prepare --help > /dev/null 2>&1; then
  echo "skipped: $ernerf has no verb prepare"
  exit 77
fi
mkdir -p "$folder"

# A member of the flat object in $1.
value() { sed -nE "s/^ *\"$2\": ([^,]*),?\$/\1/p" "$1"; }
# Whether $1 $2 $3 (a number, <= or >= or <, a number); null, a measure that could not be taken, breaks every bound.
holds() { [ "$1" != null ] && [ -n "$1" ] && awk -v a="$1" -v b="$3" "BEGIN { exit !(a + 0 $2 b + 0) }"; }

broken=0
cell() { # a value, a comparison, a bound: the value in 9 columns, with a ! where the bound is broken
  local mark=' '
  holds "$1" "$2" "$3" || { mark='!'; broken=$((broken + 1)); }
  if [ "$1" = null ] || [ -z "$1" ]; then printf '%9s%s' none "$mark"; else printf '%9.3f%s' "$1" "$mark"; fi
}

line() { printf '%-5s %5s %4s %-9s %4s %9s %9s  %9s  %9s  %9s  %9s  %9s   %7s %7s %8s\n' "$@"; }
line seed size crf room turn rot rot95 'tremble' 'tremble t' mouth person head found false seconds
line '' '' '' '' '' '<= 0.5' '' '<= 2' '<= 2' '<= 0.1' '>= 0.96' '>= 0.93' '' '' ''
truths=0 founds=0 prepareds=0
for video in "${videos[@]:0:most}"; do
  read -r seed size frames crf room turn <<< "$video"
  place=$folder/$seed
  if [ ! -e "$place/truth/transforms_train.json" ] || [ ! -e "$place/video.mp4" ]; then
    rm -rf "$place"
    mkdir -p "$place"
    "$ernerf" synth "$place/truth" --size "$size" --frames "$frames" --seed "$seed" --room "$room" --turn "$turn" --parsing \
      --video "$place/video.mp4" --crf "$crf" --quiet
  fi
  rm -rf "$place/clip"
  printf '%-5s %5s %4s %-9s %4s ' "$seed" "$size" "$crf" "$room" "$turn"
  began=$SECONDS
  if ! "$ernerf" prepare "$place/video.mp4" -o "$place/clip" > "$place/prepare.log" 2>&1; then
    echo "no clip: $(tail -n 1 "$place/prepare.log")"
    broken=$((broken + 1))
    continue
  fi
  took=$((SECONDS - began))
  if ! "$preparecheck" "$place/truth" "$place/clip" --json "$place/measures.json" > "$place/measures.txt" 2>&1; then
    echo "no measures: $(tail -n 1 "$place/measures.txt")"
    broken=$((broken + 1))
    continue
  fi
  m=$place/measures.json
  cell "$(value "$m" rotation_median)" '<=' 0.5
  printf '%9.3f ' "$(value "$m" rotation_p95)"
  cell "$(value "$m" rotation_tremble)" '<=' 2
  printf ' '
  cell "$(value "$m" place_tremble)" '<=' 2
  printf ' '
  cell "$(value "$m" mouth)" '<=' 0.1
  printf ' '
  cell "$(value "$m" person_iou)" '>=' 0.96
  printf ' '
  cell "$(value "$m" head_iou)" '>=' 0.93
  truth=$(value "$m" truth_blinks) found=$(value "$m" matched_blinks) prepared=$(value "$m" prepared_blinks)
  printf '  %7s %7s %8s' "$found/$truth" "$((prepared - found))/$prepared" "$took"
  truths=$((truths + truth)) founds=$((founds + found)) prepareds=$((prepareds + prepared))
  for name in frames mouth_frames parsing_frames; do # a frame that a clip leaves out is not a frame without errors
    [ "$(value "$m" $name)" = "$frames" ] || { printf '  %s of %s %s!' "$(value "$m" $name)" "$frames" $name; broken=$((broken + 1)); }
  done
  echo
done

# Blinks are few in a video, so their bounds are those of all together.
if ! awk -v found=$founds -v truths=$truths -v all=$prepareds 'BEGIN {
  printf "blinks: %d of %d found (>= 90 %%), %d of %d false (< 5 %%)\n", found, truths, all - found, all
  exit !(found >= 0.9 * truths && (all - found < 0.05 * all || all == found)) }'; then
  broken=$((broken + 1))
fi
echo "$broken bounds broken"
[ "$broken" = 0 ]
