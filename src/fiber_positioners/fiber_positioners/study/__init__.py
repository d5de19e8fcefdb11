# SPDX-License-Identifier: Apache-2.0
"""Studies: reconfigurations over a grid of instrument parameters, with several draws each."""

from fiber_positioners.study.cases import Case, Row, grid, study_rows
from fiber_positioners.study.figure import save_figure, study_figure
from fiber_positioners.study.results import (
    FIGURES,
    RowFile,
    Spread,
    Summary,
    save_study,
    study_table,
    summarize,
)

__all__ = [
    "FIGURES",
    "Case",
    "Row",
    "RowFile",
    "Spread",
    "Summary",
    "grid",
    "save_figure",
    "save_study",
    "study_figure",
    "study_rows",
    "study_table",
    "summarize",
]
