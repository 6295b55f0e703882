#!/bin/bash
# SPDX-License-Identifier: MIT
# LPIPS held against PyTorch (lpips_torch.py). 77 (skipped) where there is no PyTorch, or no LPIPS in this build.
# Usage: test_lpips_torch.sh SOURCE FOLDER_OF_LIBRARIES
set -eu
python=${ERNERF_PYTHON:-/usr/bin/python3}
if ! "$python" -c 'import torch, numpy' 2>/dev/null; then
  echo "skipped: $python has no torch"
  exit 77
fi
[ -e "$2/libernerf-perceptual.so" ] || { echo "skipped: built without ERNERF_PERCEPTUAL"; exit 77; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" "$1/tests/e2e/lpips_torch.py" "$2" "$work"
