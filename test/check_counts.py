# SPDX-License-Identifier: Apache-2.0
"""Fail when fewer tests ran than expected: a runner that finds no tests says nothing."""

import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree


def count(report: Path) -> dict[str, int]:
    """Return how many tests a JUnit report holds: passed, failed (errors too), skipped."""
    totals = dict.fromkeys(("tests", "failures", "errors", "skipped"), 0)
    if report.exists():
        for suite in ElementTree.parse(report).getroot().iter("testsuite"):
            for name in totals:
                totals[name] += int(suite.get(name, 0))
    failed = totals["failures"] + totals["errors"]
    return {
        "passed": totals["tests"] - failed - totals["skipped"],
        "failed": failed,
        "skipped": totals["skipped"],
    }


def failures(report: Path) -> list[str]:
    """Return a line for each test of a JUnit report that failed: where, and its last words."""
    if not report.exists():
        return []
    lines = []
    for case in ElementTree.parse(report).getroot().iter("testcase"):
        for kind in ("failure", "error"):
            for trouble in case.iter(kind):
                said = (trouble.get("message") or trouble.text or "").strip().splitlines()
                lines.append(f"{case.get('classname')}::{case.get('name')}  {' '.join(said)[:300]}")
    return lines


def main(build: Path, minimum_file: Path) -> int:
    """Print the counts of every suite; return 1 if one is too small or anything failed."""
    minimum = tomllib.loads(minimum_file.read_text())["minimum"]
    total = dict.fromkeys(("passed", "failed", "skipped"), 0)
    short = []
    for suite, expected in minimum.items():
        counts = count(build / suite / "pytest.xml")
        collected = sum(counts.values())
        for name in total:
            total[name] += counts[name]
        print(f"{suite:<18} {collected:4d} tests, at least {expected} expected")
        if collected < expected:
            short.append(f"{suite}: {collected} tests instead of at least {expected}")
        for line in failures(build / suite / "pytest.xml"):
            print(f"FAILED   {line}")
    for line in short:
        print(f"TOO FEW  {line}")
    print("{passed} passed, {failed} failed, {skipped} skipped".format(**total))
    return int(bool(short) or total["failed"] > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
