#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# What tools/portrait leaves where it or tools/dub is stopped, or a training is refused, and how it goes on. A script stands in for ernerf: it notes its calls.
# Usage: portrait_stopped.sh PORTRAIT FOLDER
set -euo pipefail
portrait=$1 folder=$2
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
fail() { echo "portrait_stopped.sh: $1" >&2; cat err.log calls.log >&2; exit 1; }
export ERNERF=$folder/ernerf TRAIN=0 MINE=
cat > ernerf << 'END'
#!/usr/bin/env bash
echo "$*" >> calls.log
case $1 in
  prepare) mkdir -p "$4/ori_imgs" && echo poses > "$4/transforms_train.json" ;;
  eval) echo seen > "$5" && echo figures > "$7" ;;
  train)
    [ -z "${MINE-}" ] || echo mine > "$MINE"
    case $TRAIN in
      wait) trap 'echo ended >> calls.log; exit 143' TERM HUP; echo waits >> calls.log; for i in {1..300}; do sleep 0.1; done ;;
      0)
        echo "$*" > "$4"
        [ -z "${HEAD-}" ] || echo head > "${4%.safetensors}.head.safetensors" ;;
      *) exit "$TRAIN" ;;
    esac ;;
esac
END
chmod +x ernerf
echo video > person.mp4
echo sound > words.wav
made() { bash "$portrait" person.mp4 -o "$@" > err.log 2>&1; }

# refused before any work: other options may follow
TRAIN=2 made made && fail "a training that was refused was taken for done"
made made --minutes 5 || fail "other --minutes were refused after a training that made nothing"
[ -e made/portrait.safetensors.done ] || fail "it did not end"

# killed between two renames of a save
for name in head.run/state.next head.run/state.previous run/state.next; do
  rm -rf half
  TRAIN=1 made half && fail "a training that failed was taken for done"
  mkdir "half/portrait.${name%/*}"
  touch "half/portrait.$name.safetensors"
  made half || fail "$name: it did not go on"
  tail -n 2 calls.log | grep -q '^train.* --resume' || fail "$name: trained again"
done

# killed while it notes the hashes of what it wrote: it goes on, and takes more minutes
mkdir bin
cat > bin/sha256sum << END
#!/usr/bin/env bash
echo hash >> "$folder/hashes.log"
[ "\$(wc -l < "$folder/hashes.log")" != "\$KILL_AT" ] || kill -KILL "\$(cat "$folder/pid")"
exec "$(command -v sha256sum)" "\$@"
END
chmod +x bin/sha256sum
for ((at = 1, killed = 1; killed; at++)); do # at each call, until none is left
  rm -rf cut hashes.log
  mkdir cut
  PATH=$folder/bin:$PATH KILL_AT=$at HEAD=yes bash -c 'echo $$ > pid; exec bash "$@"' bash "$portrait" person.mp4 -o cut > err.log 2>&1 && killed=0
  while ! flock --nonblock cut true; do sleep 0.1; done # what it has started ends
  made cut || fail "killed at hash $at: it did not go on"
  made cut --minutes 20 || fail "killed at hash $at: more minutes were refused"
done
[ $at = 7 ] || fail "$((at - 2)) hashes, expected 5: of the clip, two models, a video and its figures"

# a user's own file in the place of one that an earlier call wrote
made made --minutes 5 || fail "it did not go on"
echo mine > made/eval.json
made made --minutes 5 && fail "a user's file was replaced"
[ "$(cat made/eval.json)" = mine ] && grep -q 'eval.json: is not what' err.log || fail "a user's file"
rm made/eval.json made/unseen.mp4
made made --minutes 5 || fail "it did not draw again what was removed"

# one that came while the training ran
MINE=late/eval.json TRAIN=0 made late && fail "a file that came during the training was replaced"
[ "$(cat late/eval.json)" = mine ] || fail "a file that came during the training"

# more minutes: killed after the end of the training, and refused
mkdir -p made/portrait.head.run
cp made/portrait.safetensors new
echo old > made/portrait.earlier.safetensors
: > made/portrait.safetensors.longer
cp -a made killed
made killed --minutes 5 || fail "it did not go on after it was killed at the end of a longer training"
cmp new killed/portrait.safetensors && [ ! -e killed/portrait.earlier.safetensors ] && [ ! -e killed/portrait.safetensors.longer ] || fail "the portrait of before a longer training stayed"
TRAIN=1 made made --minutes 6 && fail "a longer training that failed was taken for done"
cmp new made/portrait.earlier.safetensors || fail "the portrait of before a longer training is not the last one"
TRAIN=2 made made --minutes 7 && fail "a longer training that was refused was taken for done"
made made --minutes 7 || fail "it did not go on after a longer training was refused"
made made --minutes 8 --threads 257 && fail "--threads 257 was accepted"
grep -q 'threads is 257' err.log && [ ! -e made/portrait.safetensors.longer ] || fail "--threads 257 was found late"
for file in portrait portrait.head; do # the user's own in the place of a model
  rm -rf own
  cp -a made own
  echo mine > "own/$file.safetensors"
  made own --minutes 8 && fail "a user's $file.safetensors was trained over"
  [ "$(cat "own/$file.safetensors")" = mine ] && grep -q 'is not what tools/portrait wrote' err.log || fail "a user's $file.safetensors"
done
mkdir -p made/portrait.run
echo mine > made/portrait.run/notes.txt
made made --minutes 8 && fail "a user's file in portrait.run was taken"
[ "$(cat made/portrait.run/notes.txt)" = mine ] && [ -e made/portrait.safetensors.done ] || fail "a user's file in portrait.run"
rm made/portrait.run/notes.txt
exec 8> made/portrait.run/lock
flock 8 # as a training by hand holds it
made made --minutes 8 && fail "the run folder of a training that goes on was removed"
[ -e made/portrait.run/lock ] && [ -e made/portrait.safetensors.done ] && grep -q 'a training writes it' err.log || fail "a training by hand"
exec 8>&-
made made --minutes 8 || fail "more minutes after a longer training"
[ ! -e made/portrait.earlier.safetensors ] || fail "the portrait of before a second longer training stayed"

# cd looks at CDPATH
mkdir -p elsewhere/other/clip
CDPATH=$folder/elsewhere made other || fail "CDPATH"
cmp other/portrait.safetensors.clip made/portrait.safetensors.clip || fail "with CDPATH another clip was looked at"

# stopped alone: the program is stopped too, and the script ends after it; tools/dub passes the signal on
for script in portrait dub; do
  for signal in TERM HUP; do
    : > calls.log
    made=stop_${script}_$signal arguments=(-o "stop_${script}_$signal")
    [ $script = portrait ] || arguments=(words.wav -o new.mp4 --folder "$made")
    TRAIN=wait bash "${portrait%/*}/$script" person.mp4 "${arguments[@]}" > err.log 2>&1 &
    for tries in {1..100}; do ! grep -q waits calls.log || break; sleep 0.1; done
    status=0
    kill -s "$signal" $!
    wait $! || status=$?
    [ "$status" = "$((128 + $(kill -l "$signal")))" ] || fail "$script: $signal: exit status $status"
    grep -q ended calls.log || fail "$script: $signal: the training goes on"
    flock --nonblock "$made" true || fail "$script: $signal: the folder is held still"
  done
done
echo "portrait_stopped.sh: all goes on"
