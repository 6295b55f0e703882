#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Whose folder tools/portrait takes, and with which options it goes on: what it refuses before any work.
# With ERNERF_TEST_LONG also each option that changed, links, names and calls that were killed.
# Usage: portrait_refused.sh ERNERF PORTRAIT FOLDER
set -euo pipefail
export ERNERF=$1
portrait=$2 folder=$3
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
fail() { echo "portrait_refused.sh: $1" >&2; cat err.log >&2; exit 1; }

# refused WORDS... -- ARGUMENTS...: the call ends with exit status 1 and these words, and no file of FOLDER changes.
refused() {
  local words=() before
  while [ "$1" != -- ]; do words+=("$1"); shift; done
  shift
  before=$(find . -type f ! -name err.log -exec sha256sum {} + | sort)
  local status=0
  bash "$portrait" person.mp4 "$@" > err.log 2>&1 || status=$?
  [ "$status" = 1 ] || fail "portrait $*: exit status $status, expected 1"
  for word in "${words[@]}"; do grep -qF -e "$word" err.log || fail "portrait $*: not said: $word"; done
  [ "$before" = "$(find . -type f ! -name err.log -exec sha256sum {} + | sort)" ] || fail "portrait $*: files changed"
  ! grep -q '^==' err.log || fail "portrait $*: work was begun"
}

# of 0.4 s, which prepare refuses, so that no call takes long; a record of the clip stays
"$ERNERF" synth truth --size 128 --frames 10 --seed 3 --video person.mp4 --quiet

# a purpose that is not known, and the last one of several
status=0
bash "$portrait" person.mp4 -o none --for dub --for both > err.log 2>&1 || status=$?
[ "$status" = 2 ] && grep -qF -e '--for is both, expected portrait or dub' err.log && [ ! -e none ] || fail "--for both was taken"
bash "$portrait" person.mp4 -o last --size 128 --for dub --for portrait > err.log 2>&1 && fail "a video of 0.4 s was taken"
! grep -q -e '^--for' -e '^--head-only' last/portrait.txt || fail "the first of two purposes was noted"

# the user's own folder with the names that portrait has
"$ERNERF" prepare person.mp4 -o own/clip --size 128 > err.log 2>&1 && fail "a video of 0.4 s was taken"
[ -e own/clip/prepare.json ] || fail "no record of the refusal"
for name in eval.json unseen.mp4 portrait.safetensors; do echo mine > "own/$name"; done
refused own/ 'did not make it' portrait.txt 'empty folder' -- -o own
echo mine > own/portrait.txt
refused own/portrait.txt 'did not write it' 'empty folder' -- -o own
mkdir other
echo mine > other/thesis.txt
refused other/thesis.txt 'did not make it' -- -o other

# a folder of an earlier call: frames of other options are refused, a model that it has not begun too
bash "$portrait" person.mp4 -o made --size 128 --from 0 > err.log 2>&1 && fail "a video of 0.4 s was taken"
grep -q '0.40 s long' err.log || fail "not said: 0.40 s long"
[ -e made/clip/report.html ] || fail "no report of the refusal"
# a video of which no frame was taken may be cut otherwise
for part in '--from 1000' '--from 0'; do
  bash "$portrait" person.mp4 -o made --size 128 $part > err.log 2>&1 && fail "a video of 0.4 s was taken"
  grep -q '^== clip' err.log && grep -q ' s long' err.log || fail "a clip without frames was kept"
done
mkdir made/clip/ori_imgs
refused made 'made with --size 128' 'found --size 256' 'another folder' -- -o made --size 256 --from 0
refused made 'made with --from 0' 'found --from not given' -- -o made --size 128
refused made '--to not given' '--to 1' -- -o made --size 128 --from 0 --to 1
bash "$portrait" person.mp4 -o made --size 128 --from 0 --au 'a b.csv' --minutes 3 > err.log 2>&1 && fail "it ended well"
grep -q '^== clip' err.log || fail "other options were refused before a model was begun"
echo mine > made/portrait.safetensors
refused made/portrait.safetensors 'did not make it' -- -o made --size 128 --from 0 --au 'a b.csv' --minutes 3

# once a model is begun, all options are those of the first call
echo 0 > made/portrait.safetensors.clip
refused made 'trained with --minutes 3' 'found 2' -- -o made --size 128 --from 0 --au 'a b.csv' --minutes 2
[ -n "${ERNERF_TEST_LONG-}" ] || { echo "portrait_refused.sh: all is refused"; exit 0; }
refused made '--focal not given' '--focal 300' -- -o made --size 128 --from 0 --au 'a b.csv' --minutes 3 --focal 300
refused made '--au a\ b.csv' '--au c.csv' -- -o made --size 128 --from 0 --au c.csv --minutes 3
refused made '--head-only not given' '--head-only yes' -- -o made --size 128 --from 0 --au 'a b.csv' --minutes 3 --head-only
bash "$portrait" person.mp4 -o made --minutes 3 --from 0 --au 'a b.csv' --size 128 > err.log 2>&1 && fail "it ended well"
grep -q '^== clip' err.log || fail "the same options were refused"

# a name that begins with a dash is no option, and a video that is not there makes no folder
cp person.mp4 ./-person.mp4
status=0
bash "$portrait" ./-person.mp4 --minutes 1 > err.log 2>&1 || status=$?
[ "$status" = 1 ] || fail "a name with a dash: exit status $status"
grep -qF -e '-person.mp4: face: the part is' err.log || fail 'a name with a dash: the video was not looked at'
[ -s ./-person/portrait.txt ] || fail 'a name with a dash: no portrait.txt'
status=0
bash "$portrait" nothing.mp4 -o new/folder > err.log 2>&1 || status=$?
[ "$status" = 1 ] && grep -qF 'nothing.mp4' err.log || fail 'a video that is not there'
[ ! -e new ] || fail 'a video that is not there: a folder was made'

# a link in the place of a file that the last step writes
echo keep > kept.json
ln -s ../kept.json made/eval.json
refused made/eval.json 'is a symbolic link' -- -o made --minutes 3 --from 0 --au 'a b.csv' --size 128
rm made/eval.json
echo mine > made/unseen.mp4
refused made/unseen.mp4 'is not what tools/portrait wrote' -- -o made --minutes 3 --from 0 --au 'a b.csv' --size 128
rm made/unseen.mp4

# while another call works in the folder nothing is noted
flock made sleep 30 &
for tries in {1..50}; do flock --nonblock made true || break; sleep 0.1; done
refused made 'another call works in it' -- -o made --minutes 3 --from 0 --au 'a b.csv' --size 128
kill $!
mkdir pipe
mkfifo pipe/portrait.txt
refused pipe/portrait.txt 'no regular file' -- -o pipe

# a call that was killed before it had noted anything
mkdir killed
touch killed/portrait.txt killed/portrait.txt.new
bash "$portrait" person.mp4 -o killed --size 128 > err.log 2>&1 && fail "a video of 0.4 s was taken"
grep -q '^== clip' err.log || fail "an empty mark was refused"
bash "$portrait" person.mp4 -o far --minutes 0.001 > err.log 2>&1 && fail "--minutes 0.001 were taken"
[ ! -e far ] && grep -q 'expected a number of 0.002' err.log || fail "not said: 0.002"

# a name without an ending would be that of the folder
cp person.mp4 talk
bash "$portrait" talk > err.log 2>&1 && fail "the video was taken for a folder"
grep -q '"talk" is no name for a folder, expected -o FOLDER' err.log || fail "talk: $(cat err.log)"

# what is no video leaves no folder
mv person.mp4 whole.mp4
echo text > person.mp4
bash "$portrait" person.mp4 -o none > err.log 2>&1 && fail "a text was taken for a video"
[ ! -e none ] || fail "a folder was left: $(ls none)"
echo "portrait_refused.sh: all is refused"
