// From the orders of a recording to the motion as it was carried out: what robots were sent, as
// far as they got with it, the rests between. The same as fiber_recording.phases in Python.
import { unroll } from "./kinematics.js";

const SAME_S = 1e-7; // instants this near to each other are one
const SETTLING_S = 1e-4; // in which a robot comes from where its orders were cut to where it stood
const MICROSECOND = 1e-6;

/**
 * Returns the motion of all phases, with `phases` [{begin, stop}] in seconds (stop is null where
 * nobody was stopped), and `active.ends`: when each robot of each phase came to its end or was
 * stopped, at [phase * n + row], NaN where it had no orders.
 */
export function motionOf(arrays, units) {
  const quantum = units.quantum_prad * 1e-12, tick = units.tick_us * MICROSECOND;
  const from = Array.from(arrays.start_counts.data), profiles = from.length, n = profiles / 2;
  const begins = arrays.leg_begin_us ? Array.from(arrays.leg_begin_us.data, (us) => us * MICROSECOND) : [0];
  const pieces = Array.from({ length: profiles }, () => []);
  const ends = new Float64Array(begins.length * n).fill(NaN), counts = from.slice();
  const place = Float64Array.from(from, (count) => count * quantum);
  const phases = begins.map((begin, phase) => {
    let last = null;
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
      last = Math.max(last ?? 0, stop);
      counts[p] = arrays.leg_stop_counts.data[phase * profiles + p];
      const off = counts[p] * quantum - place[p];
      if (Math.abs(off) <= 1e-3 * quantum) continue;
      const lasts = Math.min(SETTLING_S, (begins[phase + 1] ?? Infinity) - stop);
      pieces[p].push([stop, lasts, off / lasts]);
      place[p] += off;
    }
    return { begin, stop: last };
  });
  return unroll({ ...joined(pieces), start: Float64Array.from(from, (c) => c * quantum), quantum, tick, phases, active: { ends } });
}

// All pieces one after the other, with rests where one does not begin at the end of another.
function joined(pieces) {
  const offsets = [0], duration = [], velocity = [];
  for (const own of pieces) {
    let end = 0;
    for (const [begin, lasts, turn] of own) {
      if (begin - end > SAME_S) {
        duration.push(begin - end);
        velocity.push(0);
      }
      duration.push(lasts);
      velocity.push(turn);
      end = begin + lasts;
    }
    offsets.push(duration.length);
  }
  return { offsets: Int32Array.from(offsets), duration: Float64Array.from(duration), velocity: Float64Array.from(velocity) };
}

/** Returns the times from a stop of all to where some went on: [[from, to], ...]. */
export function pausesOf(motion) {
  return motion.phases.slice(1).map(({ begin }, phase) => [motion.phases[phase].stop ?? begin, begin]);
}
