#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# A signal that reaches a script of tools/ alone ends the program that it runs too, and the script after it. A script that waits
# stands in for the programs. For portrait and dub: tests/prepare/portrait_stopped.sh. Usage: test_stopped.sh SOURCE FOLDER
set -euo pipefail
source=$1 folder=$2
command -v jq > /dev/null || { echo "skipped: needs jq"; exit 77; }
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
fail() { echo "FAIL: $1"; cat out.txt; exit 1; }
mkdir -p tools bin build/{release/bin,fuzz/tests/bin} tests/fuzz/corpus/npy portraits/one/clip
touch build/fuzz/build.ninja portraits/one/portrait.safetensors
for script in paper-table bench-history demo device-check fuzz test child.sh; do cp "$source/tools/$script" tools; done
# in Perl: a shell that waits forks, and a child that has its trap still may write too
cat > wait << 'END'
#!/usr/bin/perl
sub note { open(my $calls, '>>', $ENV{CALLS}) or die; print $calls "$_[0]\n"; close($calls); }
$SIG{TERM} = sub { note('ended'); exit 0; };
note('waits');
sleep(30);
END
printf '#!/bin/sh\n' > idle
chmod +x wait idle
export CALLS=$PWD/calls.log PATH=$PWD/bin:$PATH
stopped() { # SIGNAL SCRIPT ARGUMENT...
  local signal=$1 status=0
  shift
  : > calls.log
  rm -rf device-check
  bash "tools/$1" "${@:2}" > out.txt 2>&1 &
  for _ in {1..100}; do [ ! -s calls.log ] || break; sleep 0.1; done
  kill -s "$signal" $!
  wait $! || status=$?
  [ "$status" = "$((128 + $(kill -l "$signal")))" ] || fail "$1: $signal: exit status $status"
  [ "$(tr '\n' ' ' < calls.log)" = 'waits ended ' ] || fail "$1: $signal: the program goes on, or another was begun: $(cat calls.log)"
}
for program in bin/{cmake,git} tools/install-packages; do cp idle "$program"; done
for program in bin/ctest build/release/bin/ernerf build/fuzz/tests/bin/fuzz_npy; do cp wait "$program"; done
for signal in TERM HUP; do
  stopped $signal paper-table portraits -o table.md
  stopped $signal bench-history -o table.csv
  stopped $signal demo
  stopped $signal device-check
  stopped $signal fuzz npy 1
  stopped $signal test
done
cp wait bin/cmake # the build
stopped TERM demo
stopped TERM test
stopped TERM fuzz
[ ! -e table.md ] && [ ! -e table.csv ] || fail "a table was written"
echo "all end with their program"
