#!/bin/sh
# SPDX-License-Identifier: MIT
# in_empty_folder.sh FOLDER COMMAND...: runs the command in the folder, made empty before. What an earlier run of a test
# left there would be refused as an output that exists.
set -eu
folder=$1
shift
rm -rf -- "$folder"
mkdir -p -- "$folder"
cd -- "$folder"
exec "$@"
