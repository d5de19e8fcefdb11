# SPDX-License-Identifier: Apache-2.0
"""Rehearsals: the plan is run, and robots that were called to give way make way from the start.

A blocked pair shows itself only when it presses: the typical late robot is at its goal early,
lies across the way of a robot that comes by a second later, has to fold while that one waits,
and only then returns. A rehearsal shows all of that beforehand. Robots that call each other,
directly or through others, form a site; a site is late if one of its robots arrives after LATE
times the slowest robot alone. Each rehearsal tries another remedy on all late sites at once:

    FOLD    each robot that was called before it called waits folded
    START   the same robots wait at their starts
    LATER   robots called after their wait wait longer; robots called newly wait folded
    CALLER  the robots that called first wait folded, the ones that they called do not

FOLD and START change the first run, LATER and CALLER by turns what served the site best. A wait
ends soon after the call, and early enough that a robot that nothing hinders arrives no later
than the slowest robot alone. The last rehearsal gives each site the waits of the run in which
its last robot arrived first. Sites hardly feel each other, so all are improved side by side.

Every run is one of the control law with the same rules, and only the waits differ: the proofs of
tip_repulsion.py and arm_repulsion.py hold for each. The best one is the plan, the first one of
equals, so waits are never worse than none.
"""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fiber_core.array_types import Floats, Ints, Mask
from fiber_planner.dnf.priority import Run, Waits
from fiber_planner.interface import ProgressCallback

__all__ = ["LATE", "Rehearsals"]

LATE = 1.02  # times the slowest robot alone

_FOLD, _START, _LATER, _CALLER, _BEST = range(5)


class Rehearsals:
    """The runs made so far, and the waits that the next one tries.

    Args:
        alone_s: time that each robot needs from start to goal if it is alone [s], shape (n,).
        folding_s: time that each needs from the folded arm to its goal [s], shape (n,).
        patience_s: time by which a wait is prolonged beyond a call [s].
        yield_s: time that a robot waits after the call that a rehearsal showed [s].
        dt: time step, the least wait [s].
        remedies: how many remedies are tried; none if 0.
    """

    def __init__(
        self,
        alone_s: Floats,
        folding_s: Floats,
        patience_s: float,
        yield_s: float,
        dt: float,
        remedies: int,
    ):
        self._alone_s, self._folding_s = alone_s, folding_s
        self._dt, self._patience_s, self._yield_s = dt, patience_s, yield_s
        self._slowest_s = float(alone_s.max(initial=0.0))
        by_turns = [_LATER if k % 2 == 0 else _CALLER for k in range(remedies)]
        self._trials = [_FOLD, _START, *by_turns][:remedies] + [_BEST] * (remedies > 0)
        self._runs: list[Run] = []

    def next_waits(self, run: Run) -> Waits | None:
        """Return the waits of the next rehearsal, None if there is nothing more to try.

        Args:
            run: what the rehearsal before it showed.
        """
        self._runs.append(run)
        site = self._sites()
        latest = np.stack([_of_sites(one.arrived_s, site) for one in self._runs])
        best, late = latest.argmin(axis=0), latest.min(axis=0) > LATE * self._slowest_s
        while self._trials:
            waits = self._waits(self._trials.pop(0), site, best, late)
            if not self._is_known(waits):
                return waits
        return None

    def share_of(self, progress: ProgressCallback | None) -> ProgressCallback | None:
        """Return the callback of the next rehearsal, whose work is one part of that of all."""
        if progress is None:
            return None
        made, most = len(self._runs), len(self._runs) + len(self._trials) + 1
        return lambda fraction, text: progress(
            (made + fraction) / most, f"run {made + 1} of {most} at most: {text}"
        )

    def _sites(self) -> Ints:
        # robots that called each other in any run, directly or through others, have one number
        n = len(self._alone_s)
        callers, called = np.concatenate([run.pairs for run in self._runs]).T
        graph = coo_matrix((np.ones(len(callers)), (callers, called)), shape=(n, n))
        return connected_components(graph, directed=False)[1]

    def _is_known(self, waits: Waits) -> bool:
        return any(
            all(np.array_equal(*both) for both in zip(waits, run.waits)) for run in self._runs
        )

    def _waits(self, kind: int, site: Ints, best: Ints, late: Mask) -> Waits:
        # the waits that served each site best, and a remedy for the late ones
        row = np.arange(len(best))
        until = np.stack([run.waits.until_s for run in self._runs])[best, row]
        at_start = np.stack([run.waits.at_start for run in self._runs])[best, row]
        called = np.stack([run.called_s for run in self._runs])[best, row]
        calls = np.stack([run.calls_s for run in self._runs])[best, row]
        if kind in (_FOLD, _START):
            called, calls = self._runs[0].called_s, self._runs[0].calls_s
            until[late] = 0.0
        if kind in (_FOLD, _START, _LATER):
            longer = late & (until > 0.0) & np.isfinite(called)
            new = late & (until == 0.0) & (called < calls)
            until[longer] = called[longer] + self._patience_s
        elif kind == _CALLER:
            new = late & (calls <= called) & np.isfinite(calls)
            until[late & (_of_sites(new, site) > 0.0)] = 0.0
            called = calls
        else:
            return Waits(until, at_start)
        at_start[new] = kind == _START
        way_s = self._alone_s if kind == _START else self._folding_s
        in_time = np.minimum(called + self._yield_s, self._slowest_s - way_s)
        until[new] = np.maximum(in_time, self._dt)[new]
        return Waits(until, at_start & (until > 0.0))


def _of_sites(values: Floats | Mask, site: Ints) -> Floats:
    # the largest value of the robots of each robot's site
    largest = np.zeros(len(site))
    np.maximum.at(largest, site, values)
    return largest[site]
