# SPDX-License-Identifier: Apache-2.0
"""Every reason for which a target is refused, one by one, and targets that are accepted."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import (
    PRESETS,
    Reason,
    TargetsError,
    assign,
    forward,
    inverse,
    plane_from,
    preset,
    random_field,
)
from fiber_core.clearance import Safety, gaps, neighbour_pairs

FOLDED = np.pi


def seven(**changes):
    """Robot 10 in the middle, 11..16 around it, all folded."""
    changes = {"spacing_mm": 4.0} | changes
    plane = replace(preset("desi", 7), ids=np.arange(10, 17), **changes)
    return plane, np.tile([0.0, FOLDED], (7, 1))


def at(plane, row, distance, direction_deg=0.0):
    direction = np.deg2rad(direction_deg)
    return plane.centers[row] + distance * np.array([np.cos(direction), np.sin(direction)])


def between(plane, row, other, distance):
    """Return a point at a distance from the centre of one robot towards that of another."""
    way = plane.centers[other] - plane.centers[row]
    return plane.centers[row] + distance * way / np.hypot(*way)


@pytest.mark.parametrize("distance", [0.0, 1e-6, 3.0, 5.999999, 6.0])
def test_the_whole_patrol_region_is_accepted(distance):
    plane, start = seven()
    for direction in range(0, 360, 15):
        accepted = assign(plane, start, [10], [at(plane, 0, distance, direction)])
        assert accepted.reason[0] == Reason.OK, accepted.explain(10)
        assert len(accepted.refused_ids) == 0
        assert np.all(accepted.reason[1:] == Reason.NO_TARGET)
        assert np.isnan(accepted.targets[1:]).all()
        assert np.array_equal(accepted.targets[0], at(plane, 0, distance, direction))


def test_an_unreachable_target_is_explained_with_distance_and_reach():
    plane, start = seven()
    plane = replace(plane, arms=np.tile([3.5, 2.5], (7, 1)))
    asked = np.array([at(plane, 0, 6.5), at(plane, 1, 0.9)])
    refused = assign(plane, start, [10, 11], asked)
    assert np.array_equal(refused.reason[:2], [Reason.UNREACHABLE] * 2)
    assert np.array_equal(refused.refused_ids, [10, 11])
    assert np.isnan(refused.targets).all()
    assert refused.explain(10) == (
        "robot 10: target (6.5, 0) mm is 6.5 mm from its centre, reach 1..6 mm"
    )


def test_a_target_outside_the_joint_range_is_refused_with_the_range():
    plane, start = seven()
    limits = np.array(plane.limits)
    limits[0] = np.deg2rad([[-90.0, 30.0], [0.0, 180.0]])
    plane = replace(plane, limits=limits)
    tips = forward(plane, np.deg2rad([[29.0, 60.0], [31.0, 60.0]])[:, None])[1][:, 0]
    reasons = [assign(plane, start, [10], [tip]).reason[0] for tip in tips]
    assert reasons == [Reason.OK, Reason.OUTSIDE_JOINT_RANGE]
    assert "-90..30" in assign(plane, start, [10], tips[1:]).explain(10)


def test_a_disabled_robot_has_this_reason_before_any_other():
    plane, start = seven(enabled=np.arange(7) != 2)
    refused = assign(plane, start + 100.0, [12], [at(plane, 2, 99.0)])
    assert refused.reason[2] == Reason.DISABLED and "disabled" in refused.explain(12)


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("side", [0, 1])
def test_a_start_outside_the_limits_is_the_reason(joint, side):
    plane, start = seven()
    for beyond, reason in ((1e-6, Reason.OK), (1e-3, Reason.START_OUTSIDE_LIMITS)):
        start[3, joint] = plane.limits[3, joint, side] + (beyond if side else -beyond)
        found = assign(plane, start, [13], [at(plane, 3, 3.0)])
        assert found.reason[3] == reason, found.explain(13)


def test_of_two_close_targets_the_lower_id_keeps_its_own():
    plane, start = seven()
    pair = [between(plane, 0, 1, 4.0), between(plane, 1, 0, 4.0)]  # 2.4 mm apart
    for order in ([0, 1], [1, 0]):
        found = assign(plane, start, np.array([10, 11])[order], np.array(pair)[order])
        assert np.array_equal(found.reason[:2], [Reason.OK, Reason.TARGET_TOO_CLOSE])
    assert "is 2.4 mm from the target of robot 10, spacing 4 mm" in found.explain(11)


def test_presets_with_whole_outlines_accept_targets_at_any_distance():
    for name in PRESETS:
        plane = preset(name, 7)
        start = np.tile([0.0, FOLDED], (7, 1))
        pair = [between(plane, 0, 1, 4.0), between(plane, 1, 0, 0.9 * plane.arms[1].sum())]
        pair[1] = pair[0] + [0.0, 0.5 * plane.envelope_mm]
        expected = Reason.TARGET_TOO_CLOSE if name == "paper" else Reason.OK
        others = np.array([0, 1])
        if not inverse(plane, np.resize(pair, (7, 2)))[1][others].any(axis=1).all():
            continue
        assert assign(plane, start, others, pair).reason[1] == expected, name
        asked = assign(plane, start, others, pair, spacing_mm=plane.envelope_mm)
        assert asked.reason[1] == Reason.TARGET_TOO_CLOSE
        assert f"spacing {plane.envelope_mm:.4g} mm" in asked.explain(1)


@pytest.mark.parametrize("short_mm, reason", [(0.0, Reason.OK), (1e-6, Reason.TARGET_TOO_CLOSE)])
def test_targets_exactly_at_the_spacing_are_allowed(short_mm, reason):
    plane, start = seven()
    for other in range(1, 7):  # with any rounding of the direction
        asked = [between(plane, 0, other, 3.2 + short_mm), between(plane, other, 0, 3.2)]
        assert assign(plane, start, [10, 10 + other], asked).reason[other] == reason


def test_a_refused_target_does_not_block_other_targets():
    # 10 blocks 11 and 11 blocks 12: if 11 is refused, 12 is accepted; if 10 is refused for
    # another reason, 11 is accepted.
    plane = plane_from(
        PRESETS["desi"], [10, 11, 12], [[0, 0], [10.4, 0], [20.8, 0]], spacing_mm=4.0
    )
    start = np.tile([0.0, FOLDED], (3, 1))
    asked = np.array([[5.0, 0.0], [8.0, 0.0], [11.5, 0.0]])
    plane = replace(plane, arms=np.array([[3.0, 3.0], [3.0, 3.0], [5.0, 5.0]]))
    found = assign(plane, start, plane.ids, asked)
    assert found.reason.tolist() == [Reason.OK, Reason.TARGET_TOO_CLOSE, Reason.OK]
    found = assign(plane.with_enabled([False, True, True]), start, plane.ids, asked)
    assert found.reason.tolist() == [Reason.DISABLED, Reason.OK, Reason.TARGET_TOO_CLOSE]


def test_a_target_on_a_disc_is_refused_and_the_disc_named():
    plane, start = seven()
    plane = replace(plane, obstacles=np.array([[99.0, 0.0, 1.0], [4.5, 0.0, 0.5]]))
    found = assign(plane, start, [10], [[4.5, 0.0]])
    assert found.reason[0] == Reason.TARGET_ON_OBSTACLE
    assert "obstacle 1" in found.explain(10)
    assert assign(plane, start, [10], [[-4.5, 0.0]]).reason[0] == Reason.OK


def test_one_free_elbow_is_enough():
    plane, start = seven()
    limits = np.array(plane.limits)
    limits[:, 1] = [-np.pi, np.pi]
    plane, tip = replace(plane, limits=limits), np.array([3.2, 0.0])
    angles, valid = inverse(plane, np.vstack([tip, np.full((6, 2), np.nan)]))
    elbow_up = angles[0][valid[0] & (angles[0, :, 1] < 0)][0]
    middle = 0.5 * (forward(plane, np.tile(elbow_up, (7, 1)))[0][0] + tip)  # of its second arm
    plane = replace(plane, obstacles=np.array([[*middle, 0.2]]))
    assert assign(plane, start, [10], [tip]).reason[0] == Reason.OK
    mirrored = np.array([[*middle, 0.2], [middle[0], -middle[1], 0.2]])
    plane = replace(plane, obstacles=mirrored)
    assert assign(plane, start, [10], [tip]).reason[0] == Reason.TARGET_ON_OBSTACLE


@pytest.mark.parametrize("why", ["disabled", "outside limits"])
def test_a_target_on_a_robot_that_cannot_move_is_refused(why):
    plane, start = seven()
    towards = np.arctan2(*(plane.centers[0] - plane.centers[1])[::-1])
    start[1] = [towards, 0.0]  # robot 11 stretched towards 10
    asked = [between(plane, 0, 1, 5.5)]
    assert assign(plane, start, [10], asked).reason[0] == Reason.OK
    if why == "disabled":
        plane = plane.with_enabled(np.arange(7) != 1)
    else:
        start[1, 1] = -0.1
    found = assign(plane, start, [10], asked)
    assert found.reason[0] == Reason.TARGET_ON_OBSTACLE
    assert "robot 11, which cannot move" in found.explain(10)


def test_a_target_near_an_obstacle_is_refused_only_within_the_margin():
    plane, start = seven()
    limits = np.array(plane.limits)
    limits[:, 1] = 0.0  # always stretched: one configuration for each target
    plane = replace(plane, limits=limits, phi_radius=np.full(7, 0.5))
    start[:, 1] = 0.0
    gap = 0.2
    plane = replace(plane, obstacles=np.array([[6.0 + 0.5 + gap + 1.0, 0.0, 1.0]]))
    for margin, reason in (
        (gap - 1e-6, Reason.OK),
        (gap + 1e-6, Reason.TARGET_ON_OBSTACLE),
        (None, Reason.OK),
    ):
        assert assign(plane, start, [10], [[6.0, 0.0]], margin_mm=margin).reason[0] == reason
    closer = Safety().margin_mm - 1e-6
    plane = replace(plane, obstacles=np.array([[6.0 + 0.5 + closer + 1.0, 0.0, 1.0]]))
    assert assign(plane, start, [10], [[6.0, 0.0]]).reason[0] == Reason.TARGET_ON_OBSTACLE


@pytest.mark.parametrize("name", PRESETS)
def test_reasons_agree_with_a_slow_implementation_of_their_definition(name):
    rng = np.random.default_rng(8)
    plane = preset(name, 120).with_enabled(rng.random(120) < 0.8)
    plane = replace(plane, spacing_mm=plane.envelope_mm)
    field = random_field(plane, rng)
    reach = plane.arms.sum(axis=1, keepdims=True)
    radius = reach * np.sqrt(rng.uniform(0.0, 1.1, (120, 1)))
    angle = rng.uniform(0, 2 * np.pi, 120)
    asked = plane.centers + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    start = field.problem.start
    found = assign(plane, start, plane.ids, asked)
    angles, valid = inverse(plane, asked)
    pairs = neighbour_pairs(plane)
    moves = np.append(plane.enabled, np.zeros(plane.fixtures, dtype=bool))
    taken = []
    for row in range(120):
        if not plane.enabled[row]:
            expected = Reason.DISABLED
        elif not valid[row].any():
            distance = np.hypot(*(asked[row] - plane.centers[row]))
            inside = abs(np.diff(plane.arms[row])) <= distance <= reach[row]
            expected = Reason.OUTSIDE_JOINT_RANGE if inside else Reason.UNREACHABLE
        else:
            expected = Reason.TARGET_ON_OBSTACLE
            mine = pairs[(pairs == row).any(axis=1)]
            mine = mine[~moves[mine.sum(axis=1) - row]]
            for solution in angles[row][valid[row]]:
                pose = np.array(start)
                pose[row] = solution
                if np.all(gaps(plane, mine, pose) >= Safety().margin_mm):
                    expected = Reason.OK
            if expected == Reason.OK and any(
                np.hypot(*(asked[row] - asked[other])) < plane.spacing_mm for other in taken
            ):
                expected = Reason.TARGET_TOO_CLOSE
            elif expected == Reason.OK:
                taken.append(row)
        assert found.reason[row] == expected, found.explain(row)
    assert len(set(found.reason.tolist())) >= 4


@pytest.mark.parametrize(
    "ids, xy_mm, reason, named",
    [
        ([10, 99], [[0, 3], [0, 4]], Reason.UNKNOWN_ROBOT, [99]),
        ([10, 9, -4], [[0, 3], [0, 4], [0, 5]], Reason.UNKNOWN_ROBOT, [9, -4]),
        ([10, 11, 10], [[0, 3], [10, 0], [0, 3]], Reason.DUPLICATE, [10, 10]),
        ([10, 11], [[0, 3], [np.nan, 4]], Reason.NOT_FINITE, [11]),
        ([10, 11], [[np.inf, 3], [0, -np.inf]], Reason.NOT_FINITE, [10, 11]),
    ],
)
def test_a_malformed_table_is_refused_whole_and_names_robot_and_value(ids, xy_mm, reason, named):
    plane, start = seven()
    with pytest.raises(TargetsError) as refusal:
        assign(plane, start, ids, xy_mm)
    assert refusal.value.ids.tolist() == named
    assert refusal.value.reasons.tolist() == [reason] * len(named)
    for robot in named:
        row = ids.index(robot)
        value = str(np.array(xy_mm, dtype=float)[row].tolist())
        assert f"robot {robot}" in str(refusal.value) and value in str(refusal.value)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"xy_mm": [[0.0, 3.0]] * 2}, ["targets", "(2, 2)", "(1, 2)"]),
        ({"xy_mm": [0.0, 3.0]}, ["targets", "(2,)"]),
        ({"xy_mm": [["a", "b"]]}, ["targets"]),
        ({"ids": [[10]]}, ["ids", "(1, 1)"]),
        ({"ids": [10.5]}, ["ids", "10.5"]),
        ({"start": np.zeros((6, 2))}, ["start", "(6, 2)"]),
        ({"start": np.full((7, 2), np.nan)}, ["robot 10", "start angles", "nan"]),
    ],
)
def test_wrong_shapes_are_refused(changes, words):
    plane, start = seven()
    with pytest.raises(TargetsError) as refusal:
        assign(plane, **{"start": start, "ids": [10], "xy_mm": [[0.0, 3.0]], **changes})
    assert all(word in str(refusal.value) for word in words), str(refusal.value)


def test_a_long_list_of_unknown_robots_is_cut_short():
    plane, start = seven()
    with pytest.raises(TargetsError) as refusal:
        assign(plane, start, np.arange(100, 125), np.zeros((25, 2)))
    assert str(refusal.value).count("robot 1") == 10 and "15 more" in str(refusal.value)
    assert len(refusal.value.ids) == 25


def test_no_targets_are_a_valid_assignment():
    plane, start = seven()
    found = assign(plane, start, [], np.zeros((0, 2)))
    assert np.all(found.reason == Reason.NO_TARGET) and not found.accepted.any()
    assert found.explain(10) == "robot 10: no target"
    assert found.explain(77) == "robot 77 does not exist"
