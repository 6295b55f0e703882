#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# tools/dub from a made-up video to one with new words, and once more with the trained head.
# Usage: dub.sh ERNERF DUB FOLDER
set -euo pipefail
export ERNERF=$1
dub=$2 folder=$3
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
fail() { echo "dub.sh: $1" >&2; exit 1; }
"$ERNERF" synth truth --size 256 --frames 75 --seed 3 --video person.mp4 --quiet
"$ERNERF" synth other --size 64 --frames 50 --seed 4 --quiet
status=0
"$dub" person.mp4 none.wav -o new.mp4 2> err.log || status=$?
[ "$status" = 1 ] && grep -q 'none.wav: there is no such file' err.log || fail "none.wav was taken"
status=0
"$dub" person.mp4 other/aud.wav -o new.txt 2> err.log || status=$?
[ "$status" = 2 ] && grep -q 'new.txt, expected a video' err.log || fail "new.txt was taken for a video"
echo mine > mine.mp4
status=0
"$dub" person.mp4 other/aud.wav -o mine.mp4 2> err.log || status=$?
[ "$status" = 1 ] && [ "$(cat mine.mp4)" = mine ] || fail "mine.mp4 was replaced"
ln -s person.mp4 link.mp4
ln person.mp4 same.mp4
ln other/aud.wav words.mp4
for input in ./person.mp4 link.mp4 same.mp4 words.mp4; do
  status=0
  "$dub" person.mp4 other/aud.wav -o $input -y 2> err.log || status=$?
  [ "$status" = 1 ] && grep -q "$input: is an input (.*), expected another name" err.log || fail "$input was taken as the output"
done
rm link.mp4 same.mp4 words.mp4
[ ! -e person ] || fail "work was begun"
"$dub" person.mp4 other/aud.wav -o new.mp4 --minutes 0.1 --size 128
[ -s new.mp4 ] && [ -s new.mp4.provenance.json ] || fail "no video"
[ ! -e person/portrait.head.safetensors ] || fail "a torso was trained"
model=$(sha256sum < person/portrait.safetensors)
"$dub" person.mp4 truth/aud.wav -o own.mp4 --minutes 0.1 --size 128
[ "$model" = "$(sha256sum < person/portrait.safetensors)" ] || fail "the head was trained again"
! cmp -s new.mp4 own.mp4 || fail "the words are the same"
sed -i '/^--head-only \|^--for /d' person/portrait.txt # as of tools/portrait with a torso
"$dub" person.mp4 other/aud.wav -o cut.mp4 --rest cut
[ "$model" = "$(sha256sum < person/portrait.safetensors)" ] || fail "a finished portrait was trained again"
[ "$(stat -c %s cut.mp4)" -lt "$(stat -c %s new.mp4)" ] || fail "--rest cut is as long as the video"
status=0
"$dub" person.mp4 other/aud.wav -o cut.mp4 -y --size 128 2> err.log || status=$?
[ "$status" = 2 ] && grep -q 'is a finished portrait, expected no --size' err.log || fail "--size was ignored"
echo "dub.sh: passed"
