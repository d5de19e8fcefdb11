# SPDX-License-Identifier: Apache-2.0
"""Why a robot is not simply measured, in words, with the values that an image tells."""

import math
from collections.abc import Iterable

from fiber_core.outcomes import Verdict

__all__ = ["reason_text"]

_WHY = {
    Verdict.DARK: "no light where its fibre may be, in this image and in earlier ones",
    Verdict.MISSING: "no light where its fibre may be",
    Verdict.AMBIGUOUS: "a light that may not be its own",
    Verdict.MERGED: "its light may be two",
    Verdict.NOT_MOVED: "neither joint turned when it was told to",
    Verdict.THETA_NOT_MOVED: "theta did not turn when it was told to",
    Verdict.PHI_NOT_MOVED: "phi did not turn when it was told to",
    Verdict.OFF_MODEL: "its drive does not explain where it is",
    Verdict.UNPLACED: "its place is unknown, or its turn of theta",
    Verdict.UNEXPLAINED: "no light where its fibre may be, and one of no robot in its reach",
}


def reason_text(verdict: int, off_mm: float, doubt: float, others: Iterable[int] = ()) -> str:
    """Return a verdict with what it means and the values that belong to it.

    Args:
        verdict: a Verdict that is not MEASURED.
        off_mm: distance of the fibre from where the counters say [mm], nan without a place.
        doubt: probability that its light is of another robot or a stray one; for ambiguous ones.
        others: ids of the robots that share lights with it; for ambiguous ones.

    Raises:
        KeyError: the verdict is MEASURED, which needs no reason.
    """
    code = Verdict(verdict)
    text = f"{code.name.lower().replace('_', ' ')}: {_WHY[code]}"
    if code == Verdict.AMBIGUOUS:
        text += f", doubt {doubt:.1e}"
        shared = ", ".join(map(str, others))
        if shared:
            text += f", shares lights with {shared}"
    if math.isfinite(off_mm):
        text += f"; {off_mm:.3f} mm from where its counters say"
    return text
