// SPDX-License-Identifier: Apache-2.0
// The gap between the outlines of two robots, and its place. It is only for drawing: the
// certificate is made in Python (fiber_core.clearance) before any robot moves.

/**
 * Returns {gap, from: [x, y], to: [x, y]} [mm] of two lists of hulls, as outlinesOf returns them.
 * The gap of overlapping hulls is zero.
 */
export function gapBetween(hulls, others) {
  let best = { gap: Infinity, from: null, to: null };
  for (const a of hulls) {
    for (const b of others) {
      const found = hullGap(a, b, best.gap + a.radius + b.radius);
      if (found && found.gap < best.gap) best = found;
    }
  }
  return best;
}

function hullGap(a, b, cutoff) {
  let best = null, least = cutoff;
  if (contains(a.points, b.points[0], b.points[1]) || contains(b.points, a.points[0], a.points[1])) {
    const at = [b.points[0], b.points[1]];
    return { gap: 0, from: at, to: at };
  }
  for (const [ax, ay, aux, auy] of edges(a.points)) {
    for (const [bx, by, bux, buy] of edges(b.points)) {
      const near = closestPoints(ax, ay, aux, auy, bx, by, bux, buy);
      if (near.distance < least) [best, least] = [near, near.distance];
    }
  }
  if (!best) return null;
  // from the lines of the hulls to the rounded outlines
  const { distance: d, from, to } = best;
  const [ux, uy] = d > 0 ? [(to[0] - from[0]) / d, (to[1] - from[1]) / d] : [0, 0];
  return {
    gap: Math.max(0, d - a.radius - b.radius),
    from: [from[0] + a.radius * ux, from[1] + a.radius * uy],
    to: [to[0] - b.radius * ux, to[1] - b.radius * uy],
  };
}

function edges(points) {
  const count = points.length / 2;
  const found = [];
  // two vertices make one edge, one vertex makes an edge of length 0
  for (let v = 0; v < Math.max(1, count === 2 ? 1 : count); v++) {
    const w = (v + 1) % count;
    const [x, y] = [points[2 * v], points[2 * v + 1]];
    found.push([x, y, points[2 * w] - x, points[2 * w + 1] - y]);
  }
  return found;
}

function contains(points, x, y) {
  const count = points.length / 2;
  if (count < 3) return false;
  for (let v = 0; v < count; v++) {
    const w = (v + 1) % count;
    const [ax, ay] = [points[2 * v], points[2 * v + 1]];
    if ((points[2 * w] - ax) * (y - ay) - (points[2 * w + 1] - ay) * (x - ax) < 0) return false;
  }
  return true;
}

// Closest points of two line segments a + s u and b + t v, s and t in 0..1.
function closestPoints(ax, ay, ux, uy, bx, by, vx, vy) {
  const cross = ux * vy - uy * vx, dx = bx - ax, dy = by - ay;
  if (cross !== 0) {
    const s = (dx * vy - dy * vx) / cross, t = (dx * uy - dy * ux) / cross;
    if (s >= 0 && s <= 1 && t >= 0 && t <= 1) {
      const at = [ax + s * ux, ay + s * uy];
      return { distance: 0, from: at, to: at };
    }
  }
  // line segments that do not cross are closest at an end of one of them
  const ends = [
    [ax, ay, ...footOn(ax, ay, bx, by, vx, vy), false],
    [ax + ux, ay + uy, ...footOn(ax + ux, ay + uy, bx, by, vx, vy), false],
    [bx, by, ...footOn(bx, by, ax, ay, ux, uy), true],
    [bx + vx, by + vy, ...footOn(bx + vx, by + vy, ax, ay, ux, uy), true],
  ];
  let best = { distance: Infinity };
  for (const [px, py, qx, qy, swapped] of ends) {
    const distance = Math.hypot(px - qx, py - qy);
    if (distance < best.distance) {
      const [from, to] = swapped ? [[qx, qy], [px, py]] : [[px, py], [qx, qy]];
      best = { distance, from, to };
    }
  }
  return best;
}

function footOn(px, py, ax, ay, ux, uy) {
  const square = ux * ux + uy * uy;
  const s = square > 0 ? Math.min(1, Math.max(0, ((px - ax) * ux + (py - ay) * uy) / square)) : 0;
  return [ax + s * ux, ay + s * uy];
}
