# SPDX-License-Identifier: Apache-2.0
"""Layouts, present angles and targets from the files of many instruments, and results to files.

`read_layout`, `read_starts` and `read_targets` find the format by the content of the files; what a
file holds and is not used stands in the notices of what they return.
"""

from fiber_formats.columns import Columns, read_columns
from fiber_formats.conversion import KINDS, convert, write_layout
from fiber_formats.errors import FormatError
from fiber_formats.formats import FORMATS
from fiber_formats.interface import Format
from fiber_formats.problems import DEFAULT_PRESET, FoundProblem, problem_from
from fiber_formats.reading import (
    find_format,
    read_layout,
    read_obstacles,
    read_starts,
    read_targets,
)
from fiber_formats.records import (
    Layout,
    LayoutColumns,
    StartColumns,
    Starts,
    TargetColumns,
    Targets,
)
from fiber_formats.result_forms import FORMS
from fiber_formats.results import (
    Results,
    check_results,
    read_results,
    results_of,
    write_results,
)
from fiber_formats.source import DataFile, Source
from fiber_formats.writing import kind_of, write_table

__all__ = [
    "Columns",
    "read_columns",
    "write_layout",
    "write_table",
    "DEFAULT_PRESET",
    "FORMATS",
    "FORMS",
    "KINDS",
    "DataFile",
    "Format",
    "FormatError",
    "FoundProblem",
    "Layout",
    "LayoutColumns",
    "Results",
    "Source",
    "StartColumns",
    "Starts",
    "TargetColumns",
    "Targets",
    "check_results",
    "convert",
    "find_format",
    "kind_of",
    "problem_from",
    "read_layout",
    "read_obstacles",
    "read_results",
    "read_starts",
    "read_targets",
    "results_of",
    "write_results",
]
