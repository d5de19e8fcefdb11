// SPDX-License-Identifier: Apache-2.0
// Panel 1: the whole focal plane. Arms are lines, or outlines if they are large enough.
import { Camera } from "./camera.js";
import { cleared, colors } from "./theme.js";
import { drawFixtures, drawMark, drawRing, drawRobot, drawScale, drawTarget, reachOf } from "./drawing.js";

const OUTLINES_FROM_PX = 6; // least width of an arm to draw its outline
const ARMS_PER_PATH = 250; // longer paths are slower to stroke
const CLICK_PX = 5; // a pointer that moves less than this between down and up is a click

export class PlanePanel {
  constructor(canvas, app) {
    this.canvas = canvas;
    this.app = app;
    this.camera = new Camera();
    this.pointers = new Map();
    this.robotsChanged();
    this.listen();
  }

  /** Measures the robots of the plane, and shows all of it. */
  robotsChanged() {
    const { plane } = this.app.recording;
    this.reach = Array.from({ length: plane.n }, (_, row) => reachOf(plane, row));
    this.outlinesFrom = OUTLINES_FROM_PX / widthOf(plane);
    this.fitted = false;
    this.untouched = true;
  }

  /** Shows the whole plane. */
  fit() {
    const { plane } = this.app.recording;
    let [left, bottom, right, top] = [Infinity, Infinity, -Infinity, -Infinity];
    const include = (x, y, r) => {
      left = Math.min(left, x - r);
      right = Math.max(right, x + r);
      bottom = Math.min(bottom, y - r);
      top = Math.max(top, y + r);
    };
    this.reach.forEach((reach, row) => include(plane.center[2 * row], plane.center[2 * row + 1], reach));
    for (let k = 0; k < plane.discs.length; k += 3) include(...plane.discs.subarray(k, k + 3));
    for (const corners of plane.walls) {
      for (let k = 0; k < corners.length; k += 2) include(corners[k], corners[k + 1], 0);
    }
    this.camera.fit(left, bottom, right, top);
    this.fitted = true;
    this.app.redraw();
  }

  /** Moves the view to a robot that is not visible. */
  reveal(row) {
    const { center } = this.app.recording.plane;
    if (this.camera.sees(center[2 * row], center[2 * row + 1], 0)) return;
    [this.camera.x, this.camera.y] = [center[2 * row], center[2 * row + 1]];
  }

  draw(t, angles, places) {
    const { ctx, width, height } = cleared(this.canvas);
    const resized = this.camera.width !== width || this.camera.height !== height;
    [this.camera.width, this.camera.height] = [width, height];
    if (!this.fitted || (resized && this.whole)) this.fit();
    const { recording, robots, coloring } = this.app, { plane } = recording;
    drawFixtures(ctx, this.camera, plane);
    const seen = this.visible();
    if (this.camera.scale >= this.outlinesFrom) {
      for (const row of seen) drawRobot(ctx, this.camera, recording, row, angles, t, { color: coloring.colorOf(row, t) });
      for (const row of seen) drawTarget(ctx, this.camera, recording, row);
    } else {
      this.drawTargets(ctx, seen);
      this.drawLines(ctx, t, seen, places);
    }
    for (const row of this.app.marked) drawMark(ctx, this.camera, recording, row, t);
    robots.forEach((row, i) => drawRing(ctx, this.camera, recording, row, colors.watch, i ? 1.2 : 2));
    drawScale(ctx, this.camera);
  }

  get whole() {
    return this.fitted && this.untouched !== false;
  }

  visible() {
    const { plane } = this.app.recording, rows = [];
    for (let row = 0; row < plane.n; row++) {
      if (this.camera.sees(plane.center[2 * row], plane.center[2 * row + 1], this.reach[row])) rows.push(row);
    }
    return rows;
  }

  /** Draws targets as dots, for robots that are too small for crosses. */
  drawTargets(ctx, rows) {
    const { target } = this.app.recording.plane, size = Math.max(1.5, Math.min(3, 0.4 * this.camera.scale));
    ctx.fillStyle = colors.target;
    for (const row of rows) {
      if (!Number.isFinite(target[2 * row])) continue;
      const [x, y] = this.camera.toPixel(target[2 * row], target[2 * row + 1]);
      ctx.fillRect(x - size / 2, y - size / 2, size, size);
    }
  }

  drawLines(ctx, t, rows, places) {
    const { recording, coloring } = this.app, { center } = recording.plane, { palette } = coloring;
    const groups = palette.map(() => []);
    for (const row of rows) groups[coloring.groupOf(row, t)].push(row);
    const { scale, x: cx, y: cy, width, height } = this.camera;
    const px = (x) => width / 2 + (x - cx) * scale, py = (y) => height / 2 - (y - cy) * scale;
    ctx.lineWidth = Math.max(1, 0.35 * scale);
    groups.forEach((inGroup, group) => {
      ctx.strokeStyle = palette[group];
      for (let begin = 0; begin < inGroup.length; begin += ARMS_PER_PATH) {
        ctx.beginPath();
        for (const row of inGroup.slice(begin, begin + ARMS_PER_PATH)) {
          ctx.moveTo(px(center[2 * row]), py(center[2 * row + 1]));
          ctx.lineTo(px(places[4 * row]), py(places[4 * row + 1]));
          ctx.lineTo(px(places[4 * row + 2]), py(places[4 * row + 3]));
        }
        ctx.stroke();
      }
    });
  }

  /** Returns the robot with the arms nearest to a pixel, -1 if no robot reaches it. */
  robotAt(px, py) {
    const { center, n } = this.app.recording.plane, { places } = this.app;
    const [x, y] = this.camera.toPlane(px, py);
    let best = -1, least = Infinity;
    for (let row = 0; row < n; row++) {
      const [cx, cy] = [center[2 * row], center[2 * row + 1]];
      if (Math.hypot(x - cx, y - cy) > this.reach[row]) continue;
      const [ex, ey, tx, ty] = places.subarray(4 * row, 4 * row + 4);
      const away = Math.min(distanceTo(x, y, cx, cy, ex, ey), distanceTo(x, y, ex, ey, tx, ty));
      if (away < least) [best, least] = [row, away];
    }
    return best;
  }

  listen() {
    const { canvas } = this;
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0016), ...place(event));
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, place(event));
      this.travelled = 0;
    });
    canvas.addEventListener("pointermove", (event) => this.onMove(event, place(event)));
    canvas.addEventListener("pointerup", (event) => {
      const clicked = this.pointers.size === 1 && this.travelled < CLICK_PX;
      this.pointers.delete(event.pointerId);
      if (!clicked) return;
      const row = this.robotAt(...place(event));
      if (row >= 0) this.app.watch(row, event.shiftKey);
    });
    canvas.addEventListener("pointercancel", (event) => this.pointers.delete(event.pointerId));
  }

  onMove(event, [x, y]) {
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      this.app.showHint(this.robotAt(x, y));
      return;
    }
    this.travelled += Math.hypot(x - before[0], y - before[1]);
    if (this.pointers.size === 2) {
      // two fingers: zoom about the one that does not move
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const distance = Math.hypot(before[0] - other[0], before[1] - other[1]);
      this.zoom(Math.hypot(x - other[0], y - other[1]) / Math.max(distance, 1), ...other);
    } else if (this.travelled >= CLICK_PX) {
      this.camera.x -= (x - before[0]) / this.camera.scale;
      this.camera.y += (y - before[1]) / this.camera.scale;
      this.untouched = false;
      this.app.redraw();
    }
    this.pointers.set(event.pointerId, [x, y]);
  }

  zoom(factor, px, py) {
    this.camera.zoom(factor, px, py);
    this.untouched = false;
    this.app.redraw();
  }

  /** Shows a robot and its neighbours as large as they fit. */
  zoomTo(row) {
    const { center } = this.app.recording.plane, x = center[2 * row], y = center[2 * row + 1], r = 3 * this.reach[row];
    this.camera.fit(x - r, y - r, x + r, y + r);
    this.untouched = false;
    this.app.redraw();
  }

  reset() {
    this.untouched = true;
    this.fit();
  }
}

// Width of the phi arm of the first robot [mm].
function widthOf({ n, phi }) {
  if (!n) return 1;
  const across = Array.from({ length: phi.count }, (_, v) => phi.vertices[2 * v + 1]);
  return Math.max(...across) - Math.min(...across) + 2 * phi.radius[0] || 1;
}

function distanceTo(x, y, ax, ay, bx, by) {
  const [ux, uy] = [bx - ax, by - ay], square = ux * ux + uy * uy;
  const s = square > 0 ? Math.min(1, Math.max(0, ((x - ax) * ux + (y - ay) * uy) / square)) : 0;
  return Math.hypot(x - ax - s * ux, y - ay - s * uy);
}
