// SPDX-License-Identifier: Apache-2.0
// The line at the bottom: number of moving robots, closest approaches, faults, and the time.
import { MOVING, faultsOf, stateAt } from "./recording.js";
import { pausesOf } from "./phases.js";
import { niceTicks } from "./axes.js";
import { cleared, colors, label, write } from "./theme.js";
import { disc, line } from "./drawing.js";

const SAMPLES = 240;
const APPROACHES = 20; // that are marked
const SNAP_PX = 6; // a click this close to a mark goes to the mark

export class Timeline {
  constructor(canvas, app) {
    Object.assign(this, { canvas, app });
    const { motion, plane, pairs } = app.recording;
    this.moving = new Float64Array(SAMPLES + 1);
    for (let k = 0; k < SAMPLES; k++) {
      const t = (k / SAMPLES) * motion.makespan;
      for (let row = 0; row < plane.n; row++) this.moving[k] += stateAt(app.recording, row, t) === MOVING;
    }
    this.pauses = pausesOf(motion);
    this.approaches = pairs.slice(0, APPROACHES);
    this.faults = faultsOf(app.recording);
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.scrub(event, true);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) this.scrub(event, false);
    });
  }

  x(t) {
    const { begin, end } = this.app.recording, inset = 8;
    return inset + ((t - begin) / (end - begin)) * (this.canvas.clientWidth - 2 * inset);
  }

  scrub(event, maySnap) {
    const { begin, end } = this.app.recording, inset = 8;
    const px = event.clientX - this.canvas.getBoundingClientRect().left;
    const time = begin + ((px - inset) / (this.canvas.clientWidth - 2 * inset)) * (end - begin);
    const near = (marks) => marks.find((mark) => Math.abs(this.x(mark.time) - px) < SNAP_PX);
    const fault = maySnap && near(this.faults), approach = maySnap && near(this.approaches);
    if (fault) this.app.goToFault(fault);
    else if (approach) this.app.goToApproach(approach);
    else this.app.seek(time);
  }

  /** Writes round times below the line. */
  drawTicks(ctx, base) {
    const { begin, end } = this.app.recording;
    for (const tick of niceTicks(begin, end, this.canvas.clientWidth / 90)) {
      const x = this.x(tick), text = `${Number(tick.toFixed(4))} s`;
      line(ctx, [x, base + 3], [x, base + 7], colors.soft, 1);
      label(ctx, text, Math.min(Math.max(x, 14), this.canvas.clientWidth - 14), base + 14, colors.soft, "center");
    }
  }

  draw(t) {
    const { ctx, height } = cleared(this.canvas);
    const { begin, end, motion } = this.app.recording;
    const base = height - 20, top = 15, most = Math.max(...this.moving, 1);
    ctx.beginPath();
    ctx.moveTo(this.x(0), base);
    for (let k = 0; k <= SAMPLES; k++) {
      ctx.lineTo(this.x((k / SAMPLES) * motion.makespan), base - (base - top) * (this.moving[k] / most));
    }
    ctx.lineTo(this.x(motion.makespan), base);
    ctx.fillStyle = colors.moving;
    ctx.globalAlpha = 0.22;
    ctx.fill();
    ctx.globalAlpha = 1;
    line(ctx, [this.x(begin), base], [this.x(end), base], colors.line, 3);
    line(ctx, [this.x(begin), base], [this.x(t), base], colors.accent, 3);
    line(ctx, [this.x(0), base - 5], [this.x(0), base + 5], colors.soft, 1.5);
    for (const [from, to] of this.pauses) {
      ctx.fillStyle = colors.stopped;
      ctx.globalAlpha = 0.25;
      ctx.fillRect(this.x(from), top - 2, this.x(to) - this.x(from), base - top);
      ctx.globalAlpha = 1;
      if (this.x(to) - this.x(from) > 50) write(ctx, "stopped", (this.x(from) + this.x(to)) / 2, top + 8, colors.ink, "center");
    }
    for (const { time } of this.approaches) diamond(ctx, this.x(time), 7, 4, colors.gap);
    for (const { time } of this.faults) cross(ctx, this.x(time), 7, 4, colors.failed);
    this.drawTicks(ctx, base);
    line(ctx, [this.x(t), 2], [this.x(t), base], colors.accent, 1.6);
    disc(ctx, [this.x(t), base], 6, colors.accent);
    this.canvas.setAttribute("aria-valuetext", `${t.toFixed(3)} seconds`);
    this.canvas.setAttribute("aria-valuemin", begin.toFixed(3));
    this.canvas.setAttribute("aria-valuemax", end.toFixed(3));
    this.canvas.setAttribute("aria-valuenow", t.toFixed(3));
    if (begin < 0 && this.x(0) > 60) write(ctx, "loading", this.x(0) - 6, base - 12, colors.soft, "right");
  }
}

function diamond(ctx, x, y, r, color) {
  ctx.beginPath();
  ctx.moveTo(x, y - r);
  ctx.lineTo(x + r, y);
  ctx.lineTo(x, y + r);
  ctx.lineTo(x - r, y);
  ctx.closePath();
  ctx.fillStyle = color;
  ctx.fill();
}

function cross(ctx, x, y, r, color) {
  line(ctx, [x - r, y - r], [x + r, y + r], color, 2);
  line(ctx, [x - r, y + r], [x + r, y - r], color, 2);
}
