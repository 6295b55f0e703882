#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The table of what person.sh made of many, by name; a person that failed is named with the step and its last words.
# Usage: table.sh OUT
set -euo pipefail
export LC_ALL=C
failed=0 all=0
printf '%-24s %8s %8s %10s\n' name PSNR SSIM 'mouth dB'
for own in "$1"/*/; do
  name=$(basename "$own")
  all=$((all + 1))
  if [ -e "$own/failed.txt" ]; then
    failed=$((failed + 1))
    printf '%-24s failed in %s\n' "$name" "$(paste -sd: "$own/failed.txt")"
  elif [ -e "$own/eval.json" ]; then
    jq -r --arg name "$name" '[$name, .psnr, .ssim, (.psnr_mouth // "-")] | @tsv' "$own/eval.json" |
      awk -F '\t' '{ printf "%-24s %8.2f %8.4f %10s\n", $1, $2, $3, $4 == "-" ? "-" : sprintf("%.2f", $4) }'
  else
    failed=$((failed + 1))
    printf '%-24s not done\n' "$name"
  fi
done
echo "$all people, $failed failed or not done"
