#!/bin/bash
# SPDX-License-Identifier: MIT
# `ernerf convert` checked by PyTorch: what it read has PyTorch's bytes, what it wrote PyTorch opens. 77 (skipped) where
# there is no PyTorch. Called with the source folder and the program; ERNERF_SHARED adds real checkpoints.
set -eu
source=$1 program=$2
python=/usr/bin/python3
if ! "$python" -c 'import torch, numpy' 2>/dev/null; then
  echo "skipped: $python has no torch"
  exit 77
fi
torch() { "$python" "$source/tests/e2e/convert_torch.py" "$@"; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# there and back: the same tree and bytes
round() {
  local name
  name=$(basename "$1")
  "$program" convert --quiet "$1" "$work/$name.safetensors" 2>/dev/null
  "$program" convert --quiet "$work/$name.safetensors" "$work/$name.pth" 2>/dev/null
  torch listed "$1" "$work/$name.safetensors"
  torch same "$1" "$work/$name.pth"
}
mkdir "$work/made"
torch make "$work/made"
for name in kinds kinds4 tree old; do round "$work/made/$name.pth"; done

if [ -z "${ERNERF_SHARED:-}" ]; then
  echo "without ERNERF_SHARED: no real checkpoints"
  exit 0
fi
parity=$ERNERF_SHARED/parity
for file in "$parity/head.pth" "$parity/head_torso.pth" "$parity/full/head_full.pth" "$ERNERF_SHARED"/real/*.pt; do
  round "$file"
done
# our own layout, from files that were never a .pth here
"$program" convert --quiet "$parity/head.safetensors" "$work/own.pth"
"$program" convert --quiet "$parity/head_torso.safetensors" "$work/portrait.pth"
torch strict "$parity/torch/ernerf_torch.py" "$work/own.pth"
torch strict "$parity/torch/ernerf_torch.py" "$work/portrait.pth" torso
torch model "$parity/head.pth" "$work/own.pth"
torch model "$parity/head_torso.pth" "$work/portrait.pth"
# a training that PyTorch began goes on here, and PyTorch's optimizer takes its state
"$program" train "$parity/clip" --from "$parity/full/head_full.pth" -o "$work/on.safetensors" --iters 4 --rays 64 \
  --validate-every 0 --validate-frames 1 --quiet
"$program" convert --quiet "$work/on.run/state.safetensors" "$work/on.pth"
if ! "$python" -c 'import cv2' 2>/dev/null; then
  echo "$python has no cv2, which the recorded training needs: its optimizer was not asked"
  exit 0
fi
torch optimizer "$parity/torch" "$work/on.pth" 4
