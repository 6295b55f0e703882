#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The OpenCL kernels once more on oclgrind, which simulates a device and reports every access out of bounds, every race
# between work-items and every misuse of the interface: in both forms of the kernels, on the smaller of the tests' sizes.
# Skipped (77) where oclgrind is missing. Usage: check_oclgrind.sh BIN [NOUN...]   (NOUN: march ...)
set -euo pipefail
bin=$1
shift

command -v oclgrind >/dev/null || { echo "skipped: no oclgrind (Debian's package oclgrind)"; exit 77; }
if [ $# -eq 0 ]; then
  mapfile -t names < <("$bin/kernelcheck" --list | grep -v '^on:')
else
  names=("$@")
fi
[ "${#names[@]}" -gt 0 ] || { echo "FAIL: no nouns in $bin/kernelcheck"; exit 1; }

faults=0
for name in "${names[@]}"; do
  for form in cpu gpu; do
    log=oclgrind_${name}_$form.log
    began=$SECONDS
    status=0
    ERNERF_TEST_SMALL=1 ERNERF_OPENCL_FORM=$form oclgrind --log "$log" --data-races --check-api --max-errors 20 \
      "$bin/kernelcheck" --op "$name" --backend opencl >"$log.out" 2>&1 || status=$?
    reports=0
    if [ -e "$log" ]; then reports=$(grep -cE '^(Invalid|Write-write|Read-write|Uninitialized|Oclgrind - OpenCL runtime error)' "$log" || true); fi
    echo "$name, $form form: exit status $status, $reports reports, $((SECONDS - began)) s"
    if [ "$status" -ne 0 ]; then tail -n 15 "$log.out"; fi
    if [ "$reports" -ne 0 ]; then head -n 40 "$log"; fi
    if [ "$status" -ne 0 ] || [ "$reports" -ne 0 ]; then faults=$((faults + 1)); fi
  done
done
[ "$faults" -eq 0 ]
