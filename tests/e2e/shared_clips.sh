#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Makes the clips, the video and the models that other end-to-end tests take (cli_shared_* of cli.h). CTest runs it before
# them: it is their fixture. Usage: shared_clips.sh ERNERF FOLDER
set -euo pipefail
ernerf=$1 folder=$2
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
# 30 frames to train on and 3 for validation; 60 and 6, and a head that is hardly trained
"$ernerf" synth short --size 64 --frames 33 --seed 3 --quiet
"$ernerf" synth long --size 64 --frames 66 --seed 3 --quiet
# a video to prepare, with its truth
"$ernerf" synth person --size 160 --frames 30 --seed 5 --turn 12 --parsing --video person.mp4 --quiet
# a clip with its video, and a head for it
"$ernerf" synth recorded --size 96 --frames 16 --seed 3 --parsing --video recorded.mp4 --quiet
"$ernerf" train recorded -o recorded_head.safetensors --iters 200 --rays 128 --lr 0.03 --lr-net 0.005 --levels 2 --validate-frames 1 \
  --asr-model cepstra --quiet
"$ernerf" train short -o short_head.safetensors --iters 20 --rays 256 --levels 2 --validate-frames 1 --quiet
"$ernerf" train long -o long_head.safetensors --iters 6 --rays 256 --levels 4 --validate-frames 1 --quiet
