// SPDX-License-Identifier: Apache-2.0
// Panels 4 and 5: velocity and position profiles of both joints of the first watched robot.
import { angleAt, velocityAt } from "./kinematics.js";
import { pausesOf } from "./phases.js";
import { Axes } from "./axes.js";
import { cleared, colors, write } from "./theme.js";

const DEGREE = Math.PI / 180;
const MOST_RINGS = 40; // encoder readings that are drawn of a joint
const JOINTS = ["theta", "phi"];

/** Returns the velocities of the segments of a profile as steps: time, deg/s, time, deg/s, ... */
export function velocitySteps(motion, profile, end) {
  const points = [0, 0];
  for (let k = motion.offsets[profile]; k < motion.offsets[profile + 1]; k++) {
    const v = motion.velocity[k] / DEGREE;
    points.push(motion.begin[k], v, motion.begin[k] + motion.duration[k], v);
  }
  points.push(motion.end[profile], 0, end, 0);
  return points;
}

/** Returns the angles at the ends of the segments of a profile: time, deg, ... */
export function breakPoints(motion, profile) {
  const points = [0, motion.start[profile] / DEGREE];
  for (let k = motion.offsets[profile]; k < motion.offsets[profile + 1]; k++) {
    const end = motion.angle[k] + motion.duration[k] * motion.velocity[k];
    points.push(motion.begin[k] + motion.duration[k], end / DEGREE);
  }
  return points;
}

/** Returns planned angles [deg], or velocities [deg/s], of a profile: time, value, ... */
export function plannedCurve(planned, profile, speeds) {
  const { times, angles } = planned, count = times.length, first = profile * count;
  const points = [];
  for (let k = 0; k < count; k++) {
    if (!speeds) points.push(times[k], angles[first + k] / DEGREE);
    else if (k + 1 < count) {
      const v = (angles[first + k + 1] - angles[first + k]) / (times[k + 1] - times[k]) / DEGREE;
      points.push(times[k], v, times[k + 1], v);
    }
  }
  return points;
}

/** Returns encoder readings of a joint: time, deg, ... The file has their distances from the motion. */
export function readings(recording, row, joint) {
  const { measured, motion } = recording, points = [];
  for (let i = measured.offsets[row]; i < measured.offsets[row + 1]; i++) {
    const at = measured.order[i], time = measured.time[at];
    const angle = angleAt(motion, 2 * row + joint, time) + measured.off[2 * at + joint] * measured.quantum;
    points.push(time, angle / DEGREE);
  }
  return points;
}

/** Returns the corridor of a joint until its robot was stopped: time, low, high [deg], ... */
export function corridorBand(recording, row, joint) {
  const { corridors, motion } = recording, band = [];
  if (!corridors || !(corridors.lasts[row] > 0)) return band;
  const { count, low, high } = corridors, first = (2 * row + joint) * count;
  const until = motion.phases[0].stop === null ? Infinity : motion.active.ends[row];
  for (let k = 0; k < count; k++) {
    const time = (k / (count - 1)) * corridors.lasts[row];
    const [l, h] = [low[first + k] / DEGREE, high[first + k] / DEGREE];
    if (time > until) {
      // the corridor belongs to the orders, which end at the stop
      const [t0, l0, h0] = band.slice(-3), share = (until - t0) / (time - t0);
      band.push(until, l0 + share * (l - l0), h0 + share * (h - h0));
      break;
    }
    band.push(time, l, h);
  }
  return band;
}

/** Returns the angles below and above a corridor, as two bands from one end of the axis to the other. */
export function forbiddenBands(corridor, lowest, highest) {
  const below = corridor.slice(), above = corridor.slice();
  for (let i = 0; i < corridor.length; i += 3) {
    [below[i + 1], below[i + 2]] = [lowest, Math.max(lowest, corridor[i + 1])];
    [above[i + 1], above[i + 2]] = [Math.min(highest, corridor[i + 2]), highest];
  }
  return [below, above];
}

// Range of a plot: the curves, and as much of the corridor as keeps them legible.
function rangeOf(values, band) {
  const low = Math.min(...values), high = Math.max(...values), most = Math.max(high - low, 15);
  const bounds = (bound) => band.filter((_, i) => i % 3 === bound);
  const below = Math.min(low - Math.min(low, ...bounds(1)), most);
  const above = Math.min(Math.max(high, ...bounds(2)) - high, most);
  const pad = Math.max(0.06 * (high - low + below + above), 1);
  return [low - below - pad, high + above + pad];
}

class ProfilesPanel {
  constructor(canvas, note, app) {
    Object.assign(this, { canvas, note, app });
    canvas.addEventListener("pointerdown", (event) => {
      const x = event.clientX - canvas.getBoundingClientRect().left;
      const axes = this.plots?.find((plot) => x >= plot.left - 4 && x <= plot.left + plot.width + 4);
      if (axes) app.seek(axes.xLow + ((x - axes.left) / axes.width) * (axes.xHigh - axes.xLow));
    });
  }

  draw(t) {
    const { ctx, width, height } = cleared(this.canvas);
    const { recording, robots } = this.app;
    if (!robots.length) {
      write(ctx, "Click a robot to watch it", width / 2, height / 2, colors.soft, "center");
      this.note.textContent = "";
      return;
    }
    const row = robots[0], { motion } = recording;
    // other robots may move for much longer than this one
    const own = Math.max(motion.end[2 * row], motion.end[2 * row + 1]) || motion.makespan;
    const end = Math.max(Math.min(1.15 * own, motion.makespan), 1e-3);
    const stacked = width < 560, gap = 52;
    const w = stacked ? width - 56 : (width - 62 - gap) / 2;
    const h = stacked ? (height - 96) / 2 : height - 50;
    this.plots = JOINTS.map((name, joint) => {
      const box = stacked
        ? { left: 48, top: 18 + joint * (h + 50), width: w, height: h }
        : { left: 48 + joint * (w + gap), top: 18, width: w, height: h };
      return this.plot(ctx, box, row, joint, end, t);
    });
    this.note.textContent = `robot ${recording.plane.ids[row]} — ${this.legend}`;
  }

  /** Shades the times in which all robots were stopped. */
  shadePauses(ctx, axes) {
    for (const [from, to] of pausesOf(this.app.recording.motion)) {
      axes.band(ctx, [from, axes.yLow, axes.yHigh, to, axes.yLow, axes.yHigh], colors.stopped, 0.16);
    }
  }
}

export class VelocityPanel extends ProfilesPanel {
  legend = "sent bold, planned thin, limits dashed";

  plot(ctx, box, row, joint, end, t) {
    const { motion, planned, plane } = this.app.recording, profile = 2 * row + joint;
    const limit = plane.speeds[profile] / DEGREE;
    const axes = new Axes(box, [0, end], [-1.12 * limit, 1.12 * limit]);
    const now = Math.round((velocityAt(motion, profile, t) / DEGREE) * 10) / 10;
    axes.frame(ctx, "s", `${JOINTS[joint]}: ${(now || 0).toFixed(1)} deg/s`);
    this.shadePauses(ctx, axes);
    for (const sign of [-1, 1]) axes.curve(ctx, [0, sign * limit, end, sign * limit], colors.soft, 1, [5, 4]);
    if (planned) axes.curve(ctx, plannedCurve(planned, profile, true), colors.plan, 1.2);
    axes.curve(ctx, velocitySteps(motion, profile, end), colors[JOINTS[joint]], 2.4);
    axes.cursor(ctx, t);
    return axes;
  }
}

export class PositionPanel extends ProfilesPanel {
  legend = "sent bold, planned thin, rings: encoders, grey: forbidden";

  plot(ctx, box, row, joint, end, t) {
    const { recording } = this.app, { motion, planned } = recording, profile = 2 * row + joint;
    const sent = breakPoints(motion, profile), read = readings(recording, row, joint);
    const plan = planned ? plannedCurve(planned, profile, false) : [];
    const values = [...sent, ...read, ...plan].filter((_, i) => i % 2);
    const corridor = corridorBand(recording, row, joint);
    const axes = new Axes(box, [0, end], rangeOf(values, corridor));
    const now = angleAt(motion, profile, t) / DEGREE;
    axes.frame(ctx, "s", `${JOINTS[joint]}: ${now.toFixed(2)} deg`);
    const color = colors[JOINTS[joint]];
    this.shadePauses(ctx, axes);
    if (corridor.length) {
      for (const side of forbiddenBands(corridor, axes.yLow, axes.yHigh)) axes.band(ctx, side, colors.plan, 0.28);
      for (const bound of [1, 2]) axes.curve(ctx, corridor.filter((_, i) => i % 3 === 0 || i % 3 === bound), colors.plan, 0.8);
    }
    axes.curve(ctx, [...sent, end, sent.at(-1)], color, 2.4);
    axes.curve(ctx, plan, colors.plan, 1.2);
    axes.dots(ctx, sent, color, 3.4, true);
    const every = 2 * Math.ceil(read.length / 2 / MOST_RINGS);
    axes.dots(ctx, read.filter((_, i) => i % every < 2), colors.ink, 3, false);
    axes.cursor(ctx, t);
    axes.dots(ctx, [Math.min(Math.max(t, 0), end), now], colors.accent, 4, true);
    return axes;
  }
}
