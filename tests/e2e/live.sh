#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# ernerf live: what comes out is whole and the same each time; readers that leave, stall or come again; sound that is none; signals;
# lines of control. With ERNERF_TEST_LONG also by the clock, stalled readers, a microphone. Usage: live.sh ERNERF FOLDER CLIPS (of shared_clips.sh)
set -euo pipefail
ernerf=$1 folder=$2 clips=$3
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
trap 'kill $(jobs -p) 2> /dev/null || true' EXIT
fail() { echo "FAIL: $*"; exit 1; }
side=32 frame_bytes=$((side * side * 4)) # of the pictures; the clip has 64
cp -rs "$clips/short" clip # 33 frames
"$ernerf" train clip -o head.safetensors --iters 8 --rays 256 --levels 2 --validate-frames 1 --asr-model cepstra --quiet
live() { timeout 300 "$ernerf" live head.safetensors --clip clip --quiet --size ${side}x$side "$@"; }
refused() { # status words...: the last command's output is in err.txt
  local want=$1 got=$2
  shift 2
  [ "$got" = "$want" ] || fail "exit status $got, expected $want: $(cat err.txt)"
  for word in "$@"; do grep -q -- "$word" err.txt || fail "no \"$word\" in: $(cat err.txt)"; done
}

# a file: a frame for each 1/25 s that has begun, the same bytes each time and from a pipe
live --audio clip/aud.wav -o - --format raw --as-fast > a.rgba
[ "$(stat -c %s a.rgba)" = $((33 * frame_bytes)) ] || fail "a.rgba has $(stat -c %s a.rgba) bytes, expected 33 frames"
live --audio - -o - --format raw --as-fast < clip/aud.wav > b.rgba
cmp a.rgba b.rgba || fail "sound from a pipe gives other frames than from its file"
live --audio clip/aud.wav -o a.mp4 --as-fast
cp a.mp4.provenance.json a.json
live --audio clip/aud.wav -o a.mp4 --as-fast -y
cmp a.json a.mp4.provenance.json || fail "the same work gives another .provenance.json"
cmp -s -n $frame_bytes a.rgba <(tail -c $frame_bytes a.rgba) && fail "the last frame is the first"

if [ -n "${ERNERF_TEST_LONG-}" ]; then
  # by the clock: a file with pictures and sound, without silence before it; one shorter than the look-ahead
  live --audio clip/aud.wav -o live.mp4 --json live.json
  [ -s live.mp4 ] || fail "no live.mp4"
  grep -q '"frames": 33,' live.json || fail "live.json: $(head -12 live.json)"
  head -c $((44 + 5 * 1280)) clip/aud.wav | tail -c $((5 * 1280)) > short.s16 # 5 frames of 40 ms
  live --audio short.s16 --audio-format s16le -o short.mp4 --json short.json
  grep -q '"frames": 5,' short.json || fail "short.json: $(head -12 short.json)"
  # a server that accepts and reads nothing: it is not waited for without end, neither at the end nor for its answer
  command -v python3 > /dev/null && {
    python3 -c 'import socket, time
s = socket.create_server(("127.0.0.1", 0)); open("port", "w").write(str(s.getsockname()[1])); time.sleep(300)' &
    until [ -s port ]; do sleep 0.1; done
    status=0; live --audio clip/aud.wav --size 256x256 -o "tcp://127.0.0.1:$(cat port)" 2> err.txt || status=$?
    refused 1 $status "did not take the last"
    status=0; head -c $((10 * 32000)) /dev/zero | live --audio - --audio-format s16le --size 256x256 --as-fast -o "tcp://127.0.0.1:$(cat port)" 2> err.txt || status=$?
    refused 1 $status "did not take the last"
    status=0; live --audio clip/aud.wav -o "rtmp://127.0.0.1:$(cat port)/a/b" 2> err.txt || status=$?
    refused 1 $status "has not answered for 30 s"
  }
fi
# there already: refused; what is no sound: nothing is left
live --audio clip/aud.wav -o a.mp4 2> err.txt && fail "a.mp4 was replaced"
refused 1 1 "is there already"
cp a.mp4 kept.mp4
status=0; live --audio clip/aud.wav -o "file://$PWD/a.mp4" 2> err.txt || status=$?
refused 1 $status "is there already"
cmp a.mp4 kept.mp4 || fail "file:// replaced a.mp4"
head -c 9000 /dev/urandom > noise.bin
status=0; live --audio noise.bin -o noise.mp4 --as-fast 2> err.txt || status=$?
refused 1 $status "noise.bin"
! grep -q "0 frames" err.txt || fail "the lack of frames is said after its reason"
[ ! -e noise.mp4 ] || fail "noise.mp4 was left"
status=0; live --audio gone.wav -o gone.mp4 2> err.txt || status=$?
refused 1 $status "gone.wav"
# stopped before there is a frame
sleep 60 | "$ernerf" live head.safetensors --clip clip --audio - --audio-format s16le --as-fast -o early.mp4 2> err.txt &
program=$!
for ((i = 0; i < 300; i++)); do grep -q agreed err.txt && break; sleep 0.1; done
sleep 1
kill -TERM $program
status=0; wait $program || status=$?
refused 143 $status "before the first frame"
[ ! -e early.mp4 ] || fail "early.mp4 was left"
# a pipe that ends without a sample, after which the person only rests, and one that is silent up to the end
status=0; live --audio - --audio-format s16le -o - --format raw < /dev/null > rest.rgba 2> err.txt || status=$?
refused 1 $status "ended without a sample of sound"
status=0; live --audio - --audio-format s16le -o rest.mkv --duration 0.1 2> err.txt < <(sleep 60) || status=$?
refused 0 $status "no sound came"

if [ -n "${ERNERF_TEST_LONG-}" ]; then
  # readers: one who leaves, one who stalls, a full disk
  status=0; { live --audio clip/aud.wav -o - --format nut --duration 20 --stay 2> err.txt || echo $? > status; } | head -c 100 > /dev/null
  refused 1 "$(cat status)" "cannot write"
fi

# a reader who stalls: where frames are left out it is told while they are, and a signal ends the program though rendering waits for it
mkfifo stalled
timeout 200 sleep 200 <> stalled &
sleeper=$!
for policy in drop wait; do
  timeout --foreground 60 "$ernerf" live head.safetensors --clip clip --quiet --size ${side}x$side --control wait.sock --slow-reader $policy -o stalled --format raw 2> err.txt &
  program=$!
  for _ in $(seq 600); do [ -S wait.sock ] && break; sleep 0.1; done
  sleep 1.5
  [ $policy = wait ] || for _ in $(seq 300); do grep -q "too slowly or not at all" err.txt && break; sleep 0.1; done
  began=$(date +%s)
  kill -TERM $program
  status=0; wait $program || status=$?
  [ $(($(date +%s) - began)) -le 4 ] || fail "--slow-reader $policy: a stalled reader holds the end up"
  refused 143 $status "stopped"
  grep -q "is cut" err.txt || fail "the stream is said to be whole: $(cat err.txt)"
  [ $policy = wait ] || [ "$(grep -c "too slowly or not at all" err.txt)" = 1 ] || fail "frames that are left out: $(cat err.txt)"
  [ ! -e wait.sock ] || fail "wait.sock was left"
done
kill $sleeper

# a signal while the reader has stopped, which drawing waits for, or the end of the stream: it is over after 2 s
mkfifo held
exec 7<> held
for way in wait drop; do
  "$ernerf" live head.safetensors --clip clip --size ${side}x$side --audio clip/aud.wav --as-fast -o held --format raw --slow-reader $way 2> err.txt &
  program=$!
  for _ in $(seq 600); do grep -q '^live: ' err.txt && break; sleep 0.1; done
  sleep 1
  kill -TERM $program
  for _ in $(seq 100); do kill -0 $program 2> /dev/null || break; sleep 0.1; done
  kill -KILL $program 2> /dev/null && fail "--slow-reader $way: a reader who has stopped holds the end up"
  status=0; wait $program || status=$?
  refused 143 $status "stopped; its reader .* is cut"
done
exec 7>&-

# a signal: a reader who reads gets whole frames and the end of the container; a FIFO without a reader does not hold the end up
mkfifo taken
for format in mp4 ${ERNERF_TEST_LONG:+raw}; do
  cat taken > taken.$format &
  reader=$!
  "$ernerf" live head.safetensors --clip clip --quiet --size ${side}x$side --duration 60 -o taken --format $format 2> err.txt &
  program=$!
  for _ in $(seq 600); do [ -s taken.$format ] && break; sleep 0.1; done
  kill -TERM $program
  status=0; wait $program || status=$?
  refused 143 $status "written is whole"
  wait $reader
  [ $format = mp4 ] || [ $(($(stat -c %s taken.raw) % frame_bytes)) = 0 ] || fail "raw: the last frame is cut"
done
at=0 size=$(stat -c %s taken.mp4) # boxes of 4 bytes of length, then 4 of kind
while [ $at -lt $size ]; do
  at=$((at + 16#$(od -An -tx1 -j $at -N 4 taken.mp4 | tr -d ' \n')))
done
[ $at = $size ] || fail "mp4: the last fragment is cut"
if [ -n "${ERNERF_TEST_LONG-}" ]; then
  "$ernerf" live head.safetensors --clip clip --quiet --size ${side}x$side --duration 60 -o taken --format raw 2> err.txt &
  program=$!
  for _ in $(seq 600); do grep -q agreed err.txt && break; sleep 0.1; done # the model is read; next are the measurement of its speed and the FIFO
  sleep 6
  kill -TERM $program
  status=0; wait $program || status=$?
  refused 143 $status "had a reader"
fi
status=0; live --audio clip/aud.wav -o /dev/full --format raw 2> err.txt || status=$?
refused 1 $status "No space left"
# a full disk keeps the recording up to there, says so, and says beside it what it is
status=0; (ulimit -f 32; side=64 && live --audio clip/aud.wav -o full.ts --crf 0 --as-fast 2> err.txt) || status=$?
refused 1 $status "full.ts" "it is cut"
[ "$(stat -c %s full.ts)" -gt 10000 ] || fail "full.ts has $(stat -c %s full.ts) bytes"
grep -q '"cut": true' full.ts.provenance.json || fail "full.ts.provenance.json: $(cat full.ts.provenance.json)"

# its own error is the last line, where its provenance file cannot be written either
{ for _ in $(seq 600); do ls -A | grep -q 'cut\.ts' && break; sleep 0.1; done; mkdir cut.ts.provenance.json; cat clip/aud.wav; } |
  { status=0; (ulimit -f 32; live --audio - -o cut.ts --crf 0 --as-fast --size 256x256 2> err.txt) || status=$?; echo $status > status; }
refused 1 "$(cat status)" "cut.ts.provenance.json"
tail -n 1 err.txt | grep -q "cut.ts: .*it is cut" || fail "the last line is not the recording's: $(cat err.txt)"
# a file loses no frame, though the program stands still for a while
"$ernerf" live head.safetensors --clip clip --quiet --duration 2 --json still.json -o still.nut 2> err.txt &
program=$!
for _ in $(seq 600); do ls -A | grep -q 'still\.nut' && break; sleep 0.1; done
sleep 0.5
kill -STOP $program
sleep 1.2
kill -CONT $program
status=0; wait $program || status=$?
refused 0 $status
grep -q '"left_out": 0' still.json && grep -q '"written": 50' still.json || fail "frames are lost: $(cat still.json)"

if [ -n "${ERNERF_TEST_LONG-}" ]; then
  # a microphone that began before the program: what waits longer than --max-delay is left out. `stop` leaves out what waits of --audio,
  # 2 s, and the rest is said
  head -c $((5 * 32000)) /dev/urandom > noise.s16
  raw=(--audio-format s16le --format raw --slow-reader wait)
  head -c $((2 * 32000)) noise.s16 | live --audio - "${raw[@]}" --max-delay 0.2 -o - > delay.rgba
  frames=$(($(stat -c %s delay.rgba) / frame_bytes))
  [ $frames -ge 10 ] && [ $frames -le 25 ] || fail "$frames frames of 0.2 s and the look-ahead, expected 13"
  { sleep 1.5; echo stop; } | live --audio noise.s16 "${raw[@]}" --control - -o - > stop.rgba 2> err.txt
  grep -q '^ok$' err.txt || fail "stop: $(cat err.txt)"
  frames=$(($(stat -c %s stop.rgba) / frame_bytes))
  [ $frames -ge 60 ] || fail "$frames frames after stop, expected 75 or more of 125"
fi

# http: a reader comes, leaves, and another comes; lines of control
port=$((20000 + $$ % 20000))
mkfifo lines
exec 8<> lines
live --control - -o "http://127.0.0.1:$port/" < lines 2> err.txt &
program=$!
for _ in 1 2; do
  for _ in $(seq 600); do { exec 9<> "/dev/tcp/127.0.0.1/$port"; } 2> /dev/null && break; sleep 0.1; done
  printf 'GET / HTTP/1.1\r\nHost: localhost\r\n\r\n' >&9
  head -c 5000 <&9 > http.bin
  exec 9<&-
  grep -qa "Content-Type: video/mp4" http.bin || fail "http: $(head -c 300 http.bin)"
  grep -qa moof http.bin || fail "http: no piece of an mp4"
done
printf 'play clip/aud.wav\n' >&8
for _ in $(seq 600); do grep -q '^started 1$' err.txt && break; sleep 0.1; done
printf 'statistics\n' >&8
for _ in $(seq 600); do grep -q '^ended 1$' err.txt && break; sleep 0.1; done
[ "$(grep -xE 'ok 1|started 1|ended 1' err.txt | tr '\n' ' ')" = "ok 1 started 1 ended 1 " ] || fail "events: $(cat err.txt)"
printf 'eyes 2\nhold on\nbackground white\nplay clip/aud.wav\nplay gone.wav\nplay clip/bc.jpg\nplay clip\nplay /dev/zero\nsay a\0b\nstop\nstatistics\nnonsense\nquit now\nquit\n' >&8
status=0; wait $program || status=$?
refused 0 $status "error: eyes" "error: play: gone.wav: No such file" "error: play: clip/bc.jpg" "error: play: clip: Is a directory" "error: play: /dev/zero: is a device" "error: the line has a byte of 0" "\"quit now\" is not known" "^ok 2$" '"readers":2' "\"nonsense\" is not known" \
  '"speaking":1,"queued":0' '"speaking":null,"queued":0'
[ "$(grep -c '^ok$' err.txt)" = 4 ] || fail "answers: $(cat err.txt)"
: > err.txt
{ echo "say hello"; for _ in $(seq 600); do grep -q '^failed 1$' err.txt && break; sleep 0.1; done; echo quit; } | TMPDIR=$PWD/gone live --control - -o said.rgba 2> err.txt
grep -q "^failed 1$" err.txt || fail "say without a TMPDIR: $(cat err.txt)"
grep -q "gone/ernerf-say-.*TMPDIR.*No such file" err.txt || fail "say without a TMPDIR: $(cat err.txt)"
echo mine > mine.sock
status=0; live --control mine.sock -o x.mp4 2> err.txt || status=$?
refused 1 $status "is no socket"
[ "$(cat mine.sock)" = mine ] || fail "mine.sock is not as it was"

# words that contradict each other
for words in "-o x.mp4" "--control - --audio - -o x.mp4" "--audio clip/aud.wav" "--audio clip/aud.wav -o x.mp4 --frames 0:3" \
  "--control - -o x.mp4 --as-fast" "--audio clip/aud.wav -o x.mp4 --as-fast --stay" "--set audio-rate=8000 --duration 1 -o x.mp4" "--set audio-rate=8000 --audio clip/aud.wav -o x.mp4" "--voice de --audio clip/aud.wav -o x.mp4" \
  "--speech-model x.onnx --audio clip/aud.wav -o x.mp4"; do
  status=0; live $words 2> err.txt < /dev/null || status=$?
  [ $status = 2 ] || fail "\"$words\": exit status $status: $(cat err.txt)"
done
echo "live: files, pipes, http, control, signals"
