#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# libernerf-mpi compiled with MPICH: the same head on 2 processes as on one. Usage: mpich.sh ERNERF SOURCE FOLDER
ernerf=$1 source=$2 folder=$3
command -v mpicc.mpich > /dev/null || { echo "skipped: there is no mpicc.mpich"; exit 77; }
MPIRUN=mpirun.mpich
. "$source/tests/mpi/common.sh"
ln -s "$source/data/tiny" clip
mpicc.mpich -std=c17 -O2 -Wall -Wextra -Werror -fPIC -shared -D_POSIX_C_SOURCE=200809L -I"$source/include" -I"$source/src" \
  -I"${ernerf%/*}/../src" \
  "$source/src/mpi/mpi_world.c" -Wl,--version-script="$source/cmake/libernerf-mpi.map" -o libernerf-mpi.so.0
export LD_LIBRARY_PATH=$folder${LD_LIBRARY_PATH:+:$LD_LIBRARY_PATH}
head="--iters 5 --rays 256 --levels 6 --validate-frames 1 --set step-parts=4"
on 0 -o one.safetensors $head
on 2 -o two.safetensors $head
grep -q "^MPICH .*: 2 processes" log.txt || fail "it is not MPICH that runs: $(cat log.txt)"
same one.safetensors two.safetensors
echo "the same model with MPICH"
