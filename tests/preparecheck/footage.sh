#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The kinds of footage that `prepare` must judge rightly, made by ffmpeg of one good video: a line for each, and status
# 1 where a verdict is wrong. Usage: footage.sh ERNERF FOLDER [VIDEO]: 8 s of VIDEO, of a person who speaks before a
# background that stands still, a made-up one by default. Ends with 77 where ffmpeg or the verb prepare is not there.
set -euo pipefail
ernerf=$1 folder=$2 video=${3-}
skip() { echo "skipped: $1"; exit 77; }
command -v ffmpeg >/dev/null || skip "ffmpeg is not installed"
"$ernerf" prepare --help >/dev/null 2>&1 || skip "$ernerf has no verb prepare"
mkdir -p "$folder"
cd "$folder"
if [ -z "$video" ]; then
  echo "Every evening the old lamp in the window was lit, and whoever came home late saw it from far away." >said.txt
  "$ernerf" synth truth --size 256 --frames 200 --seed 104 --text said.txt --video truth.mp4 --quiet ||
    skip "there is no voice for a made-up video"
  video=truth.mp4
fi
ff() { ffmpeg -nostdin -loglevel error -y "$@"; }
coded=(-c:v libx264 -preset veryfast -crf 18 -c:a aac)
ff -i "$video" -t 8 -vf "crop=trunc(min(iw\,ih)/2)*2:trunc(min(iw\,ih)/2)*2,scale=256:256" -r 25 -ar 48000 "${coded[@]}" good.mp4

wrong=0
# NAME, the words that the verdict must have ("good": none but the shortness of the part), arguments of `prepare`.
judge() {
  local name=$1 words=$2 status=0 said
  shift 2
  rm -rf clip
  said=$("$ernerf" prepare "$name" -o clip --size 256 "$@" 2>&1) || status=$?
  local doubts
  doubts=$(grep -E "doubtful|refused|warning|error" <<<"$said" | grep -vE "the part is [0-9.]+ s long; to learn" || true)
  if [ "$words" = good ]; then
    [ "$status" = 0 ] && [ -z "$doubts" ] && { echo "ok     $name: good"; return; }
  elif grep -qF "$words" <<<"$said"; then
    echo "ok     $name: $words"
    return
  fi
  wrong=$((wrong + 1))
  echo "WRONG  $name: expected \"$words\"; status $status, $doubts"
}
# NAME WORDS ffmpeg's arguments after -i good.mp4.
made() {
  local name=$1 words=$2
  shift 2
  ff -i good.mp4 "$@" "$name"
  judge "$name" "$words"
}
filtered() { made "$1" "$2" -vf "$3" "${coded[@]}"; }
# The same for what the step `face` judges: its own is enough.
faced() {
  ff -i good.mp4 -vf "$3" "${coded[@]}" "$1"
  judge "$1" "$2" --only face
}

# What must not be doubted.
judge good.mp4 good
filtered fifty.mp4 good "fps=50"
filtered wide_pixels.mp4 good "scale=192:256,setsar=4/3"
filtered bars.mp4 good "pad=456:256:100:0"
filtered dimmer.mp4 good "eq=brightness='-0.03*sin(t)':eval=frame"
made right_is_minus_left.mkv "cancel each other" -c:v copy \
  -af "aformat=channel_layouts=mono,pan=stereo|c0=c0|c1=-1*c0" -c:a pcm_s16le
ff -i good.mp4 -vf transpose=2 "${coded[@]}" aside.mp4
ff -i aside.mp4 -c copy -metadata:s:v rotate=270 upright.mp4 # degrees clockwise, as phones write it
judge upright.mp4 good

# Sound.
made no_sound.mp4 "has no sound" -an -c:v copy
made muted.mp4 "is silent" -c:v copy -af volume=0 -c:a aac
ff -i good.mp4 -f lavfi -t 8 -i "anoisesrc=a=0.05:r=48000" -map 0:v -map 1:a -c:v copy -c:a aac hiss.mp4
judge hiss.mp4 "speech is heard in"
made half_the_sound.mp4 "the sound ends at" -c:v copy -af "atrim=0:4" -c:a aac

# Pictures.
faced still.mp4 "never changes" "select=eq(n\,0),tpad=stop_mode=clone:stop_duration=8"
faced cut.mp4 "as at a cut" "split[a][b];[b]hflip,negate[c];[a][c]overlay=enable='gte(t,4)'"
ff -f lavfi -t 4 -i testsrc=s=256x256:r=25 -f lavfi -t 4 -i sine -pix_fmt yuv420p "${coded[@]}" nobody.mp4
judge nobody.mp4 "no face was found" --only face
made short.mp4 "expected at least 1 s" -t 0.6 "${coded[@]}"
faced slow.mp4 "has no pictures of its own" "fps=4"
faced two.mp4 "more than one face" "split[a][b];[b]hflip[c];[a][c]hstack"
filtered hand_held.mp4 "the camera moves" "scale=288:288,crop=256:256:16+12*sin(3*t):16+12*cos(2.3*t)"
filtered banner.mp4 "a banner moves" \
  "split[a][b];[b]crop=256:26:0:0,noise=alls=100,scroll=h=0.01[c];[a][c]overlay=0:228"
strip="noise=alls=100:allf=t,gblur=1"
filtered street.mp4 "the background changes" \
  "split=3[a][b][c];[b]crop=50:150:0:0,$strip[l];[c]crop=50:150:206:0,$strip[r];[a][l]overlay=0:0[d];[d][r]overlay=206:0"
filtered inset.mp4 "a part of the background changes" "split[a][b];[b]crop=36:36:0:0,$strip[c];[a][c]overlay=0:0"
filtered lamp.mp4 "the light changes" "eq=brightness='0.1*sin(1.2*t)':eval=frame"
faced soft.mp4 "the face is soft" "scale=64:64,scale=256:256"
ff -i good.mp4 -vf "tinterlace=interleave_top,setfield=tff" -flags +ilme+ildct "${coded[@]}" tape.mp4
judge tape.mp4 "is interlaced" --only face
head -c "$(($(stat -c %s good.mp4) * 6 / 10))" good.mp4 >cut_off.mp4
judge cut_off.mp4 "cannot read it" --only face

echo "$wrong verdicts are wrong"
[ "$wrong" = 0 ]
