#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# tools/paper-table: two made-up portraits and a torn one. The figures are those of `ernerf eval`, the mean is theirs, the torn one
# is named, and a file that is there stays. 77 (skipped) without jq.
# Usage: paper_table.sh SOURCE ERNERF FOLDER CLIPS (of shared_clips.sh)
set -euo pipefail
source=$1 ernerf=$2 folder=$3 clips=$4
command -v jq >/dev/null || { echo "skipped: no jq"; exit 77; }
export ERNERF=$ernerf
rm -rf "$folder"
mkdir -p "$folder/all/torn/clip" "$folder/all/a" "$folder/all/b"
cd "$folder"
fail() { echo "FAIL: $*"; exit 1; }
portrait() { # NAME CLIP: as links
  cp -rs "$clips/$2" "all/$1/clip"
  ln -s "$clips/$2_head.safetensors" "all/$1/portrait.head.safetensors"
}
portrait a short
portrait b long
echo torn > all/torn/portrait.safetensors
if "$source/tools/paper-table" all -o t.md > out.txt 2> err.txt; then fail "a torn portrait was no failure"; fi
grep -q 'failed: torn' err.txt || fail "the torn portrait is not named: $(cat err.txt)"
for name in a b; do
  psnr=$("$ernerf" eval "all/$name/portrait.head.safetensors" "all/$name/clip" --json --quiet | jq '.psnr * 100 | round / 100')
  grep -q "^| $name | $psnr | " t.md || fail "the table has not $psnr for $name: $(cat t.md)"
done
mean=$(jq '[.[].report.psnr] | add / 2 * 100 | round / 100' t.json)
grep -q "^| mean | $mean | .* | - | - | - | - | - | " t.md || fail "the mean is not $mean, or a metric is there that was not computed: $(cat t.md)"
cmp -s t.md out.txt || fail "the table on the screen is another"
[ "$(jq -r '.[].report.setting' t.json | sort -u)" = reconstruction ] || fail "t.json has another setting: $(jq '.[].report.setting' t.json)"
mkdir one && cp -r all/a one/a
if [ -n "${ERNERF_TEST_LONG-}" ]; then
  # the synchronization setting
  "$ernerf" synth other --size 64 --frames 33 --seed 9 --quiet
  "$source/tools/paper-table" one -o s.md --speech other/aud_ds.npy -- --lpips-heads=none --lpips-network none > /dev/null 2> err.txt &&
    fail "LPIPS without weights was taken"
  [ "$(jq -r '.[].setting' s.json)" = synchronization ] || fail "the true frames of other speech were asked for: $(cat err.txt s.json)"
  rm s.md s.json
  "$source/tools/paper-table" one -o s.md --speech other/aud_ds.npy > /dev/null
  [ "$(jq -c '[.[] | [.setting, .report.setting, .report.split, .report.count, .report.psnr == null]]' s.json)" = \
    '[["reconstruction","reconstruction","val",3,false],["synchronization","synchronization","all",33,true]]' ] || fail "s.json: $(jq 'map(.report)' s.json)"
  grep -q '^# Lip synchronization' s.md || fail "no second table: $(cat s.md)"
  if "$source/tools/paper-table" one -o v.md -- --setting synchronization > /dev/null 2>&1 || [ -e v.md ]; then fail "--setting was taken"; fi
fi
# a report of another program, with a FID of few frames
cat > stub <<'END'
#!/bin/sh
while [ "$1" != --json ]; do shift; done
echo '{"psnr": 1, "frames": [], "metrics": {"fid": {"distance": 5, "features": 2048, "frames": 7, "biased": true}}}' > "$2"
END
chmod +x stub
ERNERF=$PWD/stub "$source/tools/paper-table" one -o b.md > /dev/null 2>&1
grep -q '^FID is too high .* Frames: a (reconstruction) 7[.]$' b.md || fail "the table does not say that FID is biased: $(cat b.md)"
if grep -q 'too high' t.md; then fail "a FID that was not computed is called too high"; fi
# Ctrl-C ends the table, also where the program ends by itself, as after a save
printf '#!/bin/sh\nkill -INT "$PPID"\nexit 130\n' > ended && chmod +x ended
status=0
(trap - INT; ERNERF=$PWD/ended exec "$source/tools/paper-table" all -o i.md > /dev/null 2>&1) || status=$?
[ "$status" = 130 ] && [ ! -e i.md ] || fail "after Ctrl-C the status is $status"
echo mine > u.json
if "$source/tools/paper-table" all -o u.md > /dev/null 2> err.txt; then fail "u.json was replaced"; fi
[ "$(cat u.json)" = mine ] && [ ! -e u.md ] || fail "u.json is not as it was"
if "$source/tools/paper-table" all/torn -o v.md > /dev/null 2>&1 || [ -e v.md ]; then fail "a table of nothing was written"; fi
# a folder that is not there is said before the work, and a name with a dash is a name
echo '#!/bin/sh' > idle && echo 'touch begun' >> idle && chmod +x idle
if ERNERF=$PWD/idle "$source/tools/paper-table" one -o none/x.md > /dev/null 2> err.txt; then fail "a folder that is not there was taken"; fi
grep -q 'none: is no folder' err.txt && [ ! -e begun ] || fail "the work began before the folder was looked for: $(cat err.txt)"
ERNERF=$PWD/stub "$source/tools/paper-table" one -o -d.md > /dev/null 2>&1 || fail "a name with a dash was not written"
[ -e ./-d.md ] && [ -e ./-d.json ] || fail "no ./-d.md: $(ls)"
echo mine > w.md.new
ERNERF=$PWD/stub "$source/tools/paper-table" one -o w.md > /dev/null 2>&1
[ "$(cat w.md.new)" = mine ] && [ -e w.md ] || fail "a file beside the table is not as it was"
if "$source/tools/paper-table" all -o x.md -- --csv mine.csv > /dev/null 2>&1 || [ -e x.md ]; then fail "--csv was taken"; fi
echo "two rows, their mean, one named"
