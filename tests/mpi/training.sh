#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Training on several processes: the same model for 1 and 2 of them; what cannot be shared. With ERNERF_TEST_LONG also 4
# processes, a torso, another number of them after a resume, bf16, by the clock, a process that dies.
# Usage: training.sh ERNERF SOURCE FOLDER
ernerf=$1 source=$2 folder=$3
. "$source/tests/mpi/common.sh"
ln -s "$source/data/tiny" clip

# a head with all that a step can have: frames, poses, the fine stage, refreshes, an average
head="--iters 10 --rays 1024 --levels 4 --set refine-poses=yes --set frames-per-step=2 --set fine-steps=2 --patch-size 16 --set step-parts=4 --set ema=yes --set ema-every=1 --validate-frames 1 --set refresh-every=4"
LD_DEBUG=files on 0 -o head0.safetensors $head
grep -q libmpi log.txt && fail "a training without mpirun loads MPI"
on 2 -o head2.safetensors $head
same head0.safetensors head2.safetensors

if [ -n "${ERNERF_TEST_LONG-}" ]; then
  on 4 -o head4.safetensors $head
  grep -q "rank 3 of 4: rays 768 to 1023 of the 1024 of a step" log.txt || fail "rank 3 does not say its share: $(cat log.txt)"
  same head0.safetensors head4.safetensors

  torso="--torso --head head0.safetensors --iters 3 --rays 256 --validate-frames 1"
  on 0 -o torso0.safetensors $torso --set step-parts=4
  for count in 2 4; do on $count -o torso$count.safetensors $torso; done
  same torso0.safetensors torso2.safetensors
  same torso0.safetensors torso4.safetensors

  # 4 processes, then 2: as if it had been one alone all the time, with the same --iters each time
  some="--rays 256 --levels 4 --set refine-poses=yes --validate-frames 1"
  on 4 -o some.safetensors --iters 2 $some
  on 2 -o some.safetensors --iters 4 --resume
  on 0 -o alone.safetensors --iters 2 $some --set step-parts=4
  on 0 -o alone.safetensors --iters 4 --resume
  same some.safetensors alone.safetensors

  # factors of bf16, where the processor has them
  bf16="--iters 3 --rays 256 --levels 4 --validate-frames 1 --precision bf16"
  if on 0 -o bf16_0.safetensors $bf16 --set step-parts=4 > /dev/null; then
    on 2 -o bf16_2.safetensors $bf16
    same bf16_0.safetensors bf16_2.safetensors
  else
    grep -q "bf16 needs" log.txt || fail "$(cat log.txt)"
  fi

  # by the clock of rank 0; stopped in the head, and gone on with on more processes
  timed="--rays 64 --levels 2 --validate-frames 1"
  rm log.txt
  on 2 -o "$folder/timed.safetensors" --time 60s $timed > /dev/null &
  await 60 grep -qs "% " log.txt
  kill "$(process 0 timed)"
  wait $! && fail "a training that was stopped was no error"
  grep -q " is saved" log.txt || fail "it does not say that it is stopped: $(cat log.txt)"
  on 4 -o "$folder/timed.safetensors" --time 2s $timed --resume
  grep -q "the torso for .*timed.head.safetensors" log.txt || fail "no torso after the head: $(cat log.txt)"
  [ -e timed.safetensors ] || fail "there is no portrait"
fi

if [ -n "${ERNERF_TEST_LONG-}" ]; then
  # a process that is killed: words, and what was saved is whole and goes on as if nothing had happened
  long="--iters 24 --rays 128 --levels 4 --save-every 2 --validate-every 0 --validate-frames 1 --quiet"
  on 0 -o whole.safetensors $long --set step-parts=4
  for victim in 1; do # of either rank: kills_long.sh
    name=$folder/killed$victim
    on 2 -o $name.safetensors $long > /dev/null &
    await 60 test -e "$name.run/state.previous.safetensors"
    kill -9 "$(process $victim killed$victim)"
    wait $! && fail "a killed process was no error"
    grep -q "rank $victim with PID\|signal 9" log.txt || fail "mpirun does not name the process: $(cat log.txt)"
    grep -q "told to end while it waited for another process (the sum of a step)" log.txt || fail "the other one says nothing: $(cat log.txt)"
    on 2 -o $name.safetensors $long --resume
    same killed$victim.safetensors whole.safetensors
  done
fi

refused() { # WORDS PROCESSES OPTION...
  local words=$1
  shift
  if on "$@" -o refused.safetensors --iters 2 > /dev/null; then fail "$* was taken"; fi
  grep -q -- "$words" log.txt || fail "no \"$words\" in: $(cat log.txt)"
  [ ! -e refused.safetensors ] || fail "a refused training wrote"
  rm -rf refused.run
}
refused "3 processes share the 4 parts" 3 --rays 256
refused "divides the 1 patches of a step of the fine stage" 0 --set step-parts=4 --rays 256 --patch-size 16 --set fine-steps=1

# rank 1 differs in what decides no number of parameters: another picture, also one whose file has the same size, or eye
# value, as of an earlier copy of the clip; another scale; no torso pictures
other() { # WORDS CLIP OPTION...: of rank 1
  local words="rank 1 has libernerf .*$1.*; rank 0 has libernerf"
  shift
  if "$mpirun" -n 1 "$ernerf" train clip -o refused.safetensors $few : -n 1 "$ernerf" train "$@" -o refused.safetensors $few > log.txt 2>&1; then
    fail "two processes train on different frames: $*"
  fi
  grep -q "$words" log.txt || fail "no \"$words\" in: $(cat log.txt)"
  [ ! -e refused.safetensors ] || fail "a refused training wrote"
  rm -rf refused.run
}
few="--iters 1 --rays 64 --levels 2 --threads 1 --validate-frames 1 --quiet"
cp -r "$source/data/tiny" picture
cp picture/gt_imgs/4.jpg picture/gt_imgs/3.jpg
other ", files of its frames" picture
cp -r "$source/data/tiny" bytes # a file of the same size
printf '\x55' | dd of=bytes/gt_imgs/3.jpg bs=1 seek=$(($(stat -c %s bytes/gt_imgs/3.jpg) - 20)) conv=notrunc status=none
other ", files of its frames" bytes
cp -r "$source/data/tiny" blink
sed -i '5s/0[.]00/0.75/g' blink/au.csv
other ", files of its frames" blink
other ", scale 3," clip --scale 3
other " of [0-9]* parameters, loss" clip --effects eye,codes,view

# nobody else loads MPI
LD_DEBUG=files PMI_RANK=0 PMI_SIZE=1 "$ernerf" train clip -o one.safetensors --iters 1 --rays 64 --levels 2 --validate-frames 1 --quiet 2>&1 | grep "libmpi" > /dev/null && fail "a training that a launcher starts as the only process loads MPI"
[ "$(LD_DEBUG=files "$mpirun" -n 2 "$ernerf" train gone -o somebody.safetensors 2>&1 | grep -c libernerf-mpi)" -gt 0 ] || fail "LD_DEBUG shows no libernerf-mpi under mpirun: the check above would not see it"
echo "the same models"
