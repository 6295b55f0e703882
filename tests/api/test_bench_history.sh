#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# tools/bench-history appends rows to a table, also to one whose last line has no end. The figures come from a program that measures
# nothing. Usage: test_bench_history.sh SOURCE FOLDER
set -euo pipefail
source=$1 folder=$2
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
fail() { echo "FAIL: $1"; exit 1; }
command -v jq > /dev/null && git -C "$source" rev-parse --git-dir > /dev/null 2>&1 || { echo "skipped: needs jq and a git repository"; exit 77; }
cat > bench << 'END'
#!/bin/sh
while [ "$1" != --json ]; do shift; done
echo '{"cpu": "none", "peaks": {"unrest": 1, "threads": 1, "isas": [{"backend": "cpu", "isa": "ref", "flops": {"all": 1e9}}]}}' > "$2"
END
chmod +x bench
ERNERF=$PWD/bench "$source/tools/bench-history" -o table.csv > out.txt
cp table.csv whole.csv
printf '%s' "$(cat table.csv)" > table.csv
ERNERF=$PWD/bench "$source/tools/bench-history" -o table.csv > out.txt
[ "$(wc -l < table.csv)" = 3 ] || fail "$(wc -l < table.csv) lines, expected the columns and two rows: $(cat table.csv)"
cmp -s <(head -n 2 table.csv) whole.csv || fail "the row before was changed: $(cat table.csv)"
# 1 KiB a file: the bench's figures fit, a longer table does not
for _ in $(seq 20); do tail -n 1 whole.csv; done >> table.csv
cp table.csv before.csv
! (ulimit -f 1; trap '' XFSZ; ERNERF=$PWD/bench "$source/tools/bench-history" -o table.csv) > out.txt 2>&1 || fail "a file beyond the limit was written"
cmp -s table.csv before.csv || fail "a table that could not be written was changed"
[ ! -e table.csv.new ] || fail "table.csv.new was left"
echo "two rows, each a line; a table that cannot be written whole stays"
