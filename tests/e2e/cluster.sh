#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# examples/cluster under GNU parallel: segments that are joined, and two people of whom one has no clip. Under Slurm:
# slurm.sh. With ERNERF_TEST_LONG also a third one, and people by the clock. Usage: cluster.sh ERNERF SOURCE FOLDER
set -euo pipefail
ernerf=$1 source=$2 folder=$3 scripts=$2/examples/cluster
command -v parallel > /dev/null && parallel --version 2> /dev/null | grep -q GNU || { echo "skipped: there is no GNU parallel"; exit 77; }
command -v jq > /dev/null || { echo "skipped: there is no jq"; exit 77; }
rm -rf "$folder"
mkdir -p "$folder/people"
cd "$folder"
export ERNERF=$ernerf
fail() { echo "FAIL: $*"; exit 1; }
clip=$folder/clip
"$ernerf" synth clip --size 64 --frames 16 --seed 3 --quiet
"$ernerf" train "$clip" -o head.safetensors --iters 3 --rays 64 --levels 2 --validate-frames 1 --threads 1 --quiet

# a segment that fails the first time is made the second time; those that are there stay
frames=16 each=6
mkdir parts
parallel -j 2 bash "$scripts/segment.sh" head.safetensors "$clip" parts $frames $each {} --quiet --threads 1 ::: 0 1 2 2> err.txt || fail "$(cat err.txt)"
before=$(stat -c %Y.%i parts/0000006.mp4)
rm parts/0000012.mp4 parts/0000012.mp4.provenance.json
parallel -j 2 bash "$scripts/segment.sh" head.safetensors "$clip" parts $frames $each {} --quiet --threads 1 ::: 0 1 2 > out.txt 2> err.txt || fail "$(cat err.txt)"
[ "$(stat -c %Y.%i parts/0000006.mp4)" = "$before" ] || fail "a segment that was there was made again"
bash "$scripts/segment.sh" head.safetensors "$clip" parts $frames $each 3 2> err.txt && fail "a segment past the end was taken"
grep -q "begins with frame 18, there are 16" err.txt || fail "$(cat err.txt)"
"$ernerf" join parts -o whole.mp4 --json join.json --quiet
[ "$(jq .videos join.json)" = 3 ] || fail "$(cat join.json)"

ln -s "$clip" people/anna
[ -z "${ERNERF_TEST_LONG-}" ] || ln -s "$clip" people/carl
mkdir people/broken # no clip
parallel -j 2 bash "$scripts/person.sh" {} out --iters 3 --rays 64 --levels 2 --validate-frames 1 --threads 1 ::: people/* 2> err.txt || fail "$(cat err.txt)"
"$scripts/table.sh" out > table.txt
cat table.txt
grep -qE "^anna +[0-9.]+ +0[.][0-9]+ +[0-9.]+$" table.txt || fail "anna is not in the table"
[ ! -e people/carl ] || grep -qE "^carl +[0-9.]+ " table.txt || fail "carl is not in the table"
grep -q "^broken .*failed in train:ernerf train: " table.txt || fail "the table does not name who failed"
grep -q "$(ls people | wc -l) people, 1 failed" table.txt || fail "the table does not count"

if [ -n "${ERNERF_TEST_LONG-}" ]; then
  # by the clock: stopped while it learns the head, the same command goes on
  bash "$scripts/person.sh" people/anna "$folder/late" --time 10m --rays 64 --levels 2 --validate-frames 1 --threads 1 2> /dev/null &
  script=$!
  for _ in $(seq 300); do [ ! -s late/anna/head.head.run/log.jsonl ] || break; sleep 0.1; done
  pkill -INT -P $script || fail "no training by the clock to stop"
  wait $script
  grep -q "^train" late/anna/failed.txt || fail "the training was not stopped"
  [ -e late/anna/head.head.run/state.safetensors ] || fail "the stop saved no head"
  bash "$scripts/person.sh" people/anna "$folder/late" --time 3s --rays 64 --levels 2 --validate-frames 1 --threads 1 2> err.txt
  [ ! -e late/anna/failed.txt ] || fail "a training by the clock does not go on: $(cat late/anna/failed.txt)"
  [ -s late/anna/eval.json ] || fail "no late/anna/eval.json: $(cat err.txt)"
fi
echo "segments and people"
