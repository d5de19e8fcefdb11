// SPDX-License-Identifier: Apache-2.0
// The colours of robots in panel 1: by state, outcome, bus, sector, speed, arrival, clearance or error.
import { velocityAt } from "./kinematics.js";
import { STATE_NAMES, isAsked, stateAt } from "./recording.js";
import { colors } from "./theme.js";

const BINS = 16; // colours of a scale
const LISTED = 10; // buses that the legend names
const CLIPPED = 0.95; // of the robots are inside the scale, so that a few do not use all of it

/**
 * Returns what robots can be coloured by, by name: {name, groups, groupOf(row, t)} for named groups,
 * {name, unit, value(row, t), range} for scales. NaN is no value.
 */
export function modesOf(recording) {
  const { plane, motion, pairs } = recording;
  const clearance = new Float64Array(plane.n).fill(NaN), arrival = clearance.slice(), error = clearance.slice();
  for (const { a, b, gap } of pairs) {
    for (const body of [a, b]) if (body < plane.n && !(clearance[body] <= gap)) clearance[body] = gap;
  }
  for (let row = 0; row < plane.n; row++) {
    const ends = Math.max(motion.end[2 * row], motion.end[2 * row + 1]);
    if (ends > 0) arrival[row] = ends;
    if (isAsked(plane, row)) error[row] = 1e3 * recording.error[row];
  }
  const scale = (name, unit, values) => ({ name, unit, value: (row) => values[row], range: rangeOfValues(values) });
  return {
    state: stateMode("state now", (row, t) => stateAt(recording, row, t)),
    outcome: stateMode("outcome", (row) => stateAt(recording, row, Infinity)),
    ...placeModes(plane),
    speed: speedMode(plane, (profile, t) => velocityAt(motion, profile, t)),
    arrival: scale("arrival", "s", arrival),
    clearance: scale("least clearance", "mm", clearance),
    error: scale("error at the end", "um", error),
    ...(recording.images && { verdict: verdictMode(recording.images) }),
  };
}

// What the last image tells of each robot.
function verdictMode({ verdicts, names, count }) {
  const codes = Object.keys(names).map(Number), place = new Map(codes.map((code, at) => [code, at]));
  return { name: "camera", groups: codes.map((code) => names[code].replaceAll("_", " ")), groupOf: (row) => place.get(verdicts[count - 1][row]) };
}

export function stateMode(name, groupOf) {
  return { name, groups: STATE_NAMES, groupOf, states: true };
}

/** Returns the modes of what a robot is wired to: its bus, and the sector of a plane that has some. */
export function placeModes({ bus, sector }) {
  return { bus: numberMode("bus", bus), ...(sector && { sector: numberMode("sector", sector) }) };
}

function numberMode(name, numbers) {
  const ids = [...new Set(numbers)].sort((a, b) => a - b), place = new Map(ids.map((id, at) => [id, at]));
  return { name, groups: ids.map((id) => `${name} ${id}`), groupOf: (row) => place.get(numbers[row]) };
}

/** Returns the mode of the present speed: that of the faster joint, as a part of its limit. */
export function speedMode({ speeds }, velocity) {
  const part = (profile, t) => 100 * Math.abs(velocity(profile, t)) / speeds[profile];
  return {
    name: "speed now", unit: "% of the limit", range: [0, 100],
    value: (row, t) => Math.max(part(2 * row, t), part(2 * row + 1, t)) || NaN,
  };
}

// From the smallest value to the one below which nearly all are.
function rangeOfValues(values) {
  const known = values.filter(Number.isFinite).sort();
  if (!known.length) return [0, 1];
  const high = known[Math.min(known.length - 1, Math.floor(CLIPPED * known.length))];
  return [known[0], Math.max(high, known[0] + 1e-9)];
}

export class Coloring {
  constructor(modes) {
    this.modes = modes;
    this.key = "state";
  }

  get mode() {
    return this.modes[this.key];
  }

  /** Chooses what robots are coloured by; an unknown name chooses their state. */
  choose(key) {
    this.key = key in this.modes ? key : "state";
  }

  /** Returns the colours; robots without a value have the last one. */
  get palette() {
    const { groups, states } = this.mode;
    if (states) return colors.states;
    if (groups) return groups.map((_, at) => colors.series[at % colors.series.length]);
    return [...Array.from({ length: BINS }, (_, bin) => onRamp(bin / (BINS - 1))), colors.idle];
  }

  /** Returns the place of a robot's colour in the palette. */
  groupOf(row, t) {
    const { groupOf, value, range } = this.mode;
    if (groupOf) return groupOf(row, t);
    const now = value(row, t);
    if (!Number.isFinite(now)) return BINS;
    const share = (now - range[0]) / (range[1] - range[0]);
    return Math.max(0, Math.min(BINS - 1, Math.floor(share * BINS)));
  }

  colorOf(row, t) {
    return this.palette[this.groupOf(row, t)];
  }

  /** Shows what the colours mean, with the number of robots in each group. */
  showLegend(box, n, t) {
    const { groups, unit, range } = this.mode, { palette } = this;
    const counts = new Array(palette.length).fill(0);
    for (let row = 0; row < n; row++) counts[this.groupOf(row, t)]++;
    const text = [this.key, palette, counts].join();
    if (text === this.legendText) return;
    this.legendText = text;
    if (groups) {
      const present = groups.map((name, at) => [palette[at], `${counts[at]} ${name}`, counts[at]]).filter(([, , count]) => count);
      const more = present.length - LISTED;
      box.replaceChildren(...present.slice(0, LISTED).map(entry), ...(more > 0 ? [entry([null, `and ${more} more`])] : []));
      return;
    }
    const bar = document.createElement("i"), none = counts.at(-1);
    bar.className = "ramp";
    bar.style.background = `linear-gradient(90deg, ${palette.slice(0, -1).join()})`;
    const digits = range[1] < 10 ? 2 : 0, scale = entry([null, `${range[0].toFixed(digits)} to ${range[1].toFixed(digits)} ${unit}`]);
    box.replaceChildren(bar, scale, ...(none ? [entry([palette.at(-1), `${none} without`])] : []));
  }
}

function entry([color, text]) {
  const box = document.createElement("span");
  if (color) {
    const dot = document.createElement("i");
    dot.style.background = color;
    box.append(dot);
  }
  box.append(text);
  return box;
}

// A colour on the scale, between the stops of the theme.
function onRamp(share) {
  const stops = colors.ramp, at = Math.min(share * (stops.length - 1), stops.length - 1 - 1e-9), first = Math.floor(at);
  const channels = (stop) => [1, 3, 5].map((from) => parseInt(stop.slice(from, from + 2), 16));
  const [low, high] = [channels(stops[first]), channels(stops[first + 1])];
  return `rgb(${low.map((value, k) => Math.round(value + (at - first) * (high[k] - value))).join(" ")})`;
}
