# SPDX-License-Identifier: Apache-2.0
"""The scripts of the page, run by Node, agree with Python at random robots and times."""

import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fiber_viewer
from fiber_core import kinematics
from fiber_core.clearance import gaps, neighbour_pairs
from fiber_core.corridor import JointCorridors
from fiber_core.presets import preset
from fiber_recording import load_recording, save_recording
from fiber_viewer.page import CONSOLE_SCRIPTS, SCRIPTS, script

PLAYER = Path(fiber_viewer.__file__).parent / "player"
DRAWS = 300
# a recording of version 1, of a plane with polygons
OUTLINES = Path(__file__).parents[2] / "fiber_recording/test/data/recording-1.npz"


def drawn_times(recording, rng):
    """Times before, during and after the motion, and the end of every segment."""
    motion = recording.executed
    ends = [motion.duration_s[a:b].sum() for a, b in zip(motion.offsets[:-1], motion.offsets[1:])]
    # with stops and rests, sums differ in the last digit
    ends = np.array(ends) + (1e-9 if len(recording.phases) > 1 else 0.0)
    return np.concatenate([rng.uniform(-0.2, 1.1 * motion.makespan_s, DRAWS), ends, [0.0]])


@pytest.mark.parametrize("name", ["recording", "resumed"])
def test_angles_velocities_and_segments_are_those_of_the_motion(node, request, name):
    recording, recording_file = (request.getfixturevalue(n) for n in (name, f"{name}_file"))
    rng = np.random.default_rng(3)
    times = drawn_times(recording, rng)
    profiles = rng.integers(0, 2 * recording.executed.n, len(times))
    answer = node(
        recording_file,
        """
        const { motion } = recording, { angleAt, segmentAt, velocityAt } = kinematics;
        const functions = [angleAt, velocityAt, segmentAt];
        answer = inputs.times.map((t, i) => functions.map((f) => f(motion, inputs.profiles[i], t)));
        """,
        times=times.tolist(),
        profiles=profiles.tolist(),
    )
    motion = recording.executed
    angle, speed, segment = np.array(answer).T
    np.testing.assert_allclose(
        angle, [motion(t).ravel()[p] for t, p in zip(times, profiles)], rtol=0, atol=1e-9
    )
    np.testing.assert_allclose(
        speed, [motion.velocity(t).ravel()[p] for t, p in zip(times, profiles)], atol=1e-9
    )
    for t, p, k in zip(times, profiles, segment.astype(int)):
        lasts = motion.duration_s[slice(*motion.offsets[p : p + 2])]
        begins = np.concatenate([[0.0], np.cumsum(lasts)])
        inside = 0 <= t < begins[-1]
        assert (k >= 0) == inside
        if inside:
            at = k - motion.offsets[p]
            assert begins[at] <= t + 1e-12 and t <= begins[at + 1] + 1e-12


@pytest.mark.parametrize("file", ["capsules", "outlines"])
def test_elbows_tips_and_outlines_agree_with_the_kinematics(node, recording_file, file):
    path = recording_file if file == "capsules" else OUTLINES
    plane = load_recording(path).problem.plane
    rng = np.random.default_rng(4)
    angles = rng.uniform(-4, 4, (plane.n, 2))
    places, hulls = node(
        path,
        """
        const { plane } = recording, n = plane.n;
        const angles = Float64Array.from(inputs.angles.flat());
        answer = [
          Array.from(kinematics.placesOfAll(plane, angles, new Float64Array(4 * n))),
          inputs.angles.map((both, row) => kinematics.outlinesOf(plane, row, ...both)
            .map((hull) => [Array.from(hull.points), hull.radius])),
        ];
        """,
        angles=angles.tolist(),
    )
    elbow, tip = kinematics.forward(plane, angles)
    np.testing.assert_allclose(np.reshape(places, (-1, 4)), np.hstack([elbow, tip]), atol=1e-9)
    assert all(len(links) == 1 + bool(plane.theta_vertices.shape[1]) for links in hulls)
    for row, links in enumerate(hulls):
        for (points, radius), vertices, origin, turn, rounding in zip(
            links,
            (plane.phi_vertices[row], plane.theta_vertices[row]),
            (elbow[row], plane.centers[row]),
            (angles[row].sum(), angles[row, 0]),
            (plane.phi_radius[row], plane.theta_radius[row]),
        ):
            c, s = np.cos(turn), np.sin(turn)
            placed = origin + vertices @ np.array([[c, s], [-s, c]])
            np.testing.assert_allclose(np.reshape(points, (-1, 2)), placed, atol=1e-9)
            assert radius == pytest.approx(rounding)


@pytest.mark.parametrize("file", ["capsules", "outlines"])
def test_gaps_are_those_of_the_core(node, recording_file, file):
    path = recording_file if file == "capsules" else OUTLINES
    plane = load_recording(path).problem.plane
    pairs = neighbour_pairs(plane)
    rng = np.random.default_rng(5)
    poses = rng.uniform(-4, 4, (12, plane.n, 2))
    answer = node(
        path,
        """
        const { plane } = recording;
        answer = inputs.poses.flatMap((angles) => {
          const hulls = angles.map((both, row) => kinematics.outlinesOf(plane, row, ...both));
          return inputs.pairs.map(([a, b]) => {
            const { gap, from, to } = clearance.gapBetween(hulls[a], hulls[b]);
            return [gap, Math.hypot(from[0] - to[0], from[1] - to[1])];
          });
        });
        """,
        pairs=pairs.tolist(),
        poses=poses.tolist(),
    )
    gap, drawn = np.array(answer).T
    exact = np.maximum(np.concatenate([gaps(plane, pairs, angles) for angles in poses]), 0.0)
    assert (exact == 0).any() and (exact > 0).any()
    np.testing.assert_allclose(gap, exact, atol=1e-7)
    apart = exact > 0
    np.testing.assert_allclose(drawn[apart], exact[apart], atol=1e-7)  # the line drawn is the gap


def test_the_page_reads_all_that_python_wrote(node, recording, recording_file):
    answer = node(
        recording_file,
        """
        const { planned, plane, motion, pairs, events, load } = recording;
        const rows = Array.from(plane.ids.keys()), both = [0, 1];
        const late = rows.map((row) => opened.stateAt(recording, row, 1e9));
        answer = {
          ids: Array.from(plane.ids), makespan: motion.makespan, late,
          planned: Array.from(planned.angles), times: Array.from(planned.times),
          readings: rows.map((row) => both.map((j) => profiles.readings(recording, row, j))),
          nearest: [pairs[0].a, pairs[0].b, pairs[0].gap], kinds: events.map((e) => e.kind),
          reason: opened.reasonOf(recording, inputs.failed), frames: Array.from(load.frames),
          faults: opened.faultsOf(recording).map((f) => [f.row, f.time]),
          texts: events.map((event) => opened.eventText(recording, event)),
          alert: opened.eventText(recording, { kind: "alert", detail: 5 }),
          verdict: headline.verdict(headline.figuresOf(recording)),
        };
        """,
        failed=11,
    )
    plane, quantum = recording.problem.plane, recording.units.quantum_rad
    assert answer["ids"] == plane.ids.tolist()
    assert answer["makespan"] == pytest.approx(recording.executed.makespan_s)
    np.testing.assert_allclose(
        np.reshape(answer["planned"], recording.planned.angles.shape),
        recording.planned.angles,
        atol=0.51e-6,
    )
    for row in range(plane.n):
        chosen = recording.measured.row == row
        for joint in (0, 1):
            time_s, angle = np.reshape(answer["readings"][row][joint], (-1, 2)).T
            np.testing.assert_allclose(time_s, recording.measured.time_us[chosen] * 1e-6)
            counts = recording.measured.counts[chosen, joint]
            exact = recording.units.to_angles(counts)
            # whole numbers are floored once in each of up to five segments
            assert np.abs(np.deg2rad(angle) - exact).max(initial=0) < 6 * quantum
    moving, reached, held, failed, idle, disabled, stopped = range(7)
    states = dict(enumerate(answer["late"]))
    assert (states[5], states[11], states[3], states[20]) == (held, failed, idle, disabled)
    assert Counter(states.values())[reached] == plane.n - 4
    assert answer["nearest"][:2] == recording.approaches.pairs[0].tolist()
    assert answer["kinds"] == ["go", "no_address", "fault"]
    assert answer["texts"] == ["go", "no address", "fault memory"]
    assert answer["alert"] == "alert refused, rebooted"
    assert answer["reason"] == "failed: stalled"
    assert answer["faults"] == [[11, 0.3], [11, 0.4]]
    assert answer["frames"] == recording.load.frames.ravel().tolist()
    assert answer["verdict"] == (
        "33 of 36 robots reached their targets; 1 held, 1 disabled, 1 failed."
    )


def test_states_follow_a_stop_and_resumed_motion(node, resumed, resumed_file):
    first, second = resumed.phases
    stop_s, on_s = 300_300e-6, 455_001e-6
    times = [0.1, 0.2, 0.212, stop_s - 1e-3, stop_s + 1e-3, on_s - 1e-3, on_s + 1e-3, 9.0]
    answer = node(
        resumed_file,
        """
        const { plane, motion } = recording;
        const all = (t) => Array.from(plane.ids, (_, row) => opened.stateAt(recording, row, t));
        answer = {
          states: inputs.times.map(all),
          pauses: phases.pausesOf(motion),
        };
        """,
        times=times,
    )
    states = dict(zip(times, np.array(answer["states"])))
    moving, reached, _, failed, _, _, stopped = range(7)
    np.testing.assert_allclose(answer["pauses"], [[stop_s, on_s]])
    resumes = first.stopped & second.motion.decoded().counts.any(axis=1)
    assert resumes.sum() > 20
    for t, state in zip(times[3:7], (moving, stopped, stopped, moving)):
        assert (states[t][resumes] == state).all(), t
    assert (states[9.0][np.flatnonzero(resumes)[-5:]] == reached).all()
    # one robot stopped by itself, and has the state failed from then on
    assert [states[t][11] for t in times[:5]] == [moving, moving] + 3 * [failed]


@pytest.mark.parametrize("name", ["recording", "resumed"])
def test_the_corridor_is_that_of_the_recording_and_ends_at_a_stop(node, request, name):
    recording, file = (request.getfixturevalue(n) for n in (name, f"{name}_file"))
    corridors, rows = recording.corridors, [0, 7, 11, 30]
    answer = node(
        file,
        """
        const { corridorBand } = profiles;
        answer = inputs.rows.map((row) => [0, 1].map((j) => corridorBand(recording, row, j)));
        """,
        rows=rows,
    )
    first = recording.phases[0]
    for row, joints in zip(rows, answer):
        for joint, band in enumerate(joints):
            time_s, low, high = np.reshape(band, (-1, 3)).T
            until = 1e-6 * first.stop_us[row] if first.stopped[row] else np.inf
            ends = min(until, corridors.lasts_s[row])
            assert time_s[-1] == pytest.approx(ends) and (np.diff(time_s) > 0).all()
            for drawn, bound in ((low, corridors.low), (high, corridors.high)):
                exact = np.interp(time_s, corridors.times_s(row), bound[row, joint])
                np.testing.assert_allclose(np.deg2rad(drawn), exact, atol=1.1e-3)


def test_a_corridor_that_is_closed_at_one_instant_is_open_at_all_others(node, recording, tmp_path):
    sound, row = recording.corridors, 7
    high = sound.high.copy()
    high[row, :, 3] = sound.low[row, :, 3]
    closed = JointCorridors(sound.lasts_s, sound.low, high)
    file = tmp_path / "closed.npz"
    save_recording(file, replace(recording, corridors=closed))
    answer = node(
        file,
        "answer = [0, 1].map((j) => profiles.corridorBand(recording, inputs.row, j));",
        row=row,
    )
    for band in answer:
        _, low, high = np.reshape(band, (-1, 3)).T
        assert (low <= high).all()
        assert np.flatnonzero(low == high).tolist() == [3]


def test_the_closest_approach_is_one_of_six_moments_inside_the_motion(node, recording_file):
    cases = [(0.0, 2.0), (0.04, 0.8), (1.0, 2.0), (2.0, 2.0), (0.0, 0.0)]
    answer = node(
        recording_file,
        "answer = inputs.cases.map(([t, ends]) => neighbourhood.momentsAround(t, ends));",
        cases=cases,
    )
    for (time, ends), moments in zip(cases, answer):
        assert len(moments) == 6 and time in moments
        assert min(moments) >= 0 and max(moments) <= max(ends, 1e-3) + 1e-9
        assert moments == sorted(moments)


def test_an_address_has_time_robots_and_panel(node, recording_file):
    answer = node(
        recording_file,
        """
        const there = address.toAddress({ t: 1.25, ids: [12, 40], panel: 2 });
        answer = [there, address.readAddress(there), address.readAddress("#t=x&robots=a,7&what=1")];
        """,
    )
    assert answer[0] == "#t=1.2500&robots=12,40&panel=2"
    assert answer[1] == {"t": 1.25, "panel": 2, "robots": [12, 40], "theme": None, "color": None}
    assert answer[2] == {"t": None, "panel": None, "robots": [7], "theme": None, "color": None}


@pytest.mark.parametrize(
    ("version", "message"), [(99, "newer than this page"), (2, None)], ids=["newer", "this"]
)
def test_a_newer_recording_is_refused_by_the_page(node, recording_file, tmp_path, version, message):
    data = dict(np.load(recording_file))
    about = json.loads(bytes(data["about"])) | {"version": version}
    data["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez_compressed(tmp_path / "other.npz", **data)
    path = json.dumps(str(tmp_path / "other.npz"))
    answer = node(
        recording_file,
        f"""
        answer = await opened.openRecording(new Uint8Array(fs.readFileSync({path})))
          .then(() => null, (error) => error.message);
        """,
    )
    assert (answer is None) if message is None else (message in answer)


def test_the_modules_make_one_script():
    every = set(SCRIPTS) | set(CONSOLE_SCRIPTS)
    assert every == {path.stem for path in PLAYER.glob("*.js")}
    for scripts in (SCRIPTS, CONSOLE_SCRIPTS):
        _check_joined(script(scripts))


def _check_joined(text):
    assert not re.search(r"^(import|export)\b", text, re.MULTILINE)
    # joined end to end, all modules share their top-level names
    names = re.findall(r"^(?:async )?(?:const|let|class|function) (\w+)", text, re.MULTILINE)
    assert not [name for name, count in Counter(names).items() if count > 1]


@pytest.mark.parametrize("path", sorted(PLAYER.glob("*.*")), ids=lambda path: path.name)
def test_a_file_of_the_page_is_short_and_names_no_address(path):
    lines = path.read_text().splitlines()
    assert len(lines) < 400 and max(map(len, lines)) <= 160
    assert not re.search(r"https?://", path.read_text()), "the page makes no request"


def test_presets_with_and_without_theta_outlines_are_both_tested():
    assert load_recording(OUTLINES).problem.plane.theta_vertices.shape[1]
    assert not preset("desi", 3).theta_vertices.shape[1]
