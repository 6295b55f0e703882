#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# A training on 2 and 4 processes of which a random one is killed, 100 times (or KILLS), and that is resumed each time, on
# another number of them: the model is that of a training that nobody disturbed. Then one that is stopped for 30 s goes on.
# Usage: kills_long.sh ERNERF SOURCE FOLDER
ernerf=$1 source=$2 folder=$3 kills=${KILLS:-100}
. "$source/tests/mpi/common.sh"
ln -s "$source/data/tiny" clip
RANDOM=26
options="--iters 400 --rays 256 --levels 6 --save-every 5 --validate-every 0 --validate-frames 1 --quiet --set refine-poses=yes --set frames-per-step=2"
on 0 -o whole.safetensors $options --set step-parts=4
stamp() { stat -c %Y.%i killed.run/state.safetensors 2> /dev/null || true; }
step() { # of the newest whole state: a kill between two renames leaves it as state.next
  local state=killed.run/state.safetensors
  [ -e $state ] || state=killed.run/state.next.safetensors
  "$ernerf" info $state | sed -n 's/.*head \([0-9]*\), torso.*/\1/p'
}
has_saved() { [ "$(stamp)" != "$before" ] || ! kill -0 $training 2> /dev/null; }
killed=0 done=0 last=0 resume=
while [ $killed -lt $kills ]; do
  count=$((RANDOM % 2 * 2 + 2)) before=$(stamp)
  on $count -o "$folder/killed.safetensors" $options $resume > /dev/null &
  training=$!
  await 120 has_saved
  sleep 0.$((RANDOM % 10))$((RANDOM % 10))
  victim=$(process $((RANDOM % count)) killed) && kill -9 "$victim" 2> /dev/null || victim=
  if wait $training; then # it had come to its end
    same killed.safetensors whole.safetensors
    rm -r killed.*
    done=$((done + 1)) last=0 resume=
    continue
  fi
  [ -n "$victim" ] || fail "it ended by itself: $(cat log.txt)"
  now=$(step) || fail "after kill $killed no state is whole"
  [ "$now" -gt "$last" ] || fail "kill $killed: the state went from step $last to $now"
  last=$now resume=--resume killed=$((killed + 1))
done
[ -z "$resume" ] || on 2 -o "$folder/killed.safetensors" $options --resume
[ -z "$resume" ] || same killed.safetensors whole.safetensors
echo "$kills kills, $done trainings came to their end and one more was ended, nothing lost"

on 2 -o "$folder/stopped.safetensors" $options > /dev/null &
await 60 test -e stopped.run/state.safetensors
stopped=$(process 1 stopped)
kill -STOP "$stopped"
sleep 30
kill -CONT "$stopped"
wait $! || fail "a process that was stopped for 30 s ended the training: $(cat log.txt)"
on 0 -o "$folder/unstopped.safetensors" $options --set step-parts=4
same stopped.safetensors unstopped.safetensors
echo "30 s without an answer: it went on"
