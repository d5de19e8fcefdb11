# SPDX-License-Identifier: Apache-2.0
"""Results as a table: one row for every robot, with outcome, reason, place, error and angles."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core.array_types import Codes, Floats, Ids, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.kinematics import on_target
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_formats.columns import Columns
from fiber_formats.errors import FormatError
from fiber_formats.fibre_map import check_fibres, is_fibre_map, write_fibre_map
from fiber_formats.result_forms import FORMS, PAIRS
from fiber_formats.source import Source
from fiber_formats.writing import check_width, write_table

__all__ = [
    "RESULT_COLUMNS",
    "Results",
    "check_results",
    "read_results",
    "results_of",
    "write_results",
]

RESULT_COLUMNS = (
    "id",
    "outcome",
    "reason",
    "reached_x_mm",
    "reached_y_mm",
    "error_um",
    "theta_deg",
    "phi_deg",
)
_FIBRE = "fibre"  # only of a plane with fibres


@dataclass(frozen=True, eq=False)
class Results:
    """What became of every robot of a plan, one row each, by id.

    Args:
        ids: robot ids, shape (n,).
        outcome: Outcome of each, shape (n,).
        reason: Reason of each, shape (n,).
        reached_mm: where the fibre of each is [mm], shape (n, 2).
        error_um: distance from fibre to target [um], nan without a target, shape (n,).
        angles_deg: joint angles theta, phi [deg], shape (n, 2).
        fibre: name of that fibre, empty on a plane without fibres, shape (n,).
    """

    ids: Ids
    outcome: Codes
    reason: Codes
    reached_mm: Points
    error_um: Floats
    angles_deg: Floats
    fibre: NDArray[np.str_]


def results_of(
    plane: FocalPlane, outcome: PlanOutcome, angles: ArrayLike, targets: ArrayLike | None = None
) -> Results:
    """Return the results of a plan.

    Args:
        plane: the focal plane.
        outcome: outcomes of all robots of the plane, in any order.
        angles: joint angles after the motion [rad], in the order of the plane, shape (n, 2).
        targets: the targets [mm], shape (n, 2), nan = no target; they tell which fibre is on its
            target where that was left open.

    Raises:
        FiberError: a robot of the plane has no outcome.
        FormatError: the angles have another shape.
    """
    final = np.asarray(angles, dtype=float)
    if final.shape != (plane.n, 2):
        raise FormatError(f"angles have shape {final.shape}, expected ({plane.n}, 2)")
    ordered = outcome.of(plane.ids)
    fibre, place, _ = on_target(plane, final, _targets_of(plane, targets))
    return Results(
        plane.ids,
        np.asarray(ordered.outcome, dtype=np.int64),
        np.asarray(ordered.reason, dtype=np.int64),
        place,
        1000 * np.asarray(ordered.error_mm, dtype=float),
        np.rad2deg(final),
        np.array(plane.fibre_names or ("",), dtype=str)[fibre],
    )


def _targets_of(plane: FocalPlane, targets: ArrayLike | None) -> ArrayLike:
    return np.full((plane.n, 2), np.nan) if targets is None else targets


def write_results(
    path: str | os.PathLike[str],
    plane: FocalPlane,
    outcome: PlanOutcome,
    angles: ArrayLike,
    form: str | None = None,
    targets: ArrayLike | None = None,
) -> Results:
    """Write what became of every robot as CSV, ECSV or FITS, by the suffix; return it too.

    Such a table can be read again by `read_results`, and by `read_starts` for the next plan. In the
    form of SDSS-V it can be a confSummary as well, see `write_fibre_map`, which has no outcomes of
    ours.

    Args:
        path: where to; .csv, .ecsv, .fits, or .par in the form `sdss_v`, also with .gz.
        plane: the focal plane.
        outcome: outcomes of all robots.
        angles: joint angles after the motion [rad], in the order of the plane, shape (n, 2).
        form: an instrument, one of `FORMS`, that gets columns in its own form as well.
        targets: as for `results_of`.

    Raises:
        FormatError: the suffix or the form is not known, or the file cannot be written.
        FiberError: a robot of the plane has no outcome.
    """
    check_results(path, form)
    results = results_of(plane, outcome, angles, targets)
    final = np.asarray(angles, dtype=float)
    if is_fibre_map(path):
        fibre = on_target(plane, final, _targets_of(plane, targets)).fibre
        write_fibre_map(path, plane, results.outcome, results.reason, final, fibre)
        return results
    columns: dict[str, NDArray] = {
        "id": results.ids,
        "outcome": np.array([Outcome(code).name.lower() for code in results.outcome], dtype=str),
        "reason": np.array([Reason(code).name.lower() for code in results.reason], dtype=str),
        "reached_x_mm": results.reached_mm[:, 0],
        "reached_y_mm": results.reached_mm[:, 1],
        "error_um": results.error_um,
        "theta_deg": results.angles_deg[:, 0],
        "phi_deg": results.angles_deg[:, 1],
    }
    if plane.fibre_names:
        columns[_FIBRE] = results.fibre
    if form is not None:
        columns.update(
            FORMS[form](
                plane,
                results.outcome,
                results.reason,
                results.reached_mm,
                final,
                results.error_um,
            )
        )
    write_table(path, columns)
    return results


def check_results(
    path: str | os.PathLike[str], form: str | None = None, plane: FocalPlane | None = None
) -> None:
    """Check, before any work, that `write_results` can write to a path in a form.

    Args:
        path: where results will be written.
        form: as for `write_results`.
        plane: the focal plane, if it is known already.

    Raises:
        FormatError: the suffix or the form is not known, they do not go together or not with the
            fibres of the plane, or there is no such folder.
    """
    if form is not None and form not in FORMS:
        raise FormatError(f"no form is named {form!r}; there are {', '.join(FORMS)}")
    if is_fibre_map(path):
        if form != "sdss_v":
            raise FormatError(f"{path}: a .par is a confSummary of SDSS-V, the form is {form}")
        if plane is not None:
            check_fibres(path, plane)
    else:
        check_width(path, PAIRS.get(form or "", ()))
    if not Path(path).parent.is_dir():
        raise FormatError(f"{path} cannot be written: there is no folder {Path(path).parent}")


def read_results(path: str | os.PathLike[str]) -> Results:
    """Read a table that `write_results` wrote.

    Raises:
        FormatError: a column is missing or a value is refused.
    """
    columns = Columns(Source([path]).only.table_with("id", "outcome", "reason"))
    ids = columns.ids("id")
    outcome = _codes(columns, "outcome", Outcome)
    reason = _codes(columns, "reason", Reason)
    reached = [columns.numbers(f"reached_{axis}_mm", "mm") for axis in "xy"]
    error_um = columns.numbers("error_um", "um", missing=True)
    angles = [columns.numbers(name, "deg") for name in ("theta_deg", "phi_deg")]
    fibre = columns.words(_FIBRE) if _FIBRE in columns else np.full(len(ids), "")
    columns.check()
    return Results(
        ids, outcome, reason, np.stack(reached, axis=1), error_um, np.stack(angles, axis=1), fibre
    )


def _codes(columns: Columns, name: str, kind: type[Outcome] | type[Reason]) -> Codes:
    numbers = {member.name.lower(): int(member) for member in kind}
    words = columns.words(name).tolist()
    bad = np.array([word not in numbers for word in words], dtype=bool)
    columns.refuse_rows(bad, name, f"is not one of {', '.join(numbers)}")
    return np.array([numbers.get(word, 0) for word in words], dtype=np.int64)
