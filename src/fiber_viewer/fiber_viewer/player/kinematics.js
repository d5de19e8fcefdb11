// SPDX-License-Identifier: Apache-2.0
// Joint angles at a time, and places of elbows and tips. The tests compare the numbers with
// fiber_core.kinematics and fiber_core.motion.SegmentMotion.
//
// The profiles of a robot are 2 row (theta) and 2 row + 1 (phi). Profile p has the segments
// offsets[p] .. offsets[p + 1].

/** Adds begin time and begin angle of every segment, end time of every profile, and makespan. */
export function unroll(motion) {
  const { start, offsets, duration, velocity } = motion;
  motion.begin = new Float64Array(duration.length);
  motion.angle = new Float64Array(duration.length);
  motion.end = new Float64Array(start.length);
  motion.makespan = 0;
  for (let p = 0; p < start.length; p++) {
    let t = 0, q = start[p];
    for (let k = offsets[p]; k < offsets[p + 1]; k++) {
      motion.begin[k] = t;
      motion.angle[k] = q;
      t += duration[k];
      q += duration[k] * velocity[k];
    }
    motion.end[p] = t;
    if (t > motion.makespan) motion.makespan = t;
  }
  return motion;
}

/** Returns the segment of a profile at time t, -1 before the first and after the last. */
export function segmentAt(motion, profile, t) {
  if (!(t >= 0 && t < motion.end[profile])) return -1;
  let low = motion.offsets[profile], high = motion.offsets[profile + 1] - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (motion.begin[middle] <= t) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Returns the angle of a profile at time t [rad]. */
export function angleAt(motion, profile, t) {
  if (t <= 0 || motion.offsets[profile] === motion.offsets[profile + 1]) return motion.start[profile];
  const last = motion.offsets[profile + 1] - 1;
  const k = segmentAt(motion, profile, t);
  if (k < 0) return motion.angle[last] + motion.duration[last] * motion.velocity[last];
  return motion.angle[k] + (t - motion.begin[k]) * motion.velocity[k];
}

/** Returns the velocity of a profile at time t [rad/s]. */
export function velocityAt(motion, profile, t) {
  const k = segmentAt(motion, profile, t);
  return k < 0 ? 0 : motion.velocity[k];
}

/** Writes the angles of all profiles at time t into `out`. */
export function anglesOfAll(motion, t, out) {
  for (let p = 0; p < out.length; p++) out[p] = angleAt(motion, p, t);
  return out;
}

/** Returns elbow and tip [mm] of a robot for joint angles: equation 1 of Makarem et al. (2014a). */
export function forward(plane, row, theta, phi) {
  const elbowX = plane.center[2 * row] + plane.arm[2 * row] * Math.cos(theta);
  const elbowY = plane.center[2 * row + 1] + plane.arm[2 * row] * Math.sin(theta);
  const direction = theta + phi;
  return [
    elbowX, elbowY,
    elbowX + plane.arm[2 * row + 1] * Math.cos(direction),
    elbowY + plane.arm[2 * row + 1] * Math.sin(direction),
  ];
}

/** Writes elbow x, y and tip x, y [mm] of every robot into `out`, shape (n, 4). */
export function placesOfAll(plane, angles, out) {
  for (let row = 0; row < plane.n; row++) {
    const theta = angles[2 * row], direction = theta + angles[2 * row + 1];
    const x = plane.center[2 * row] + plane.arm[2 * row] * Math.cos(theta);
    const y = plane.center[2 * row + 1] + plane.arm[2 * row] * Math.sin(theta);
    out[4 * row] = x;
    out[4 * row + 1] = y;
    out[4 * row + 2] = x + plane.arm[2 * row + 1] * Math.cos(direction);
    out[4 * row + 3] = y + plane.arm[2 * row + 1] * Math.sin(direction);
  }
  return out;
}

/**
 * Returns the outlines of a robot [mm] as hulls {points: [x, y, ...], radius}, phi arm first.
 * A robot without a theta outline has one hull.
 */
export function outlinesOf(plane, row, theta, phi) {
  const [elbowX, elbowY] = forward(plane, row, theta, phi);
  const hulls = [placedHull(plane.phi, row, elbowX, elbowY, theta + phi)];
  if (plane.theta.count) {
    hulls.push(placedHull(plane.theta, row, plane.center[2 * row], plane.center[2 * row + 1], theta));
  }
  return hulls;
}

function placedHull(outline, row, x, y, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  const points = new Float64Array(2 * outline.count);
  for (let v = 0; v < outline.count; v++) {
    const at = 2 * (row * outline.count + v);
    const [vx, vy] = [outline.vertices[at], outline.vertices[at + 1]];
    points[2 * v] = x + c * vx - s * vy;
    points[2 * v + 1] = y + s * vx + c * vy;
  }
  return { points, radius: outline.radius[row] };
}
