// SPDX-License-Identifier: Apache-2.0
// Panel 7: how many motors of each power supply turn at once, and how many may.
import { cleared, colors } from "./theme.js";
import { Axes } from "./axes.js";

/** Returns the share of the motors of a supply that turn, over time, as steps: time, percent, ... */
export function motorSteps(motors, supply) {
  const points = [], all = motors.all[supply];
  for (let k = 0; k < motors.bins; k++) {
    const share = (100 * motors.turning[supply * motors.bins + k]) / all;
    points.push(k * motors.bin, share, (k + 1) * motors.bin, share);
  }
  return points;
}

/** Returns the supply of which the largest share turns at once, that share [%], and when [s]. */
export function busiestSupply(motors) {
  let most = { supply: 0, share: -1, time: 0 };
  motors.turning.forEach((count, at) => {
    const supply = Math.floor(at / motors.bins), share = (100 * count) / motors.all[supply];
    if (share > most.share) most = { supply, share, time: (at % motors.bins) * motors.bin };
  });
  return most;
}

export class MotorsPanel {
  constructor(canvas, note, app) {
    Object.assign(this, { canvas, note, app });
    const { motors } = app.recording;
    canvas.closest(".panel").hidden = !motors;
    if (!motors) return;
    const { supply, share, time } = busiestSupply(motors), many = motors.supplies > 1 ? ` of ${motors.supplies} supplies` : "";
    this.busiest = supply;
    note.textContent = `at most ${share.toFixed(1)} % of the motors of supply ${motors.ids[supply]}${many}, ` +
      `at ${time.toFixed(2)} s; ${(100 * motors.cap).toFixed(1)} % may (dashed)`;
    canvas.addEventListener("pointerdown", (event) => {
      const x = event.clientX - canvas.getBoundingClientRect().left;
      if (this.axes) app.seek(((x - this.axes.left) / this.axes.width) * this.axes.xHigh);
    });
  }

  draw(t) {
    const { motors } = this.app.recording, { ctx, width, height } = cleared(this.canvas);
    const end = motors.bins * motors.bin;
    this.axes = new Axes({ left: 48, top: 18, width: width - 58, height: height - 50 }, [0, end], [0, 105]);
    this.axes.frame(ctx, "s", "% of the motors of a supply");
    for (let supply = 0; supply < motors.supplies; supply++) {
      if (supply !== this.busiest) this.axes.curve(ctx, motorSteps(motors, supply), colors.plan, 1);
    }
    this.axes.curve(ctx, motorSteps(motors, this.busiest), colors.accent, 2);
    this.axes.curve(ctx, [0, 100 * motors.cap, end, 100 * motors.cap], colors.failed, 1.4, [6, 4]);
    this.axes.cursor(ctx, t);
  }
}
