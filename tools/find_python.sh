#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Print the Python to make an environment with: the one asked for, or the first that will do.
# Names are looked up on the PATH, then among the versions that pyenv holds.
set -u
supported='import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))'
without_venv=
for name in ${1:-python3 python3.12 python3.11 python3.13}; do
  for python in "$name" "${PYENV_ROOT:-$HOME/.pyenv}"/versions/*/bin/"$name"; do
    "$python" -c "$supported" 2>/dev/null || continue
    if "$python" -c 'import ensurepip, venv' 2>/dev/null; then
      echo "$python"
      exit 0
    fi
    without_venv=$python
  done
done
if [ -n "$without_venv" ]; then
  version=$("$without_venv" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
  echo "$without_venv cannot make environments: apt install python$version-venv" >&2
else
  echo "no Python 3.11, 3.12 or 3.13 found${1:+ as $1}: apt install python3 python3-venv," \
    "or name one: make venv PY=/path/to/python3.12" >&2
fi
exit 1
