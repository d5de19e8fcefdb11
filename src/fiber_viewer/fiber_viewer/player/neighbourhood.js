// SPDX-License-Identifier: Apache-2.0
// Panels 2 and 3: the watched robots among their neighbours, now and at six moments.
import { anglesOfAll } from "./kinematics.js";
import { bodyName } from "./recording.js";
import { Camera } from "./camera.js";
import { cleared, colors, label, write } from "./theme.js";
import { gapBetween } from "./clearance.js";
import { disc, drawFixtures, drawGap, drawMark, drawRing, drawRobot, drawScale, drawTarget, hullsOf, reachOf } from "./drawing.js";

const MOMENTS = 6;

/** Returns the closest approach of the first robot; of several robots, the closest between two of them. */
export function closestApproach(recording, robots) {
  const all = recording.pairs;
  if (robots.length > 1) {
    const among = all.find((pair) => robots.includes(pair.a) && robots.includes(pair.b));
    if (among) return among;
  }
  return all.find((pair) => pair.a === robots[0] || pair.b === robots[0]);
}

export class NeighbourhoodPanel {
  constructor(canvas, note, app) {
    this.canvas = canvas;
    this.note = note;
    this.app = app;
    this.camera = new Camera();
  }

  draw(t, angles) {
    const { ctx, width, height } = cleared(this.canvas);
    const { recording, robots } = this.app, { plane } = recording;
    if (!robots.length) {
      write(ctx, "Click a robot to watch it", width / 2, height / 2, colors.soft, "center");
      this.note.textContent = "";
      return;
    }
    const reach = reachOf(plane, robots[0]);
    let [left, bottom, right, top] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const row of robots) {
      const [x, y] = [plane.center[2 * row], plane.center[2 * row + 1]];
      [left, right] = [Math.min(left, x), Math.max(right, x)];
      [bottom, top] = [Math.min(bottom, y), Math.max(top, y)];
    }
    [this.camera.width, this.camera.height] = [width, height];
    this.camera.fit(left - 1.5 * reach, bottom - 1.5 * reach, right + 1.5 * reach, top + 1.5 * reach, 1);
    drawScene(ctx, this.camera, recording, robots, angles, t);
    const gaps = this.drawClosestGap(ctx, angles);
    const near = gaps[0];
    this.note.textContent = near
      ? `robot ${plane.ids[robots[0]]} is ${near.gap.toFixed(3)} mm from ${near.body < plane.n ? "robot " : ""}${bodyName(recording, near.body)}`
      : `robot ${plane.ids[robots[0]]} has no neighbours`;
    for (const row of robots) {
      const [x, y] = this.camera.toPixel(plane.center[2 * row], plane.center[2 * row + 1]);
      label(ctx, String(plane.ids[row]), x, y + 14, colors.ink, "center");
    }
    this.drawMeasured(ctx);
    drawScale(ctx, this.camera);
  }

  /** Draws where the chosen image shows the fibres, and where simulated fibres truly are. */
  drawMeasured(ctx) {
    const { recording, image } = this.app, { images, plane } = recording;
    if (!images) return;
    const mark = (places, draw) => {
      for (let row = 0; row < plane.n; row++) {
        const [x, y] = this.camera.toPixel(places[2 * row], places[2 * row + 1]);
        if (x > 0 && y > 0 && x < this.camera.width && y < this.camera.height) draw([x, y]); // not of nan
      }
    };
    if (images.truths) mark(images.truths[image], (at) => disc(ctx, at, 2.4, colors.gap));
    ctx.strokeStyle = colors.ink;
    ctx.lineWidth = 1.6;
    mark(images.places[image], ([x, y]) => {
      ctx.beginPath();
      ctx.arc(x, y, 5, 0, 2 * Math.PI);
      ctx.stroke();
    });
  }

  /** Draws the smallest gap of the first watched robot now; returns all its gaps, smallest first. */
  drawClosestGap(ctx, angles) {
    const { recording, robots, neighbours } = this.app, { plane } = recording;
    const own = hullsOf(plane, robots[0], angles);
    const found = (neighbours.get(robots[0]) ?? [])
      .map((body) => ({ body, gap: gapBetween(own, hullsOf(plane, body, angles)).gap }))
      .sort((a, b) => a.gap - b.gap);
    if (found.length) drawGap(ctx, this.camera, plane, robots[0], found[0].body, angles);
    return found;
  }
}

export class SnapshotsPanel {
  constructor(canvas, note, app) {
    this.canvas = canvas;
    this.note = note;
    this.app = app;
    this.moments = [];
    canvas.addEventListener("click", (event) => {
      const box = canvas.getBoundingClientRect();
      const moment = this.moments.find(({ x, y, w, h }) => {
        const [px, py] = [event.clientX - box.left, event.clientY - box.top];
        return px >= x && px < x + w && py >= y && py < y + h;
      });
      if (moment) app.seek(moment.time);
    });
  }

  draw(t) {
    // the picture changes only with the chosen moment, the robots, the size and the theme
    const reached = this.moments.findIndex(({ time }) => Math.abs(t - time) < 1e-9);
    const { clientWidth, clientHeight } = this.canvas;
    const chosen = [this.app.pair?.a, this.app.pair?.b, ...this.app.robots];
    const picture = [clientWidth, clientHeight, colors.card, reached, ...chosen].join();
    if (picture === this.picture) return;
    this.picture = picture;
    const { ctx, width, height } = cleared(this.canvas);
    const { recording, robots } = this.app, { plane, motion } = recording;
    const pair = robots.length ? this.app.pair ?? closestApproach(recording, robots) : null;
    this.moments = [];
    if (!pair) {
      write(ctx, "No neighbours", width / 2, height / 2, colors.soft, "center");
      this.note.textContent = "";
      return;
    }
    this.note.textContent =
      `${pair.b < plane.n ? "robots" : "robot"} ${bodyName(recording, pair.a)} and ${bodyName(recording, pair.b)}: ` +
      `${pair.gap.toFixed(3)} mm at ${pair.time.toFixed(3)} s; click a moment to go there`;
    const across = width > 640 ? MOMENTS : 2, gutter = 8;
    const w = (width - gutter * (across - 1)) / across;
    const down = Math.ceil(MOMENTS / across);
    const h = (height - gutter * (down - 1)) / down;
    const reach = reachOf(plane, Math.min(pair.a, pair.b));
    const middle = [pair.a, pair.b].filter((body) => body < plane.n);
    const [cx, cy] = [0, 1].map((axis) => middle.reduce((sum, row) => sum + plane.center[2 * row + axis], 0) / middle.length);
    const ends = Math.max(...middle.flatMap((row) => [motion.end[2 * row], motion.end[2 * row + 1]]));
    momentsAround(pair.time, Math.max(ends, pair.time)).forEach((time, i) => {
      const [x, y] = [(i % across) * (w + gutter), Math.floor(i / across) * (h + gutter)];
      const angles = anglesOfAll(motion, time, new Float64Array(2 * plane.n));
      const camera = new Camera();
      [camera.width, camera.height] = [w, h];
      camera.fit(cx - 1.55 * reach, cy - 1.55 * reach, cx + 1.55 * reach, cy + 1.55 * reach, 1);
      ctx.save();
      ctx.beginPath();
      ctx.rect(x, y, w, h);
      ctx.clip();
      ctx.fillStyle = colors.faint;
      ctx.fillRect(x, y, w, h);
      ctx.translate(x, y);
      drawScene(ctx, camera, recording, middle, angles, time, false);
      const gap = drawGap(ctx, camera, plane, pair.a, pair.b, angles, false);
      ctx.fillStyle = colors.faint;
      ctx.globalAlpha = 0.85;
      ctx.fillRect(0, 0, w, 19);
      ctx.globalAlpha = 1;
      write(ctx, `${time.toFixed(3)} s`, 7, 10, colors.ink);
      write(ctx, `${gap.toFixed(3)} mm`, w - 7, 10, colors.ink, "right");
      ctx.restore();
      if (Math.abs(t - time) < 1e-9) {
        ctx.strokeStyle = colors.accent;
        ctx.lineWidth = 2;
        ctx.strokeRect(x + 1, y + 1, w - 2, h - 2);
      }
      this.moments.push({ x, y, w, h, time });
    });
  }
}

/** Returns six times from 0 to `ends`, with the time of the closest approach among them. */
export function momentsAround(time, ends) {
  const step = 0.12 * Math.max(ends, 1e-3);
  const first = Math.min(Math.max(0, time - 3 * step), Math.max(0, ends - (MOMENTS - 1) * step));
  const times = Array.from({ length: MOMENTS }, (_, i) => first + i * step);
  // replace the time nearest to the approach by the time of the approach
  const at = times.reduce((best, now, i) => (Math.abs(now - time) < Math.abs(times[best] - time) ? i : best), 0);
  times[at] = time;
  return times;
}

function drawScene(ctx, camera, recording, robots, angles, t, targets = true) {
  const { plane } = recording;
  drawFixtures(ctx, camera, plane);
  const near = [];
  for (let row = 0; row < plane.n; row++) {
    const [x, y] = [plane.center[2 * row], plane.center[2 * row + 1]];
    if (camera.sees(x, y, reachOf(plane, row))) near.push(row);
  }
  for (const row of robots) drawRing(ctx, camera, recording, row, colors.line, 1.2);
  for (const row of near) {
    drawRobot(ctx, camera, recording, row, angles, t, { faded: !robots.includes(row) });
    drawMark(ctx, camera, recording, row, t);
  }
  if (targets) for (const row of robots) drawTarget(ctx, camera, recording, row);
}
