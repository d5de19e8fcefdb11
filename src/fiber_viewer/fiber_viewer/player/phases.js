// SPDX-License-Identifier: Apache-2.0
// The executed motion of a recording: its orders, cut where robots stopped, and the rests between
// phases. The same as fiber_recording.phases in Python.
import { unroll } from "./kinematics.js";

const SAME_INSTANT_S = 1e-7; // instants this close to each other are the same
const SETTLING_S = 1e-4; // time in which a robot moves from the cut of its orders to where it stopped
const MICROSECOND = 1e-6;

/**
 * Returns the motion of all phases, with two more members. `phases` is [{begin, stop}] in seconds;
 * stop is null if no robot was stopped. `active.ends[phase * n + row]` is when a robot reached the
 * end of its orders or was stopped, NaN if it had no orders; `active.stops` is when it was stopped or
 * stopped by itself, NaN if it did not.
 */
export function motionOf(arrays, units) {
  const quantum = units.quantum_prad * 1e-12, tick = units.tick_us * MICROSECOND;
  const start = Array.from(arrays.start_counts.data), profiles = start.length, n = profiles / 2;
  const begins = arrays.leg_begin_us ? Array.from(arrays.leg_begin_us.data, (us) => us * MICROSECOND) : [0];
  const pieces = Array.from({ length: profiles }, () => []);
  const ends = new Float64Array(begins.length * n).fill(NaN), stops = ends.slice(), counts = start.slice();
  const place = Float64Array.from(start, (count) => count * quantum);
  const phases = begins.map((begin, phase) => {
    let lastStop = null;
    for (let p = 0; p < profiles; p++) {
      const row = p >> 1, own = phase * n + row;
      const us = arrays.leg_stop_us ? arrays.leg_stop_us.data[own] : -1;
      const stop = us < 0 ? Infinity : us * MICROSECOND;
      const first = arrays.offsets.data[phase * (profiles + 1) + p];
      const after = arrays.offsets.data[phase * (profiles + 1) + p + 1];
      let t = begin;
      for (let k = first; k < after; k++) {
        const lasts = arrays.ticks.data[k] * tick, done = Math.min(lasts, stop - t);
        const velocity = arrays.velocity.data[k] * (quantum / tick);
        if (done > 0) pieces[p].push([t, done, velocity]);
        if (done > 0) place[p] += done * velocity;
        counts[p] += arrays.ticks.data[k] * arrays.velocity.data[k];
        t += lasts;
      }
      if (after > first) ends[own] = Math.max(Number.isNaN(ends[own]) ? 0 : ends[own], Math.min(t, stop));
      if (stop === Infinity) continue;
      stops[own] = stop;
      lastStop = Math.max(lastStop ?? 0, stop);
      counts[p] = arrays.leg_stop_counts.data[phase * profiles + p];
      const off = counts[p] * quantum - place[p];
      if (Math.abs(off) <= 1e-3 * quantum) continue;
      const lasts = Math.min(SETTLING_S, (begins[phase + 1] ?? Infinity) - stop);
      pieces[p].push([stop, lasts, off / lasts]);
      place[p] += off;
    }
    return { begin, stop: lastStop };
  });
  return unroll({ ...segmentsOf(pieces), start: Float64Array.from(start, (c) => c * quantum), quantum, tick, phases, active: { ends, stops } });
}

// Segments from pieces [begin, duration, velocity] of each profile, with rests between them.
function segmentsOf(pieces) {
  const offsets = [0], duration = [], velocity = [];
  for (const own of pieces) {
    let end = 0;
    for (const [begin, lasts, speed] of own) {
      if (begin - end > SAME_INSTANT_S) {
        duration.push(begin - end);
        velocity.push(0);
      }
      duration.push(lasts);
      velocity.push(speed);
      end = begin + lasts;
    }
    offsets.push(duration.length);
  }
  return { offsets: Int32Array.from(offsets), duration: Float64Array.from(duration), velocity: Float64Array.from(velocity) };
}

/** Returns the times in which all robots were stopped: [[from, to], ...]. */
export function pausesOf(motion) {
  return motion.phases.slice(1).map(({ begin }, phase) => [motion.phases[phase].stop ?? begin, begin]);
}
