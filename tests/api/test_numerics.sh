#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# docs/numerics*.md name every test function of tests/numerics once, a row each, and no other. Usage: test_numerics.sh SOURCE
set -euo pipefail
cd "$1"
least=60
fail() { echo "FAIL: $1"; exit 1; }

# A row: | case | naive | ours | bound | `test_name` |
rows=$(grep -hE '^\|.*`test_' docs/numerics*.md || true)
named=$(sed -nE 's/^\|([^|]+\|){4} `(test_[a-z0-9_]+)` \|$/\2/p' <<<"$rows" | sort)
there=$(grep -hoE '^static void test_[a-z0-9_]+\(void \*\*' tests/numerics/test_*.c | grep -oE 'test_[a-z0-9_]+' | sort)
listed=$(grep -hoE 'cmocka_unit_test\(test_[a-z0-9_]+\)' tests/numerics/test_*.c | grep -oE 'test_[a-z0-9_]+\)' | tr -d ')' | sort -u)

[ "$(wc -l <<<"$rows")" -eq "$(wc -l <<<"$named")" ] || fail "a row that names a test has other than five columns"
[ -z "$(uniq -d <<<"$named")" ] || fail "named twice: $(uniq -d <<<"$named" | xargs)"
[ -z "$(uniq -d <<<"$there")" ] || fail "two functions of one name: $(uniq -d <<<"$there" | xargs)"
lost=$(comm -23 <(echo "$named") <(echo "$there") | xargs)
unnamed=$(comm -13 <(echo "$named") <(echo "$there") | xargs)
idle=$(comm -3 <(echo "$listed") <(echo "$there") | xargs)
[ -z "$lost" ] || fail "docs/numerics*.md names what is not in tests/numerics: $lost"
[ -z "$unnamed" ] || fail "docs/numerics*.md does not name: $unnamed"
[ -z "$idle" ] || fail "not both written and run: $idle"
count=$(wc -l <<<"$named")
[ "$count" -ge "$least" ] || fail "$count cases, expected $least at least"
echo "$count cases, each with its test"
