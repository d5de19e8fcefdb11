#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Make an environment with exactly the packages of a lock file: make_venv.sh FOLDER LOCK [PYTHON]
set -eu
folder=$1 lock=$2
if [ -L "$folder" ]; then
  echo "$folder is a link to $(readlink -f "$folder"), which others may use: it is not changed." \
    "Remove the link to make an environment here, or 'touch $folder/.installed' to use it as it is." >&2
  exit 1
fi
python=$("$(dirname "$0")/find_python.sh" "${3-}")
count=$(wc -l <"$lock")
echo "making $folder with $("$python" --version): $count packages, a minute or two"
"$python" -m venv --clear "$folder"
# The lock is complete: nothing is resolved, so nothing can drift.
log=$(mktemp)
trap 'rm -f "$log"' EXIT
set -o pipefail
if ! "$folder/bin/python" -m pip install --no-deps --disable-pip-version-check --progress-bar off \
  -r "$lock" 2>&1 | tee "$log" | "$(dirname "$0")/pip_progress.sh" "$count"; then
  tail -n 15 "$log" >&2
  exit 1
fi
