// SPDX-License-Identifier: Apache-2.0
// Panel 6: the load of each bus, and its events.
import { cleared, colors, write } from "./theme.js";
import { disc, line } from "./drawing.js";
import { Axes } from "./axes.js";

export class BusesPanel {
  constructor(canvas, note, app) {
    Object.assign(this, { canvas, note, app });
    canvas.addEventListener("pointerdown", (event) => {
      const x = event.clientX - canvas.getBoundingClientRect().left;
      if (this.axes) app.seek(this.axes.xLow + ((x - this.axes.left) / this.axes.width) * (this.axes.xHigh - this.axes.xLow));
    });
    const { load, events } = app.recording, sum = (values) => values.reduce((a, b) => a + b, 0);
    const faults = events.filter((event) => event.unexpected);
    const failed = faults.filter((event) => ["no_address", "refused", "bad_reply", "line"].includes(event.kind)).length;
    note.textContent =
      `${sum(load.frames).toLocaleString("en")} frames, ${sum(load.bytes).toLocaleString("en")} bytes on ` +
      `${load.buses} ${load.buses === 1 ? "bus" : "buses"}; ${failed} failed, ${faults.length - failed} faults and alerts`;
  }

  draw(t) {
    const { ctx, width, height } = cleared(this.canvas);
    const picture = [width, height, colors.card].join();
    if (picture !== this.picture) {
      this.picture = picture;
      this.still ??= document.createElement("canvas");
      this.drawStill(ctx, width, height);
      [this.still.width, this.still.height] = [this.canvas.width, this.canvas.height];
      this.still.getContext("2d").drawImage(this.canvas, 0, 0);
    } else {
      ctx.drawImage(this.still, 0, 0, width, height);
    }
    this.axes.cursor(ctx, t);
  }

  /** Draws everything except the cursor. */
  drawStill(ctx, width, height) {
    const { load, begin, end, events } = this.app.recording;
    const box = { left: 48, top: 8, width: width - 58, height: height - 42 };
    this.axes = new Axes(box, [begin, Math.max(end, load.begin + load.bins * load.bin)], [load.buses, 0]);
    const step = box.height / load.buses, most = load.frames.reduce((a, b) => Math.max(a, b), 1);
    ctx.fillStyle = colors.faint;
    ctx.fillRect(box.left, box.top, box.width, box.height);
    for (let bus = 0; bus < load.buses; bus++) {
      ctx.fillStyle = colors.accent;
      for (let k = 0; k < load.bins; k++) {
        const frames = load.frames[bus * load.bins + k];
        if (!frames) continue;
        const from = this.axes.x(load.begin + k * load.bin), to = this.axes.x(load.begin + (k + 1) * load.bin);
        if (to < box.left) continue;
        ctx.globalAlpha = 0.2 + 0.8 * Math.sqrt(frames / most);
        ctx.fillRect(Math.max(from, box.left), box.top + bus * step + 1, Math.max(1, to - from), Math.max(1, step - 2));
      }
      ctx.globalAlpha = 1;
      const every = Math.ceil(13 / step);
      if (bus % every === 0) write(ctx, `bus ${load.ids[bus]}`, box.left - 6, box.top + (bus + 0.5) * step, colors.soft, "right");
    }
    const rowOf = new Map(Array.from(load.ids, (id, at) => [id, at]));
    for (const event of events) {
      const x = this.axes.x(Math.max(event.time, begin)), y = box.top + (rowOf.get(event.bus) + 0.5) * step;
      const half = Math.min(step / 2, 9);
      if (event.unexpected) disc(ctx, [x, y], 4, colors.failed);
      else line(ctx, [x, y - half], [x, y + half], event.kind === "stop" ? colors.failed : colors.ink, 2);
    }
    ctx.save();
    for (const tick of [0, ...this.ticks(box.width)]) {
      write(ctx, String(tick), this.axes.x(tick), box.top + box.height + 11, colors.soft, "center");
    }
    write(ctx, "s", box.left + box.width, box.top + box.height + 24, colors.soft, "right");
    ctx.restore();
  }

  ticks(width) {
    const span = this.axes.xHigh, step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100].find((s) => (s / span) * width > 60) ?? 200;
    return Array.from({ length: Math.floor(span / step) }, (_, i) => Number(((i + 1) * step).toFixed(3)));
  }
}
