#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# Every test function of tests/numerics is run, has a name of its own, and a comment from which
# tests/numerics/hard_cases.sh makes a whole row. Usage: test_numerics.sh SOURCE
set -euo pipefail
cd "$1"
least=200
fail() { echo "FAIL: $1"; exit 1; }

# A row: | case | plain code | here | bound | `test_name` |
rows=$(tests/numerics/hard_cases.sh | grep -E '`test_[a-z0-9_]+` [|]$')
whole=$(grep -E '^([|] [^|]*[^| ] ){4}[|] `test_' <<<"$rows" | grep -oE 'test_[a-z0-9_]+`' | tr -d '`' | sort)
there=$(grep -hoE '^static void test_[a-z0-9_]+\(void \*\*' tests/numerics/test_*.c | grep -oE 'test_[a-z0-9_]+' | sort)
listed=$(grep -hoE 'cmocka_unit_test\(test_[a-z0-9_]+\)' tests/numerics/test_*.c | grep -oE 'test_[a-z0-9_]+\)' | tr -d ')' | sort -u)

[ -z "$(uniq -d <<<"$there")" ] || fail "two functions of one name: $(uniq -d <<<"$there" | xargs)"
bare=$(comm -13 <(echo "$whole") <(echo "$there") | xargs)
idle=$(comm -3 <(echo "$listed") <(echo "$there") | xargs)
[ -z "$bare" ] || fail "the comment has not case, plain code, here and bound: $bare"
[ -z "$idle" ] || fail "not both written and run: $idle"
count=$(wc -l <<<"$whole")
[ "$count" -ge "$least" ] || fail "$count cases, expected $least at least"
grep -q "$count cases in all" docs/numerics.md || fail "docs/numerics.md has another number of cases than $count"
for name in $(grep -oE '`test_[a-z0-9_]+`' docs/numerics.md | tr -d '`' | grep -v '^test_hard_\|^test_bf16_price$'); do
  grep -qx "$name" <<<"$there" || fail "docs/numerics.md names $name, which is not in tests/numerics"
done
echo "$count cases, each with its test"
