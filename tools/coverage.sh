#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Which lines the tests reach: coverage.sh FOLDER PYTHON [SUITE...]
# Compiled loops do not run as Python and are left out of the count (see pyproject.toml).
set -eu
out=$(realpath -m "$1") python=$2
shift 2
[ $# -gt 0 ] || set -- src/*/test test
mkdir -p "$out"
# the sources, before what is installed of them
PYTHONPATH=$(printf "$PWD/%s:" src/*)${PYTHONPATH:-}
COVERAGE_FILE=$out/.coverage
export PYTHONPATH COVERAGE_FILE
rm -f "$COVERAGE_FILE"
failed=0
for suite in "$@"; do
  echo "$suite"
  log=$out/$(echo "$suite" | tr / -).log
  "$python" -m pytest -q "$suite" --cov=src --cov-append --cov-report= >"$log" 2>&1 ||
    { failed=1; tail -n 5 "$log"; }
done
"$python" -m coverage report --sort=cover | tee "$out/report.txt"
"$python" -m coverage html -q -d "$out/html"
echo "in $out/html"
exit $failed
