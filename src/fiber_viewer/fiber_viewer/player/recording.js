// SPDX-License-Identifier: Apache-2.0
// Opens a recording: from the bytes of the file to typed arrays. docs/recording.md describes the file.
import { readNpz } from "./npz.js";
import { motionOf } from "./phases.js";

const NEWEST_VERSION = 2;
const MICRORADIAN = 1e-6, MILLIRADIAN = 1e-3;
const MOST_NAMED = 3; // of robots that fail together on a bus: more are one entry

// The state of a robot at a time.
export const MOVING = 0, REACHED = 1, HELD = 2, FAILED = 3, IDLE = 4, DISABLED = 5, STOPPED = 6;
export const WAITING = 7; // of a running plane: a robot with a target that is not there yet and does not move
export const STATE_NAMES = ["moving", "reached", "held", "failed", "no target", "disabled", "stopped", "waiting"];

/** Returns a recording from the bytes of its file. Throws an Error if they are not a recording. */
export async function openRecording(bytes) {
  const arrays = await readNpz(bytes);
  if (!arrays.about) throw new Error("this file is not a recording");
  const about = JSON.parse(new TextDecoder().decode(arrays.about.data));
  if (about.format !== "fiber recording") throw new Error("this file is not a recording");
  if (about.version > NEWEST_VERSION) {
    throw new Error(`the recording has version ${about.version}, newer than this page, which reads up to ${NEWEST_VERSION}`);
  }
  const plane = planeOf(arrays);
  const motion = motionOf(arrays, about.units);
  const recording = {
    about,
    plane,
    motion,
    planned: plannedOf(arrays),
    corridors: corridorsOf(arrays),
    measured: measuredOf(arrays, about.units, plane.n),
    load: loadOf(arrays, about),
    events: eventsOf(arrays, about),
    pairs: pairsOf(arrays, plane.n),
    started: arrays.started.data,
    outcome: arrays.outcome.data,
    reason: arrays.reason.data,
    error: arrays.error_mm.data,
    images: imagesOf(arrays, about, plane.n),
    motors: motorsOf(arrays),
  };
  const late = recording.events.at(-1)?.time ?? 0;
  recording.end = Math.max(motion.makespan, late, 1e-3);
  recording.begin = Math.max(Math.min(0, recording.load.begin), -0.25 * recording.end);
  return recording;
}

/** Returns the plane and the targets in the arrays of a recording or a problem file. */
export function planeOf(arrays) {
  const outline = (name, radius) => ({
    count: arrays[name].shape[1],
    vertices: arrays[name].data,
    radius: arrays[radius].data,
  });
  const ids = arrays.id.data;
  return {
    n: ids.length,
    ids,
    rowOf: new Map(Array.from(ids, (id, row) => [id, row])),
    center: arrays.center_mm.data,
    arm: arrays.arm_mm.data,
    target: arrays.target_mm.data,
    enabled: arrays.enabled.data,
    limits: arrays.limits_rad.data,
    speeds: arrays.speed_rad_s.data,
    bus: arrays.bus.data,
    sector: arrays.sector?.data ?? null, // null: there is one
    discs: arrays.disc_mm.data,
    walls: wallsOf(arrays.wall_mm),
    phi: outline("phi_outline_mm", "radius_mm"),
    theta: outline("theta_outline_mm", "theta_radius_mm"),
  };
}

// Walls: corners x, y, x, y, ... of each fixed polygon [mm]; older recordings have none.
function wallsOf(array) {
  if (!array) return [];
  const size = 2 * array.shape[1];
  return Array.from({ length: array.shape[0] }, (_, k) => array.data.slice(k * size, (k + 1) * size));
}

// The planner's trajectory: angle k of profile p is angles[p * times.length + k].
function plannedOf(arrays) {
  if (!arrays.planned_time_s) return null;
  const times = arrays.planned_time_s.data, steps = arrays.planned_step_urad.data;
  const angles = new Float64Array(steps.length);
  for (let at = 0, sum = 0; at < steps.length; at++) {
    sum = at % times.length === 0 ? steps[at] : sum + steps[at];
    angles[at] = sum * MICRORADIAN;
  }
  return { times, angles };
}

// Corridors: joint j of a robot must stay between low[(2 row + j) count + k] and high[...] at
// instant k of `count` equally spaced instants; the last instant is at lasts[row].
function corridorsOf(arrays) {
  if (!arrays.margin_lasts_s) return null;
  const steps = arrays.margin_step_mrad.data, count = arrays.margin_step_mrad.shape[3];
  const low = new Float64Array(steps.length / 2), high = new Float64Array(steps.length / 2);
  for (let bound = 0; bound < steps.length / count; bound++) {
    const to = bound % 2 ? high : low, at = (bound >> 1) * count;
    for (let k = 0, sum = 0; k < count; k++) to[at + k] = (sum += steps[bound * count + k]) * MILLIRADIAN;
  }
  // rounding inwards can put the low bound above the high one: then the corridor is one angle
  low.forEach((bound, at) => { low[at] = Math.min(bound, high[at]); });
  return { count, low, high, lasts: arrays.margin_lasts_s.data };
}

// Encoder readings by robot: the readings of a row are order[offsets[row] .. offsets[row + 1]].
function measuredOf(arrays, units, n) {
  const row = arrays.measured_row.data, off = arrays.measured_off_counts.data;
  const time = new Float64Array(row.length);
  let sum = 0;
  arrays.measured_step_us.data.forEach((step, i) => { time[i] = (sum += step) * 1e-6; });
  const offsets = new Int32Array(n + 1), order = new Int32Array(row.length);
  for (const r of row) offsets[r + 1]++;
  for (let r = 0; r < n; r++) offsets[r + 1] += offsets[r];
  const next = offsets.slice();
  row.forEach((r, i) => { order[next[r]++] = i; });
  return { offsets, order, time, off, quantum: units.quantum_prad * 1e-12 };
}

function loadOf(arrays, about) {
  const [buses, bins] = arrays.bus_frames.shape;
  return {
    ids: arrays.bus_id.data, buses, bins,
    begin: about.bus_begin_s, bin: about.bus_bin_s,
    frames: arrays.bus_frames.data, bytes: arrays.bus_bytes.data,
  };
}

function eventsOf(arrays, about) {
  const kind = arrays.event_kind.data, names = about.names.event;
  return Array.from(arrays.event_time_s.data, (time, i) => ({
    time,
    kind: names[kind[i]],
    bus: arrays.event_bus.data[i],
    row: arrays.event_row.data[i],
    detail: arrays.event_detail.data[i],
    unexpected: !["go", "stop"].includes(names[kind[i]]),
  }));
}

// Pairs of neighbours by their smallest gap, closest first; pairs with a disc have b >= n.
function pairsOf(arrays) {
  const rows = arrays.pair_row.data;
  return Array.from(arrays.pair_gap_mm.data, (gap, i) => ({
    a: rows[2 * i], b: rows[2 * i + 1], gap, time: arrays.pair_time_s.data[i],
  }));
}

// Robots that did not move take no part in corrections; what they and those off their models are told
// to be is shown in later images too.
const STILL = ["not_moved", "theta_not_moved", "phi_not_moved"], LASTING = [...STILL, "off_model"];

// Images of a camera: place x of robot `row` in image k is places[k][2 * row]; null without a camera.
function imagesOf(arrays, about, n) {
  if (!arrays.image_place_mm) return null;
  const count = arrays.image_place_mm.shape[0];
  const split = (array, width) => array && Array.from({ length: count }, (_, k) => array.data.subarray(k * n * width, (k + 1) * n * width));
  const { verdict: names } = about.names, verdicts = split(arrays.image_verdict, 1);
  const stays = (code) => STILL.includes(names[code]);
  for (let k = 1; k < count; k++) {
    verdicts[k] = verdicts[k].map((code, row) => {
      const before = verdicts[k - 1][row], lasts = code === 0 ? LASTING.includes(names[before]) : stays(before) && !stays(code);
      return lasts ? before : code;
    });
  }
  return { count, places: split(arrays.image_place_mm, 2), truths: split(arrays.image_true_mm, 2) ?? null, verdicts, names, stays };
}

// Motors of each power supply that turn at once, in bins; null for a plane without a cap on them.
function motorsOf(arrays) {
  if (!arrays.supply_turning) return null;
  const [supplies, bins] = arrays.supply_turning.shape;
  return {
    ids: arrays.supply_id.data, all: arrays.supply_motors.data, turning: arrays.supply_turning.data,
    supplies, bins, bin: arrays.supply_bin_s.data[0], cap: arrays.motors_on.data[0],
  };
}

/** Returns the state of a robot at a time; a running plane has states of its own. */
export function stateAt(recording, row, t) {
  if (recording.states) return recording.states[row];
  const { plane, motion, started, outcome } = recording;
  if (!plane.enabled[row]) return DISABLED;
  if (started[row]) {
    const { active, phases } = motion, n = plane.n;
    for (let phase = 0, hasMoved = false; phase < phases.length; phase++) {
      const ends = active.ends[phase * n + row];
      if (Number.isNaN(ends)) continue; // not in this phase
      if (hasMoved && t < phases[phase].begin) return STOPPED;
      if (t < ends) return MOVING;
      hasMoved = true;
    }
  }
  if (outcome[row] === 0) return REACHED;
  if (outcome[row] === 2) return FAILED;
  return isAsked(plane, row) ? HELD : IDLE;
}

/** Returns whether a robot was given a target. */
export function isAsked({ target }, row) {
  return Number.isFinite(target[2 * row]);
}

/** Returns outcome and reason of a robot, in words. */
export function reasonOf(recording, row) {
  const { names } = recording.about;
  const word = (name) => (name ?? "unknown").replaceAll("_", " ");
  const outcome = word(names.outcome[recording.outcome[row]]);
  const name = names.reason[recording.reason[row]];
  const reason = name === "bus_failed" ? `bus ${recording.plane.bus[row]} failed` : word(name);
  return reason === "ok" ? outcome : `${outcome}: ${reason}`;
}

/** Returns the name of a member of a pair: the id of a robot, or the number of a disc or a wall. */
export function bodyName(recording, body) {
  const { n, ids } = recording.plane;
  if (body < n) return String(ids[body]);
  const number = body - n, discs = recording.plane.discs.length / 3;
  return number < discs ? `disc ${number}` : `wall ${number - discs}`;
}

/** Returns the kind and the detail of an event, in words. */
export function eventText(recording, { kind, detail }) {
  const codes = recording.about.codes ?? {}, word = (name) => name.replaceAll("_", " ");
  if (!detail) return word(kind);
  if (kind === "alert") {
    const flags = Object.entries(codes.alert ?? {}).filter(([flag]) => detail & flag);
    return `alert ${flags.map(([, name]) => word(name)).join(", ") || detail}`;
  }
  return `${word(kind)} ${word(codes[kind]?.[detail] ?? String(detail))}`;
}

/** Returns when all robots were stopped and when robots were resumed: [{time, text}, ...]. */
export function stopsOf(recording) {
  const { motion, plane } = recording, { phases, active } = motion;
  return phases.flatMap(({ begin, stop }, phase) => {
    const ends = active.ends.subarray(phase * plane.n, (phase + 1) * plane.n);
    const moving = ends.reduce((count, end) => count + !Number.isNaN(end), 0);
    const resumed = phase ? [{ time: begin, text: `${moving} robots resumed` }] : [];
    return stop === null ? resumed : [...resumed, { time: stop, text: "all robots stopped" }];
  });
}

/**
 * Returns faults, stops of all robots and resumed motion, [{time, fault}, {time, text}, ...]: in order
 * of time, but a stop after the fault that caused it, of which a bus can tell later.
 */
export function historyOf(recording, faults) {
  const begins = recording.motion.phases.map(({ begin }) => begin);
  const entries = faults.map((fault) => ({ time: fault.time, after: fault.time, rank: 0, fault }));
  for (const { time, text } of stopsOf(recording)) {
    if (begins.includes(time)) {
      entries.push({ time, after: time, rank: 2, text });
      continue;
    }
    const phase = begins.findLastIndex((begin) => begin <= time);
    const ends = begins[phase + 1] ?? Infinity;
    const own = faults.map((fault) => fault.time).filter((at) => at >= begins[phase] && at <= ends);
    entries.push({ time, after: own.length ? Math.max(time, Math.min(...own)) : time, rank: 1, text });
  }
  return entries.sort((a, b) => a.after - b.after || a.rank - b.rank);
}

/** Returns all faults: unexpected events, and robots that failed without one. */
export function faultsOf(recording) {
  const unexpected = recording.events.filter((event) => event.unexpected).map((event) => ({ ...event }));
  const explained = new Set(unexpected.filter(({ kind }) => kind === "fault").map(({ row, time }) => `${row} ${time}`));
  // the alerts that a robot raises with a fault add nothing
  const faults = unexpected.filter(({ kind, row, time }) => kind !== "alert" || !explained.has(`${row} ${time}`));
  for (const fault of faults) fault.time = Math.min(fault.time, ownStop(recording, fault));
  const withEvent = new Set(faults.map((fault) => fault.row));
  const together = new Map(); // robots that failed without an event, by bus, instant and reason
  recording.outcome.forEach((outcome, row) => {
    if (outcome !== 2 || withEvent.has(row)) return;
    const time = lastMotionEnd(recording, row), kind = reasonOf(recording, row), bus = recording.plane.bus[row];
    const key = [bus, time.toFixed(3), kind].join();
    if (!together.has(key)) together.set(key, []);
    together.get(key).push({ time, kind, row, bus });
  });
  for (const group of together.values()) {
    const [{ time, kind, bus }] = group;
    if (group.length > MOST_NAMED) faults.push({ time, kind: `${group.length} robots ${kind}`, row: -1, bus });
    else faults.push(...group);
  }
  return faults.sort((a, b) => a.time - b.time);
}

// When the robot of a fault stopped by itself: earlier than the others that were stopped for it, and
// earlier than the bus told of it. Infinity if it did not.
function ownStop({ motion, plane }, { kind, row, time }) {
  if (kind !== "fault" || row < 0) return Infinity;
  const own = motion.phases.map(({ stop }, phase) => [motion.active.stops[phase * plane.n + row], stop]);
  return own.findLast(([stop, all]) => stop < all && stop < time)?.[0] ?? Infinity;
}

// When the last motion of a robot ended; the end of the recording if it never moved.
function lastMotionEnd({ motion, plane, end }, row) {
  const ends = motion.phases.map((_, phase) => motion.active.ends[phase * plane.n + row]);
  return ends.filter((time) => !Number.isNaN(time)).at(-1) ?? end;
}
