#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Segment NUMBER (from 0) of a video: frames NUMBER*EACH and on, EACH of them or what is left, to PARTS/NNNNNNN.mp4. A segment
# that is there stays. Usage: segment.sh MODEL CLIP PARTS FRAMES EACH NUMBER [options of ernerf render]
set -euo pipefail
export LC_ALL=C
model=$1 clip=$2 parts=$3 frames=$4 each=$5 number=$6
shift 6
begin=$((number * each)) end=$((number * each + each))
[ $begin -lt "$frames" ] || { echo "segment.sh: segment $number begins with frame $begin, there are $frames" >&2; exit 1; }
[ $end -le "$frames" ] || end=$frames
part=$parts/$(printf %07d $begin).mp4
mkdir -p "$parts"
[ ! -e "$part" ] || { echo "segment.sh: $part is there"; exit 0; }
exec "${ERNERF:-ernerf}" render "$model" --clip "$clip" --split all --frames $begin:$end -o "$part" "$@"
