#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The Python module (docs/python.md): held to the headers by test_headers.py, and to what C programs give by test_module.py.
# The program of docs/python.md runs. With ERNERF_TEST_LONG the module is made into a wheel and installed from it.
# Usage: test_module.sh SOURCE ERNERF LIBERNERF STEPS RENDER_MINIMAL FOLDER, with CC in the environment
set -euo pipefail
source=$1 ernerf=$2 library=$3 steps=$4 render_minimal=$5 work=$6
python=${ERNERF_PYTHON:-/usr/bin/python3}
"$python" -c 'import numpy' 2>/dev/null || { echo "skipped: $python has no numpy (python3-numpy)"; exit 77; }
rm -rf "$work"
mkdir -p "$work"
cd "$work"

cp -r "$source/python" module # pip builds where the sources are
export PIP_ROOT_USER_ACTION=ignore
if [ -n "${ERNERF_TEST_LONG-}" ] && "$python" -c 'import setuptools, wheel, pip' 2>/dev/null; then
  "$python" -m pip wheel --quiet --no-index --no-build-isolation --no-deps --wheel-dir wheels ./module
  "$python" -m pip install --quiet --no-index --no-deps --no-compile --target site wheels/ernerf-*.whl
else
  [ -z "${ERNERF_TEST_LONG-}" ] ||
    echo "$python has no pip, setuptools or wheel (python3-pip, -setuptools, -wheel): the module is not made into a wheel"
  mkdir site
  cp -r module/ernerf site
fi
export PYTHONPATH=$work/site PYTHONDONTWRITEBYTECODE=1 ERNERF_SOURCE=$source ERNERF_LIBRARY=$library

"$ernerf" synth clip --size 64 --frames 16 --seed 3 --quiet
"$ernerf" features clip/aud.wav -o speech.npy --quiet
rm -f clip/aud_ds.npy # of the clip's sound, as speech.npy
"$steps" clip head.safetensors 6 >losses.txt
"$render_minimal" head.safetensors speech.npy clip/transforms_val.json frames.rgba
"$render_minimal" head.safetensors speech.npy clip/transforms_val.json grey.ppm
"$python" "$source/tests/python/test_headers.py"
"$python" "$source/tests/python/test_module.py"

mkdir program
mv clip program/CLIP
cp program/CLIP/aud.wav program/speech.wav
cd program
sed -n '/^    import ernerf/,/^[^ ]/s/^    //p' "$source/docs/python.md" >program.py
"$python" program.py >program.txt || { echo "FAIL: the program of docs/python.md"; exit 1; }
grep -q '^(64, 64, 3) float32 0[.]' program.txt || { echo "FAIL: the program of docs/python.md says:"; cat program.txt; exit 1; }
