#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Resolve requirements into exact versions: lock.sh REQUIREMENTS LOCK [PYTHON]
# Run it with the oldest Python supported: its newest packages also serve the later ones.
set -eu
requirements=$1 lock=$2
python=$("$(dirname "$0")/find_python.sh" "${3:-python3.11}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m venv "$work/venv"
# The report and not `pip freeze`: the wheels also register ROS packages that no index has.
"$work/venv/bin/python" -m pip install --quiet --dry-run --ignore-installed \
  --report "$work/report.json" -r "$requirements"
"$python" - "$work/report.json" >"$lock" <<'PYTHON'
import json
import re
import sys

report = json.load(open(sys.argv[1]))
for line in sorted(
    f"{re.sub('[-_.]+', '-', item['metadata']['name']).lower()}=={item['metadata']['version']}"
    for item in report["install"]
):
    print(line)
PYTHON
