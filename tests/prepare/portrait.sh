#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# tools/portrait from a made-up video to a portrait: what it makes, that it goes on where it was stopped, and what it refuses.
# Usage: portrait.sh ERNERF PORTRAIT FOLDER
set -euo pipefail
export ERNERF=$1
portrait=$2 folder=$3
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
fail() { echo "portrait.sh: $1" >&2; exit 1; }

"$ERNERF" synth truth --size 192 --frames 50 --seed 3 --video person.mp4 --quiet
timeout -s INT 8 bash "$portrait" person.mp4 --minutes 0.05 --size 192 > stopped.log 2>&1 && fail "it ended within 8 s"
bash "$portrait" person.mp4 --minutes 0.05 --size 192 > first.log 2>&1 || { tail -n 5 first.log; fail "it failed"; }
for file in clip/report.html clip/overlay.mp4 portrait.head.safetensors portrait.safetensors unseen.mp4 eval.json; do
  [ -s "person/$file" ] || fail "person/$file is not there"
done
grep -q '"psnr"' person/eval.json || fail "eval.json has no PSNR"
[ -z "$(find person -name '*.ernerf-tmp' -o -name 'tmp.*')" ] || fail "leftovers: $(find person -name '*.ernerf-tmp' -o -name 'tmp.*')"

# again: nothing is learnt twice, and nothing with other options
before=$(stat -c %Y.%i person/portrait.safetensors)
bash "$portrait" person.mp4 --minutes 0.05 --size 192 > second.log 2>&1 || fail "a second call failed"
[ "$before" = "$(stat -c %Y.%i person/portrait.safetensors)" ] || fail "a second call learnt again"

bash "$portrait" person.mp4 --minutes 0.04 --size 192 > other.log 2>&1 && fail "fewer --minutes were taken"
grep -q 'trained with --minutes 0.05, found 0.04' other.log || fail "not said: --minutes"

# more minutes: the head goes on, also after a stop, and the portrait of before is there until the new one is
steps() { "$ERNERF" info person/portrait.safetensors | sed -n 's/^ *steps *head \([0-9]*\), torso \([0-9]*\)$/\1 \2/p'; }
read -r head _ < <(steps)
echo mine > person/portrait.earlier.safetensors # of the user
bash "$portrait" person.mp4 --minutes 0.15 --size 192 > other.log 2>&1 && fail "a file of the user was taken"
[ "$(cat person/portrait.earlier.safetensors)" = mine ] && [ -s person/portrait.safetensors ] || fail "a file of the user is lost"
rm person/portrait.earlier.safetensors
timeout -s INT 4 bash "$portrait" person.mp4 --minutes 0.15 --size 192 > stopped.log 2>&1 && fail "it ended within 4 s"
[ -s person/portrait.safetensors ] || [ -s person/portrait.earlier.safetensors ] || fail "the portrait of before is lost"
bash "$portrait" person.mp4 --minutes 0.15 --threads 1 --size 192 > longer.log 2>&1 || { tail -n 5 longer.log; fail "more --minutes failed"; }
read -r more torso < <(steps)
[ "$more" -gt "$head" ] && [ "$torso" -gt 0 ] || fail "the head has $more steps, it had $head; the torso $torso"
[ ! -e person/portrait.earlier.safetensors ] || fail "the portrait of before is still there"
bash "$portrait" person.mp4 --minutes 0.15 --threads x --size 192 > other.log 2>&1 && fail "--threads x was taken"

bash "$portrait" person.mp4 -o bare --minutes 0.05 --size 192 --head-only > bare.log 2>&1 || fail "--head-only failed"
[ -s bare/portrait.safetensors ] && [ ! -e bare/portrait.head.safetensors ] || fail "--head-only made a torso"

# a file that an option names has other content: nothing is drawn of a model that heard something else
"$ERNERF" synth other --size 64 --frames 50 --seed 9 --quiet
"$ERNERF" features truth/aud.wav -o one.npy --quiet
"$ERNERF" features other/aud.wav -o two.npy --quiet
cp one.npy heard.npy
bash "$portrait" person.mp4 -o hears --minutes 0.02 --size 192 --head-only --features heard.npy > hears.log 2>&1 || fail "--features failed"
before=$(sha256sum < hears/unseen.mp4)
cp two.npy heard.npy
bash "$portrait" person.mp4 -o hears --minutes 0.02 --size 192 --head-only --features heard.npy > hears.log 2>&1 && fail "other features were taken"
grep -q 'hears/clip: has changed since' hears.log || fail "not said: has changed: $(tail -n 2 hears.log)"
[ "$before" = "$(sha256sum < hears/unseen.mp4)" ] || fail "the video was replaced"

mkdir others
echo mine > others/eval.json
bash "$portrait" person.mp4 -o others --minutes 0.05 > none.log 2>&1 && fail "a folder of others was taken"
[ "$(ls others) $(cat others/eval.json)" = "eval.json mine" ] || fail "a folder of others was changed"

echo text > text.mp4
bash "$portrait" text.mp4 -o none > none.log 2>&1 && fail "a text was taken for a video"
bash "$portrait" person.mp4 --minutes x > none.log 2>&1 && fail "--minutes x was taken"
bash "$portrait" > none.log 2>&1 && fail "a call without a video was taken"
echo "portrait.sh: all is there"
