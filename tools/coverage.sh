#!/usr/bin/env bash
# Which lines the tests reach: coverage.sh FOLDER PYTHON
# Compiled loops do not run as Python and are left out of the count (see pyproject.toml).
set -eu
out=$1 python=$2
mkdir -p "$out"
export COVERAGE_FILE=$PWD/$out/.coverage
rm -f "$COVERAGE_FILE"
failed=0
for suite in src/*/test test; do
  echo "$suite"
  log=$out/$(echo "$suite" | tr / -).log
  "$python" -m pytest -q "$suite" --cov=src --cov-append --cov-report= >"$log" 2>&1 ||
    { failed=1; tail -n 5 "$log"; }
done
"$python" -m coverage report --sort=cover | tee "$out/report.txt"
"$python" -m coverage html -q -d "$out/html"
echo "in $out/html"
exit $failed
