#!/bin/sh
# SPDX-License-Identifier: MIT
# in_empty_folder.sh FOLDER COMMAND...: runs the command in the folder, made empty before. What an earlier run of a test
# left there would be refused as an output that exists. Signals do what they usually do, also where a caller such as
# nohup ignores them, which a child would inherit.
set -eu
folder=$1
shift
rm -rf -- "$folder"
mkdir -p -- "$folder"
cd -- "$folder"
exec env --default-signal=HUP,INT,QUIT,TERM "$@"
