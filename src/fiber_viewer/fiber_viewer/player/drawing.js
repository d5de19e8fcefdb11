// SPDX-License-Identifier: Apache-2.0
// Draws robots with their outlines, targets, patrol regions, and the gap between two robots.
import { forward, outlinesOf } from "./kinematics.js";
import { gapBetween } from "./clearance.js";
import { HELD, FAILED, stateAt } from "./recording.js";
import { colors, label, write } from "./theme.js";

/** Returns the radius about its centre that contains a robot in any pose [mm]. */
export function reachOf(plane, row) {
  const { vertices, count, radius } = plane.phi;
  let far = 0;
  for (let v = row * count; v < (row + 1) * count; v++) {
    far = Math.max(far, Math.hypot(vertices[2 * v], vertices[2 * v + 1]));
  }
  return plane.arm[2 * row] + far + radius[row];
}

/** Fills the outlines of a robot and draws both arms as thin lines inside. */
export function drawRobot(ctx, camera, recording, row, angles, t, { faded = false, color = colors.states[stateAt(recording, row, t)] } = {}) {
  const { plane } = recording;
  const [theta, phi] = [angles[2 * row], angles[2 * row + 1]];
  const [ex, ey, tx, ty] = forward(plane, row, theta, phi);
  const [c, e, tip] = [
    camera.toPixel(plane.center[2 * row], plane.center[2 * row + 1]),
    camera.toPixel(ex, ey),
    camera.toPixel(tx, ty),
  ];
  ctx.lineCap = ctx.lineJoin = "round";
  ctx.strokeStyle = ctx.fillStyle = color;
  // the phi arm last, because it is above the theta arm
  outlinesOf(plane, row, theta, phi).reverse().forEach((hull, place, { length }) => {
    ctx.globalAlpha = (faded ? 0.35 : 0.9) * (place < length - 1 ? 0.45 : 1);
    tracePath(ctx, camera, hull.points);
    ctx.lineWidth = Math.max(1, 2 * hull.radius * camera.scale);
    ctx.stroke();
    if (hull.points.length > 4) ctx.fill();
  });
  ctx.globalAlpha = faded ? 0.5 : 1;
  if (!plane.theta.count) line(ctx, c, e, color, Math.max(1.5, 0.35 * camera.scale));
  line(ctx, c, e, colors.card, Math.max(0.6, 0.06 * camera.scale));
  line(ctx, e, tip, colors.card, Math.max(0.6, 0.06 * camera.scale));
  disc(ctx, c, Math.max(1.4, 0.24 * camera.scale), color);
  disc(ctx, tip, Math.max(1, 0.16 * camera.scale), colors.card);
  ctx.globalAlpha = 1;
}

/** Draws the target of a robot as a small cross. */
export function drawTarget(ctx, camera, recording, row) {
  const { target } = recording.plane;
  if (!Number.isFinite(target[2 * row])) return;
  const [x, y] = camera.toPixel(target[2 * row], target[2 * row + 1]);
  const r = Math.min(7, Math.max(2.5, 0.35 * camera.scale));
  for (const [width, color] of [[3, colors.card], [1.4, colors.ink]]) {
    line(ctx, [x - r, y], [x + r, y], color, width);
    line(ctx, [x, y - r], [x, y + r], color, width);
  }
}

/** Draws a ring about a robot: its patrol region, or a mark if that is too small. */
export function drawRing(ctx, camera, recording, row, color, width = 1.5) {
  const { plane } = recording;
  const [x, y] = camera.toPixel(plane.center[2 * row], plane.center[2 * row + 1]);
  const reach = (plane.arm[2 * row] + plane.arm[2 * row + 1]) * camera.scale;
  ctx.beginPath();
  ctx.arc(x, y, Math.max(reach, 9), 0, 2 * Math.PI);
  ctx.strokeStyle = color;
  ctx.lineWidth = width;
  ctx.stroke();
}

/** Marks a held robot with a ring and a failed robot with a cross, so that colour is not needed. */
export function drawMark(ctx, camera, recording, row, t) {
  const state = stateAt(recording, row, t);
  if (state !== HELD && state !== FAILED) return;
  const { center } = recording.plane;
  const [x, y] = camera.toPixel(center[2 * row], center[2 * row + 1]);
  const r = Math.min(8, Math.max(1.8, 0.8 * camera.scale));
  if (state === FAILED) {
    line(ctx, [x - r, y - r], [x + r, y + r], colors.failed, 2);
    line(ctx, [x - r, y + r], [x + r, y - r], colors.failed, 2);
    return;
  }
  ctx.beginPath();
  ctx.arc(x, y, r, 0, 2 * Math.PI);
  ctx.strokeStyle = colors.held;
  ctx.lineWidth = r > 2.5 ? 1.4 : 1.1;
  ctx.stroke();
}

/** Draws fixed discs and walls. */
export function drawFixtures(ctx, camera, plane) {
  for (let k = 0; k < plane.discs.length; k += 3) {
    const at = camera.toPixel(plane.discs[k], plane.discs[k + 1]);
    disc(ctx, at, Math.max(1, plane.discs[k + 2] * camera.scale), colors.disabled);
  }
  ctx.fillStyle = ctx.strokeStyle = colors.disabled;
  ctx.lineWidth = 1.2;
  for (const corners of plane.walls) {
    ctx.beginPath();
    for (let k = 0; k < corners.length; k += 2) ctx.lineTo(...camera.toPixel(corners[k], corners[k + 1]));
    ctx.closePath();
    ctx.fill();
    ctx.stroke();
  }
}

/** Returns the outlines of a body: a robot, a fixed disc or a wall. */
export function hullsOf(plane, body, angles) {
  if (body < plane.n) return outlinesOf(plane, body, angles[2 * body], angles[2 * body + 1]);
  const number = body - plane.n, discs = plane.discs.length / 3;
  if (number >= discs) return [{ points: plane.walls[number - discs], radius: 0 }];
  const at = 3 * number;
  return [{ points: plane.discs.slice(at, at + 2), radius: plane.discs[at + 2] }];
}

/** Draws the gap between two bodies; returns the gap [mm]. */
export function drawGap(ctx, camera, plane, a, b, angles, labelled = true) {
  const { gap, from, to } = gapBetween(hullsOf(plane, a, angles), hullsOf(plane, b, angles));
  const [p, q] = [camera.toPixel(...from), camera.toPixel(...to)];
  line(ctx, p, q, colors.gap, 2.5);
  disc(ctx, p, 2.2, colors.gap);
  disc(ctx, q, 2.2, colors.gap);
  if (labelled) {
    const text = `${gap.toFixed(3)} mm`, long = ctx.measureText(text).width;
    const x = Math.min((p[0] + q[0]) / 2 + 8, camera.width - long - 6), y = (p[1] + q[1]) / 2 - 10;
    ctx.fillStyle = colors.card;
    ctx.globalAlpha = 0.85;
    ctx.fillRect(x - 3, y - 8, long + 6, 16);
    ctx.globalAlpha = 1;
    write(ctx, text, x, y, colors.ink);
  }
  return gap;
}

/** Draws a scale bar in the corner at the bottom right. */
export function drawScale(ctx, camera) {
  const length = [0.5, 1, 2, 5, 10, 20, 50, 100, 200].find((mm) => mm * camera.scale > 46) ?? 500;
  const right = camera.width - 12, y = camera.height - 12;
  line(ctx, [right - length * camera.scale, y], [right, y], colors.soft, 1.5);
  label(ctx, `${length} mm`, right, y - 9, colors.soft, "right");
}

/** Draws a line between two pixels. */
export function line(ctx, from, to, color, width) {
  ctx.beginPath();
  ctx.moveTo(...from);
  ctx.lineTo(...to);
  ctx.strokeStyle = color;
  ctx.lineWidth = width;
  ctx.stroke();
}

/** Fills a disc about a pixel. */
export function disc(ctx, [x, y], radius, color) {
  ctx.beginPath();
  ctx.arc(x, y, radius, 0, 2 * Math.PI);
  ctx.fillStyle = color;
  ctx.fill();
}

function tracePath(ctx, camera, points) {
  ctx.beginPath();
  for (let v = 0; v < points.length; v += 2) {
    const [x, y] = camera.toPixel(points[v], points[v + 1]);
    if (v) ctx.lineTo(x, y);
    else ctx.moveTo(x, y);
  }
  ctx.closePath();
}
