#!/usr/bin/env bash
# SPDX-License-Identifier: MIT
# examples/cluster under a Slurm of its own: slurmctld and two nodes of one processor, on the loopback of a network
# namespace. All of it ends with this script, however that ends, for it is the first process of a namespace of processes.
# Segments of an array job, joined, against the whole; people of whom one has no clip; a training on two nodes.
# Usage: slurm.sh ERNERF SOURCE FOLDER
set -euo pipefail
ernerf=$1 source=$2 folder=$3 scripts=$2/examples/cluster
PATH=$PATH:/usr/sbin:/sbin
if [ "${4-}" != inside ]; then
  for program in slurmctld slurmd sbatch munged unshare ip jq; do
    command -v $program > /dev/null || { echo "skipped: there is no $program"; exit 77; }
  done
  own=(unshare --net --pid --fork --kill-child --mount-proc)
  [ "$(id -u)" = 0 ] || own+=(--map-current-user --keep-caps)
  "${own[@]}" true || { echo "skipped: namespaces are not to be had"; exit 77; }
  exec "${own[@]}" bash "$0" "$@" inside
fi
rm -rf "$folder"
mkdir -p "$folder/people"
cd "$folder"
slurm=$(mktemp -d) # its path is short: that of a socket has at most 107 bytes
trap 'rm -rf "$slurm"' EXIT
fail() {
  echo "FAIL: $*"
  tail -n 20 "$slurm"/*.log
  exit 1
}
await() { # COMMAND...: until the command is true
  local end=$((SECONDS + 60))
  until "$@"; do
    [ $SECONDS -lt $end ] || fail "waited in vain for: $*"
    sleep 0.2
  done
}
export ERNERF=$ernerf SCRIPTS=$scripts SLURM_CONF=$slurm/slurm.conf
export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1 OMPI_MCA_oob_tcp_if_include=lo OMPI_MCA_btl_tcp_if_include=lo

ip link set lo up
ip address add 192.0.2.1/32 dev lo # Slurm asks for an address of a family that the machine has beside 127.0.0.1
host=$(hostname -s)
cat > "$SLURM_CONF" << END
ClusterName=ernerf
SlurmctldHost=$host(127.0.0.1)
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
AuthInfo=socket=$slurm/munge.socket
StateSaveLocation=$slurm/state
SlurmdSpoolDir=$slurm/spool.%n
SlurmctldPidFile=$slurm/slurmctld.pid
SlurmdPidFile=$slurm/slurmd.%n.pid
SlurmctldLogFile=$slurm/slurmctld.log
SlurmdLogFile=$slurm/slurmd.%n.log
SlurmctldDebug=error
SlurmdDebug=error
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SlurmdParameters=config_overrides
NodeName=one NodeHostname=$host NodeAddr=127.0.0.1 Port=7001 CPUs=1
NodeName=two NodeHostname=$host NodeAddr=127.0.0.1 Port=7002 CPUs=1
PartitionName=all Nodes=ALL Default=YES
END
mkdir "$slurm/state" "$slurm/spool.one" "$slurm/spool.two"
head -c 1024 /dev/urandom > "$slurm/munge.key"
chmod 400 "$slurm/munge.key"
munged --force --foreground --socket="$slurm/munge.socket" --key-file="$slurm/munge.key" --pid-file="$slurm/munged.pid" \
  --seed-file="$slurm/munged.seed" --num-threads=1 > "$slurm/munged.log" 2>&1 &
await test -S "$slurm/munge.socket"
slurmctld -D > /dev/null 2>&1 &
for node in one two; do slurmd -D -N $node > /dev/null 2>&1 & done
idle() { [ "$(sinfo --noheader --Node --format=%T 2> /dev/null | sort | uniq -c | tr -s ' ')" = " 2 idle" ]; }
await idle
batch() { sbatch --quiet --wait --time=5 "$@" || fail "$*: $(tail -n 3 ./*.log)"; }

clip=$source/data/tiny frames=66 each=25
"$ernerf" train "$clip" -o head.safetensors --iters 3 --rays 64 --levels 2 --threads 1 --quiet
draw="--crf 0 --set preset=ultrafast --quiet" # without loss, so that pictures that were drawn alike are decoded alike
batch --array=0-2 "$scripts/segments.sbatch" head.safetensors "$clip" parts $frames $each $draw
"$ernerf" join parts -o joined.mp4 --json join.json --quiet
[ "$(jq .videos join.json)" = 3 ] || fail "$(cat join.json)"
"$ernerf" render head.safetensors --clip "$clip" --split all --threads 1 -o whole.mp4 $draw
"$ernerf" compare whole.mp4 joined.mp4 "$clip" --split all -o compared --quiet > compare.txt
grep -qE "^PSNR .* 0 +0 +$frames\$" compare.txt || fail "the joined frames are not those of the whole: $(cat compare.txt)"
# what a task says when it fails, and that Slurm is told
if sbatch --quiet --wait --array=3 "$scripts/segments.sbatch" head.safetensors "$clip" parts $frames $each; then fail "a segment past the end was taken"; fi
grep -q "begins with frame 75, there are 66" segment-3.log || fail "$(cat segment-3.log)"

ln -s "$clip" people/anna
mkdir people/broken # no clip
ln -s "$clip" people/carl
batch --array=0-2 "$scripts/people.sbatch" people out --iters 3 --rays 64 --levels 2 --validate-frames 1
"$scripts/table.sh" out > table.txt
grep -qE "^anna +[0-9.]+ +0[.][0-9]+ +[0-9.]+$" table.txt || fail "anna is not in the table: $(cat table.txt)"
grep -qE "^carl +[0-9.]+ " table.txt || fail "carl is not in the table: $(cat table.txt)"
grep -q "^broken .*failed in train:ernerf train: " table.txt || fail "the table does not name who failed: $(cat table.txt)"
grep -q "3 people, 1 failed" table.txt || fail "the table does not count: $(cat table.txt)"
if sbatch --quiet --wait --array=3 "$scripts/people.sbatch" people out; then fail "a fourth of three people was taken"; fi
grep -q "task 3: there are 3 in people" person-3.log || fail "$(cat person-3.log)"

if ! command -v mpirun > /dev/null || ! mpirun --version 2> /dev/null | grep -q "Open MPI"; then
  echo "segments and people; there is no Open MPI, so no training on two nodes"
  exit 0
fi
options="--iters 3 --rays 64 --levels 2 --validate-frames 1"
batch --nodes=2 --output=train.log "$scripts/train.sbatch" "$clip" -o two.safetensors $options
grep -q "2 processes" train.log || fail "they are not two: $(cat train.log)"
"$ernerf" train "$clip" -o one.safetensors $options --set step-parts=4 --threads 1 --quiet
cmp one.safetensors two.safetensors || fail "the model of two nodes is another"
echo "segments, people and a training on two nodes"
