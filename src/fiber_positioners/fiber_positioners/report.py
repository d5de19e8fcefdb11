# SPDX-License-Identifier: Apache-2.0
"""Reports as JSON: plain numbers and strings, null for what is not finite."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

__all__ = ["report_line", "save_report"]


def report_line(report: Mapping[str, object]) -> str:
    """Return a report as one line of JSON."""
    return json.dumps(_finite(dict(report)))


def save_report(path: Path, report: Mapping[str, object]) -> None:
    """Write a report as indented JSON."""
    path.write_text(json.dumps(_finite(dict(report)), indent=2) + "\n", encoding="utf-8")


def _finite(value: object) -> object:
    # JSON has no number for what is not finite
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value
