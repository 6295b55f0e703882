# SPDX-License-Identifier: MIT
# What the tests with mpirun share: needs $ernerf and $folder. Sourced by bash.
set -euo pipefail
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_rmaps_base_oversubscribe=1
mpirun=${MPIRUN:-mpirun}
command -v "$mpirun" > /dev/null || { echo "skipped: there is no $mpirun"; exit 77; }
rm -rf "$folder"
mkdir -p "$folder"
cd "$folder"
trap 'kill $(jobs -p) 2> /dev/null || true' EXIT
fail() { echo "FAIL: $*"; exit 1; }
on() { # PROCESSES OPTION...: trains on so many, without mpirun where it is 0
  local count=$1
  shift
  if [ "$count" = 0 ]; then
    "$ernerf" train clip --threads 1 "$@" > log.txt 2>&1 || { cat log.txt; return 1; }
  else
    "$mpirun" -n "$count" "$ernerf" train clip --threads 1 "$@" > log.txt 2>&1 || { cat log.txt; return 1; }
  fi
}
rank_of() { { tr '\0' '\n' < "/proc/$1/environ"; } 2> /dev/null | sed -n 's/^\(OMPI_COMM_WORLD_RANK\|PMI_RANK\)=//p'; }
process() { # RANK NAME: the process of that rank that writes NAME.safetensors, once it is there
  local process
  for process in $(pgrep -f "ernerf train .*$folder/$2[.]safetensors"); do
    [ "$(rank_of "$process")" != "$1" ] || { echo "$process"; return 0; }
  done
  return 1
}
await() { # SECONDS COMMAND...: until the command is true
  local end=$((SECONDS + $1))
  shift
  until "$@"; do
    [ $SECONDS -lt $end ] || fail "waited in vain for: $*"
    sleep 0.05
  done
}
same() { cmp "$1" "$2" || fail "$1 and $2 differ"; }
