#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# The sums of a step on 1, 2, 4 and 8 processes, bit for bit. Usage: sums.sh ERNERF SOURCE FOLDER
ernerf=$1 source=$2 folder=$3
. "$source/tests/mpi/common.sh"
command -v mpicc > /dev/null || { echo "skipped: there is no mpicc"; exit 77; }
mpicc -std=c17 -O2 -Wall -Wextra -Werror -D_POSIX_C_SOURCE=200809L -I"$source/include" -I"$source/src" \
  -I"${ernerf%/*}/../src" -o tree_sums \
  "$source/tests/mpi/tree_sums.c" "$source/src/mpi/mpi_world.c"
for count in 1 2 4 8; do
  "$mpirun" -n $count ./tree_sums > log.txt 2>&1 || { cat log.txt; fail "$count processes"; }
  grep "sums on $count processes agree" log.txt || { cat log.txt; fail "$count processes"; }
done
