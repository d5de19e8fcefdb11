# SPDX-License-Identifier: Apache-2.0
"""Sectors start and stop together, whatever happens to messages, hosts and clocks."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fiber_sectors import Conductor, Member, Stage, Step, Terms
from fiber_sectors.simulation import COORDINATOR, Host, Network, run, violations

TERMS = Terms(gone_s=0.3)
QUICK = {"loads_s": 6e-3, "lasts_s": 40e-3}
APART = [Host(5.0, 50.0), Host(-3.0, -40.0), Host()]  # clocks ahead, behind, and faster


def test_undisturbed_sectors_move_together_to_the_end():
    plane = run(TERMS, APART, Network())
    assert plane.complete == [True] * 3 and not violations(plane) and not plane.why
    skew_s = max(plane.starts_s) - min(plane.starts_s)
    assert skew_s <= plane.bound_s <= TERMS.start_skew_s


def one_lost(number):
    return Network(lambda _, __, each, ___: [] if each == number else [2e-4])


def test_no_single_lost_message_stops_a_plane_or_lets_a_part_of_it_move():
    sent = []
    run(TERMS, APART[:2], Network(lambda _, __, n, ___: sent.append(n) or [2e-4]), **QUICK)
    for number in sorted(set(sent)):
        plane = run(TERMS, APART[:2], one_lost(number), **QUICK)
        assert plane.complete == [True, True] and not violations(plane), number


@pytest.mark.parametrize("victim", [0, COORDINATOR])
@pytest.mark.parametrize("lasts_s", [9e-3, 18e-3, 45e-3, 1.0])
def test_no_burst_of_losses_breaks_a_promise(victim, lasts_s):
    ends = set()
    for begin_s in np.arange(0.0, 0.13, 4e-3):

        def delays_s(_, receiver, __, t, begin_s=begin_s):
            return [] if receiver == victim and begin_s <= t < begin_s + lasts_s else [2e-4]

        plane = run(TERMS, APART[:2], Network(delays_s), **QUICK)
        assert not violations(plane), begin_s
        ends.add(tuple(plane.complete))
    assert (True, True) in ends


def mishap(rng, kind):
    at_s = rng.uniform(0.0, 0.3)
    hosts = [{"ahead_s": rng.uniform(-5, 5), "rate_ppm": rng.uniform(-50, 50)} for _ in range(3)]
    jump_s = float(rng.choice([-1, 1]) * 10 ** rng.uniform(-4, 0))
    hosts[0] |= {
        "jump": {"jump_at_s": at_s, "jump_s": jump_s},
        "killed": {"killed_at_s": at_s},
        "robot fails": {"fails_at_s": at_s},
    }.get(kind, {})
    cut = (1, at_s, at_s + rng.uniform(0.0, 0.3)) if kind == "cut off" else None
    loss, jitter_s = rng.choice([0.0, 0.02, 0.2]), rng.choice([0.0, 3e-4, 3e-3])
    network = Network.bad(rng, loss, jitter_s, 0.1, cut)
    coordinator = Host(killed_at_s=at_s) if kind == "coordinator killed" else Host()
    return [Host(**host) for host in hosts], network, coordinator


KINDS = ["none", "jump", "killed", "robot fails", "cut off", "coordinator killed"]


@pytest.mark.parametrize("kind", KINDS)
def test_random_mishaps_break_no_promise(kind):
    for seed in range(15):
        hosts, network, coordinator = mishap(np.random.default_rng(seed), kind)
        plane = run(TERMS, hosts, network, coordinator)
        found = violations(plane)
        if kind == "coordinator killed":
            found = [each for each in found if "has not ended" not in each]
            assert all(each in (Stage.ENDED, Stage.STOPPED) for each in plane.stages), seed
        assert not found, (seed, plane.why)


def test_the_others_stop_within_10_ms_when_a_robot_fails():
    for at_s in np.linspace(0.1, 0.2, 21):
        hosts = [Host(fails_at_s=at_s), *APART[1:]]
        plane = run(TERMS, hosts, Network())
        assert not violations(plane) and plane.why == "sector 0 has stopped"
        assert max(plane.rests_s) - at_s <= 10e-3 + 2.5e-3  # seen at its next step


def test_a_sector_that_is_cut_off_stops_by_itself_within_its_lease():
    network = Network.bad(np.random.default_rng(0), cut=(1, 0.12, math.inf))
    plane = run(TERMS, APART, network)
    assert not plane.complete[1] and not violations(plane)
    assert plane.rests_s[1] <= 0.12 + TERMS.lease_s * 1.001 + TERMS.notice_s
    assert plane.why == "sector 1 is silent"


TIGHT = Terms(gone_s=0.3, fresh_s=2 * Terms.period_s, lease_s=3 * Terms.period_s)


def lost_just_after_a_step(wakes_at_s, fails_at_s):
    """A robot fails and its host is cut off; the other host is cut off after its last lease.

    Its reports answer beats that came late, so that each lease begins just before its beat.
    """
    last_s = fails_at_s + TIGHT.fresh_s + 1e-4
    late_s = Terms.period_s - 3e-4

    def delays_s(sender, receiver, _, t):
        if (0 in (sender, receiver) and t >= fails_at_s) or (receiver == 1 and t > last_s):
            return []
        return [late_s if receiver == 1 and t > 0.14 else 2e-4]

    hosts = [Host(fails_at_s=fails_at_s), Host(wakes_at_s=wakes_at_s)]
    return run(TIGHT, hosts, Network(delays_s))


def test_a_sector_that_loses_the_network_just_after_a_step_is_within_the_bound():
    late_s = []
    for fails_at_s in 0.15 + np.arange(0.0, TIGHT.period_s, 1e-4):
        for wakes_at_s in np.arange(0.0, 2.5e-3, 2e-4):
            plane = lost_just_after_a_step(wakes_at_s, fails_at_s)
            assert not violations(plane), (wakes_at_s, fails_at_s)
            late_s.append(plane.rests_s[1] - plane.rests_s[0])
    # the bound is no larger than it must be: without the step it is broken
    assert max(late_s) > TIGHT.fresh_s + TIGHT.lease_s + TIGHT.notice_s


def test_a_clock_that_jumps_before_the_start_lets_no_sector_move():
    hosts = [Host(jump_at_s=26e-3, jump_s=5e-3), *APART[1:]]
    plane = run(TERMS, hosts, Network())
    assert np.isnan(plane.starts_s).all() and plane.step is Step.OVER


def test_an_unknown_clock_is_refused():
    slow = Network(lambda *_: [5e-3])  # the offset is known to 5 ms
    plane = run(TERMS, APART, slow, until_s=0.5)
    assert np.isnan(plane.starts_s).all()


def mistakes(monkeypatch, name):
    if name == "move without confirmation":
        monkeypatch.setattr(Conductor, "_confirmed", lambda *_: True)
        monkeypatch.setattr(Conductor, "_look_for_trouble", lambda *_: None)
    elif name == "lease for ever":
        hear = Member.hear

        def forever(member, beat, now_s):
            hear(member, beat, now_s)
            member._lease_s = math.inf if member.lease_s > -math.inf else member.lease_s

        monkeypatch.setattr(Member, "hear", forever)
    elif name == "jump is ignored":
        monkeypatch.setattr(Conductor, "_confirmed", lambda c, k: c.stage(k) is Stage.COUNTING)
        monkeypatch.setattr(Conductor, "_look_for_trouble", lambda *_: None)
        monkeypatch.setattr(Member, "decide", _with_time_back(Member.decide))


def _with_time_back(decide):
    def call(member, now_s):
        member._now_s = -math.inf
        return decide(member, now_s)

    return call


JUMPS = [Host(jump_at_s=at_s, jump_s=5e-3) for at_s in np.arange(20e-3, 30e-3, 0.5e-3)]


@pytest.mark.parametrize(
    ("name", "firsts", "cut"),
    [
        ("move without confirmation", [APART[0]], (1, 22e-3, 0.5)),
        ("lease for ever", [Host(fails_at_s=0.15)], (1, 0.12, math.inf)),
        ("silence is ignored", [Host(killed_at_s=0.12)], None),
        ("jump is ignored", JUMPS, None),
    ],
)
def test_a_planted_mistake_is_found(monkeypatch, name, firsts, cut):
    network = Network.bad(np.random.default_rng(0), cut=cut)
    planes = [run(TERMS, [first, *APART[1:]], network) for first in firsts]
    assert not any(violations(plane) for plane in planes)
    mistakes(monkeypatch, name)
    terms = Terms(gone_s=0.3)
    if name == "silence is ignored":
        object.__setattr__(terms, "fresh_s", 10.0)
    planes = [run(terms, [first, *APART[1:]], network) for first in firsts]
    assert any(violations(replace(plane, terms=TERMS)) for plane in planes)
