#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# How long one sum of a step takes over a link (docs/scaling.md, "Links"): two processes of MPICH in two network
# namespaces, which link_relay joins by a link of GBIT gigabits a second and MS milliseconds one way. A measurement, not
# a test. Needs root, MPICH, iproute2 and /dev/net/tun. Usage: links.sh GBIT MS [VALUES [SUMS [SHARE]]]; SHARE of the
# values are not 0.
set -euo pipefail
source=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
if [ "${1-}" = rank ]; then # in the namespace of this rank
  shift
  exec nsenter --net --mount --target $((PMI_RANK == 0 ? FIRST_SPACE : SECOND_SPACE)) "$@"
fi
gbit=$1 ms=$2 values=${3-634221} sums=${4-25} share=${5-0.33}
folder=$(mktemp -d)
trap 'kill $(jobs -p) 2> /dev/null; rm -rf "$folder"' EXIT
cc -std=c17 -O2 -Wall -Wextra -o "$folder/link_relay" "$source/tests/mpi/link_relay.c" -pthread
mkdir "$folder/core"
echo "#define ERN_INTERFACE_VERSION \"\"" > "$folder/core/interface_version.h"
mpicc.mpich -std=c17 -O2 -Wall -Wextra -D_POSIX_C_SOURCE=200809L -D_DEFAULT_SOURCE -I"$source/include" -I"$source/src" -I"$folder" -o "$folder/link_sums" \
  "$source/tests/mpi/link_sums.c" "$source/src/mpi/mpi_world.c"
# UCX finds devices in /sys, which shows those of the namespace that it was mounted in
make='mount -t sysfs none /sys && exec sleep infinity'
unshare --net --mount bash -c "$make" &
FIRST_SPACE=$!
unshare --net --mount bash -c "$make" &
SECOND_SPACE=$!
export FIRST_SPACE SECOND_SPACE
for process in $FIRST_SPACE $SECOND_SPACE; do
  until [ "$(cat /proc/$process/comm)" = sleep ]; do sleep 0.05; done
done
"$folder/link_relay" /proc/$FIRST_SPACE/ns/net /proc/$SECOND_SPACE/ns/net "$gbit" "$ms" > "$folder/ready" &
until grep -q ready "$folder/ready"; do
  kill -0 $! || exit 1
  sleep 0.05
done
number=0
for process in $FIRST_SPACE $SECOND_SPACE; do
  inside=(nsenter --net --target $process ip) number=$((number + 1))
  "${inside[@]}" link set lo up
  "${inside[@]}" address add 192.0.2.$number peer 192.0.2.$((3 - number)) dev tun0
  "${inside[@]}" link set tun0 mtu 9000 up
done
# TCP and nothing else, also between processes of one machine
export UCX_TLS=tcp,self UCX_NET_DEVICES=tun0 FI_PROVIDER=tcp MPIR_CVAR_NOLOCAL=1
said=$(mpirun.mpich -n 2 bash "${BASH_SOURCE[0]}" rank "$folder/link_sums" "$values" "$sums" "$share")
echo "$gbit Gbit/s, $ms ms: $said"
