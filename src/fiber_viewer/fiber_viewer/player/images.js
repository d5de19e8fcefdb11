// SPDX-License-Identifier: Apache-2.0
// Panel 8: how far fibres are from their targets in each image of a camera, and which robots are flagged and why.
import { Camera } from "./camera.js";
import { cleared, colors, write } from "./theme.js";
import { line } from "./drawing.js";
import { Axes } from "./axes.js";

const LENGTHS = 40; // bins of the histogram
const SHOWN = 0.99; // of the distances of all images are inside the histogram
const USUAL = 0.95; // of the vectors are at most as long as LONGEST patrol radii
const LONGEST = 1;
const REACHED_CODE = 0; // of an outcome
const WHY = {
  dark: "no light where its fibre may be, in any image",
  missing: "no light where its fibre may be",
  ambiguous: "a light that may not be its own",
  merged: "its light may be two",
  not_moved: "neither joint turned when it was told to",
  theta_not_moved: "theta did not turn when it was told to",
  phi_not_moved: "phi did not turn when it was told to",
  off_model: "its drive does not explain where it was",
  unplaced: "its place is unknown, or its turn of theta",
  unexplained: "no light where its fibre may be, and one of no robot in its reach",
};

/** Returns the name of an image. */
export function imageName(k) {
  return k ? `after correction ${k}` : "after the move";
}

/**
 * Returns the rows of fibres that the plan brought to their targets and an image tells of, and how
 * far each is from there [mm]: {rows, dx, dy, um}. Robots that were held, or of which any image tells
 * that they did not move, are listed.
 */
export function residualsOf({ plane, images, outcome }, k) {
  const rows = [], dx = [], dy = [], um = [], places = images.places[k], { target } = plane;
  const told = images.verdicts[images.count - 1]; // what was ever told of robots that did not move
  for (let row = 0; row < plane.n; row++) {
    const [x, y] = [places[2 * row] - target[2 * row], places[2 * row + 1] - target[2 * row + 1]];
    if (!Number.isFinite(x + y) || images.stays(told[row]) || outcome[row] !== REACHED_CODE) continue;
    rows.push(row);
    dx.push(x);
    dy.push(y);
    um.push(1e3 * Math.hypot(x, y));
  }
  return { rows, dx, dy, um };
}

/** Returns the robots that are flagged after the last image, since when and why: [{row, verdict, text}, ...]. */
export function flaggedOf({ plane, images }) {
  if (!images) return [];
  const flagged = [], last = images.count - 1, places = images.places[last];
  images.verdicts[last].forEach((code, row) => {
    if (!code) return;
    const name = images.names[code] ?? `verdict ${code}`;
    let first = last; // image since which this is told
    while (first && images.verdicts[first - 1][row] === code) first -= 1;
    const far = Math.hypot(places[2 * row] - plane.target[2 * row], places[2 * row + 1] - plane.target[2 * row + 1]);
    const since = WHY[name] ? `${imageName(first)}: ${WHY[name]}` : imageName(first);
    const text = since + (Number.isFinite(far) ? `; now ${far.toFixed(3)} mm from its target` : "");
    flagged.push({ row, verdict: name.replaceAll("_", " "), text });
  });
  return flagged;
}

/** Returns the value below which a share of some values are. */
export function quantile(values, share) {
  const sorted = Float64Array.from(values).sort();
  return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : 0;
}

/** Returns root mean square, 0 for nothing. */
export function rms(values) {
  return values.length ? Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length) : 0;
}

export class ImagesPanel {
  constructor(canvas, note, app, chooser) {
    Object.assign(this, { canvas, note, app, chooser });
    const { recording } = app, { images } = recording;
    canvas.closest(".panel").hidden = !images;
    if (!images) return;
    this.residuals = Array.from({ length: images.count }, (_, k) => residualsOf(recording, k));
    chooser.replaceChildren(...this.residuals.map((_, k) => new Option(imageName(k), k)));
    chooser.value = images.count - 1;
    chooser.onchange = () => app.redraw();
    canvas.addEventListener("click", (event) => {
      const box = canvas.getBoundingClientRect(), row = this.robotAt(event.clientX - box.left, event.clientY - box.top);
      if (row !== undefined) app.watch(row, event.shiftKey);
    });
  }

  /** The image that is shown. */
  get shown() {
    return Number(this.chooser.value);
  }

  draw() {
    const { ctx, width, height } = cleared(this.canvas);
    const stacked = width < 700, part = stacked ? 1 : 0.58;
    const h = stacked ? 0.6 * height : height;
    this.drawVectors(ctx, width * part, h);
    const box = stacked
      ? { left: 48, top: h + 24, width: width - 58, height: height - h - 62 }
      : { left: width * part + 48, top: 24, width: width * (1 - part) - 58, height: height - 62 };
    this.drawHistogram(ctx, box);
    const { um } = this.residuals[this.shown];
    this.note.textContent = `${um.length} fibres, ${rms(um).toFixed(1)} um rms` +
      (um.length ? `; vectors ${this.factor.toFixed(0)} times as long` : "");
  }

  drawVectors(ctx, width, height) {
    const { recording, robots } = this.app, { plane, images } = recording, { rows, dx, dy, um } = this.residuals[this.shown];
    const camera = this.camera ??= new Camera(), reach = plane.arm[0] + plane.arm[1];
    [camera.width, camera.height] = [width, height];
    const xs = [], ys = [];
    for (let row = 0; row < plane.n; row++) {
      xs.push(plane.center[2 * row]);
      ys.push(plane.center[2 * row + 1]);
    }
    const low = (values) => values.reduce((a, b) => Math.min(a, b)), high = (values) => values.reduce((a, b) => Math.max(a, b));
    camera.fit(low(xs) - reach, low(ys) - reach, high(xs) + reach, high(ys) + reach);
    this.factor = (LONGEST * reach) / Math.max(1e-3 * quantile(um, USUAL), 1e-9);
    ctx.fillStyle = colors.line;
    for (let row = 0; row < plane.n; row++) {
      const [x, y] = camera.toPixel(xs[row], ys[row]);
      ctx.fillRect(x - 0.75, y - 0.75, 1.5, 1.5);
    }
    ctx.save();
    ctx.beginPath();
    ctx.rect(0, 0, width, height);
    ctx.clip(); // a vector that is longer than the plane does not cross the histogram
    ctx.beginPath();
    rows.forEach((row, at) => {
      const [x, y] = [plane.target[2 * row], plane.target[2 * row + 1]];
      ctx.moveTo(...camera.toPixel(x, y));
      ctx.lineTo(...camera.toPixel(x + this.factor * dx[at], y + this.factor * dy[at]));
    });
    ctx.strokeStyle = colors.accent;
    ctx.lineWidth = 1;
    ctx.stroke();
    ctx.restore();
    images.verdicts[this.shown].forEach((code, row) => {
      if (code) this.cross(ctx, row, colors.failed);
    });
    for (const row of robots) this.cross(ctx, row, colors.watch);
  }

  cross(ctx, row, color) {
    const { center } = this.app.recording.plane, [x, y] = this.camera.toPixel(center[2 * row], center[2 * row + 1]), r = 4;
    line(ctx, [x - r, y - r], [x + r, y + r], color, 1.6);
    line(ctx, [x - r, y + r], [x + r, y - r], color, 1.6);
  }

  /** Draws how many fibres are how far from their targets, before and after each correction. */
  drawHistogram(ctx, box) {
    const all = this.residuals.map(({ um }) => um), far = Math.max(quantile(all.flat(), SHOWN), 1e-3);
    const counts = all.map((um) => {
      const bins = new Array(LENGTHS).fill(0);
      for (const value of um) bins[Math.min(LENGTHS - 1, Math.floor((value / far) * LENGTHS))]++;
      return bins;
    });
    const most = Math.max(1, ...counts.flat());
    const axes = new Axes(box, [0, far], [0, 1.05 * most]);
    axes.frame(ctx, "um from the target", "fibres");
    counts.forEach((bins, k) => {
      const shown = k === this.shown, color = colors.series[k % colors.series.length];
      const points = bins.flatMap((count, bin) => [(bin / LENGTHS) * far, count, ((bin + 1) / LENGTHS) * far, count]);
      if (shown) axes.band(ctx, points.flatMap((value, i) => (i % 2 ? [0, value] : [value])), color, 0.25);
      axes.curve(ctx, points, color, shown ? 2 : 1.2);
      const text = `${imageName(k)}: ${rms(all[k]).toFixed(1)} um rms`, right = box.left + box.width - 4, y = box.top + 10 + 15 * k;
      write(ctx, text, right, y, colors.ink, "right");
      const left = right - ctx.measureText(text).width;
      line(ctx, [left - 22, y], [left - 6, y], color, shown ? 3 : 1.6);
    });
  }

  robotAt(x, y) {
    const { plane } = this.app.recording;
    let nearest, least = 12;
    for (let row = 0; row < plane.n; row++) {
      const [px, py] = this.camera.toPixel(plane.center[2 * row], plane.center[2 * row + 1]), away = Math.hypot(px - x, py - y);
      if (away < least) [nearest, least] = [row, away];
    }
    return nearest;
  }
}
