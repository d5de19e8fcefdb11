// SPDX-License-Identifier: Apache-2.0
// Axes of a plot: from numbers to pixels, with round ticks and a frame.
import { colors, write } from "./theme.js";

/** Returns round numbers between two values, about `count` of them. */
export function niceTicks(low, high, count) {
  const rough = (high - low) / Math.max(1, count);
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].find((m) => m * power >= rough) * power;
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) ticks.push(k * step);
  return ticks;
}

export class Axes {
  /** A plot in a box [pixels] over ranges of x and y. */
  constructor({ left, top, width, height }, [xLow, xHigh], [yLow, yHigh]) {
    Object.assign(this, { left, top, width, height, xLow, xHigh, yLow, yHigh });
  }

  x(value) {
    return this.left + ((value - this.xLow) / (this.xHigh - this.xLow)) * this.width;
  }

  y(value) {
    return this.top + this.height - ((value - this.yLow) / (this.yHigh - this.yLow)) * this.height;
  }

  /** Draws grid, numbers and names. */
  frame(ctx, xName, yName, digits = 2) {
    ctx.strokeStyle = colors.line;
    ctx.lineWidth = 1;
    for (const tick of niceTicks(this.yLow, this.yHigh, this.height / 34)) {
      this.rule(ctx, this.left, this.y(tick), this.left + this.width, this.y(tick));
      write(ctx, String(Number(tick.toFixed(6))), this.left - 6, this.y(tick), colors.soft, "right");
    }
    for (const tick of niceTicks(this.xLow, this.xHigh, this.width / 70)) {
      this.rule(ctx, this.x(tick), this.top, this.x(tick), this.top + this.height);
      const text = String(Number(tick.toFixed(digits + 1)));
      write(ctx, text, this.x(tick), this.top + this.height + 10, colors.soft, "center");
    }
    if (xName) write(ctx, xName, this.left + this.width, this.top + this.height + 23, colors.soft, "right");
    if (yName) write(ctx, yName, this.left, this.top - 9, colors.ink);
  }

  /** Draws a line through points given as x, y, x, y, ... */
  curve(ctx, values, color, width, dash = []) {
    ctx.save();
    this.clip(ctx);
    ctx.beginPath();
    for (let i = 0; i < values.length; i += 2) {
      const [px, py] = [this.x(values[i]), this.y(values[i + 1])];
      if (i) ctx.lineTo(px, py);
      else ctx.moveTo(px, py);
    }
    ctx.setLineDash(dash);
    ctx.strokeStyle = color;
    ctx.lineWidth = width;
    ctx.stroke();
    ctx.restore();
  }

  /** Fills between two lines, given as x, low, high, x, low, high, ... */
  band(ctx, values, color, alpha) {
    ctx.save();
    this.clip(ctx);
    ctx.beginPath();
    for (let i = 0; i < values.length; i += 3) ctx.lineTo(this.x(values[i]), this.y(values[i + 1]));
    for (let i = values.length - 3; i >= 0; i -= 3) ctx.lineTo(this.x(values[i]), this.y(values[i + 2]));
    ctx.closePath();
    ctx.fillStyle = color;
    ctx.globalAlpha = alpha;
    ctx.fill();
    ctx.restore();
  }

  /** Draws points inside the plot as small rings, or filled. */
  dots(ctx, values, color, radius, filled) {
    for (let i = 0; i < values.length; i += 2) {
      if (values[i] < this.xLow || values[i] > this.xHigh) continue;
      ctx.beginPath();
      ctx.arc(this.x(values[i]), this.y(values[i + 1]), radius, 0, 2 * Math.PI);
      if (filled) {
        ctx.fillStyle = color;
        ctx.fill();
      } else {
        ctx.strokeStyle = color;
        ctx.lineWidth = 1.2;
        ctx.stroke();
      }
    }
  }

  /** Draws the cursor at time t. */
  cursor(ctx, t) {
    if (t < this.xLow || t > this.xHigh) return;
    ctx.strokeStyle = colors.accent;
    ctx.lineWidth = 1.2;
    this.rule(ctx, this.x(t), this.top, this.x(t), this.top + this.height);
  }

  clip(ctx) {
    ctx.beginPath();
    ctx.rect(this.left - 1, this.top - 3, this.width + 2, this.height + 6);
    ctx.clip();
  }

  rule(ctx, x0, y0, x1, y1) {
    ctx.beginPath();
    ctx.moveTo(x0, y0);
    ctx.lineTo(x1, y1);
    ctx.stroke();
  }
}
