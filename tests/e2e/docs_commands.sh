#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Runs every command line `ernerf VERB ...` that README and docs show in a block, in their order, on a made-up video, with few
# steps and short times in the place of what the documents say. Samples of a file stand for the microphone, a reader of the stream
# for the browser. Commands that need a network, a device or a folder of tools/portrait are counted and left out: api/test_docs checks
# their options.
# Usage: docs_commands.sh SOURCE ERNERF FOLDER
set -euo pipefail
source=$1 ernerf=$2 folder=$3
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"

# The files that the documents name.
"$ernerf" synth truth --size 192 --frames 60 --seed 3 --video person.mp4 --quiet
mv person.mp4 VIDEO
cp VIDEO talk.mp4
cp truth/aud.wav speech.wav
cp truth/aud.wav new.wav
cp truth/aud.wav speech.mp3 # the form is told from the content
head -c 64044 truth/aud.wav | tail -c 64000 > microphone.s16
mkdir parts
printf 'say hello\neyes 0.3\n' > lines
echo 'Good evening, and welcome.' > speech.txt

# option NAME VALUE: gives the option this value in `line`, in the place of the one it has or at its end.
option() {
  case " $line " in
    *" $1 "*) line=$(sed -E "s/( $1) [^ ]+/\1 $2/" <<<"$line") ;;
    *) line="$line $1 $2" ;;
  esac
}

# read_http PORT: reads the stream as a browser does, as soon as there is one, until it ends.
read_http() {
  for _ in $(seq 200); do { exec 9<> "/dev/tcp/127.0.0.1/$1"; } 2> /dev/null && break; sleep 0.1; done
  printf 'GET / HTTP/1.1\r\nHost: localhost\r\n\r\n' >&9
  cat <&9 || true # the stream may end in the middle of a piece
}

# microphone: 4 s of samples at their own pace.
microphone() {
  for k in $(seq 0 99); do dd if=microphone.s16 bs=1280 skip=$((k % 50)) count=1 status=none || return 0; sleep 0.037; done
}

# live_line: runs `line`, of `ernerf live`, for two seconds, and checks that a stream came out of it.
live_line() {
  local port=$((20000 + $$ % 20000)) input=/dev/null reader=
  : > stream
  line=${line%% | ffplay*}
  case $line in *"--audio -"*) exec 8< <(microphone 2> /dev/null); input=/dev/fd/8 ;; *"--control -"*) input=lines ;; esac
  line="ernerf live ${line#*ernerf live }"
  line="${line/127.0.0.1:8080/127.0.0.1:$port} --duration 2 --overwrite --quiet"
  [[ $line == *--video* ]] || line+=" --size 64x64" # recorded frames keep their size
  if [[ $line == *http:* ]]; then read_http "$port" > stream & reader=$!; fi
  local words=($line)
  "$ernerf" "${words[@]:1}" < "$input" >> stream 2> out.log || return 1
  [ -z "$reader" ] || wait "$reader" || return 1
  [[ $line == *udp:* ]] || [[ $line == *live.mp4* ]] || [ -s stream ] || { echo "no stream came" > out.log; return 1; }
}

# shortened VERB: `line` with less to do.
shortened() {
  case $1 in
    prepare) option --size 192 ;;
    train)
      if [[ $line == *" --time "* ]]; then option --time 6s; else option --iters 30; fi
      option --rays 512 ;;
    render)
      line=${line/--frames 0:500/--frames 0:20} # the clip has 60 frames
      line=${line/--frames 500:1000/--frames 20:40} ;;
    synth) option --frames 40; option --size 64 ;;
    tradeoff)
      option --seconds 3
      if [[ $line == *--training* ]]; then option --rays 512; option --seeds 1; else option --frames 0:2; fi ;;
    ablate) option --iters 4; option --rays 256; option --repeats 3; option --frames 0:1 ;;
    soak) option --steps 12 ;;
    bench)
      option --seconds 1
      [[ $line == *"--only kernels"* ]] || option --rays 1024
      [[ $line == *"--only kernels"* || $line == *CLIP* ]] || option --size 64x64
      [[ $line != *--isa* ]] || option --isa ref ;; # on every machine
  esac
  line="$line --overwrite --quiet"
}

ran=0 left_out=0
while IFS= read -r line; do
  line=$(sed -E 's/ {4,}.*//; s/ #.*//; s/ +/ /g' <<<"$line")
  case $line in
    *.onnx* | *opencl* | *" VIDEO/"*) left_out=$((left_out + 1)); continue ;;
    *" MODEL "*) line=${line/ MODEL / portrait.safetensors } ;;
    *ngp.pth*) [ -e ngp.pth ] || "$ernerf" convert head.safetensors ngp.pth --quiet 2> convert.log ;;
  esac
  if [[ $line == *"ernerf live "* ]]; then
    live_line || { tail -n 5 out.log; echo "FAIL: $line"; exit 1; }
    echo "$line"
    ran=$((ran + 1))
    continue
  fi
  read -r _ verb _ <<<"$line"
  [ "$verb" = info ] || [ "$verb" = check ] || shortened "$verb"
  mapfile -t words < <(xargs -n 1 printf '%s\n' <<< "$line") # quoted words keep their blanks
  if ! "$ernerf" "${words[@]:1}" > out.log 2>&1; then
    tail -n 5 out.log
    echo "FAIL: $line"
    exit 1
  fi
  echo "$line"
  ran=$((ran + 1))
done < <(cd "$source" && sed -nE 's/^ {4,8}((arecord .*\| )?ernerf [a-z].*)/\1/p' README.md docs/*.md)
[ "$ran" -ge 20 ] || { echo "FAIL: $ran commands, expected 20 at least: the search for them is broken"; exit 1; }
echo "$ran commands ran, $left_out need a network or a device"
