// SPDX-License-Identifier: Apache-2.0
// The connection to the console: what a running plane sends, as a recording that goes on.
import { readNpz } from "./npz.js";
import { DISABLED, FAILED, HELD, IDLE, MOVING, REACHED, WAITING, isAsked, planeOf } from "./recording.js";

const RETRY_MS = 500; // time between two attempts to reach the console
const NO_OUTCOME = 255;
const ARRIVED_MM = 0.1; // distance from its target within which a robot is shown as there

/** Returns a plane, its targets and outcomes from the bytes of plane.npz, in the form of a recording. */
export async function openPlane(bytes) {
  const arrays = await readNpz(bytes), plane = planeOf(arrays);
  return {
    plane,
    about: JSON.parse(new TextDecoder().decode(arrays.about.data)),
    outcome: arrays.outcome.data,
    reason: arrays.reason.data,
    error: arrays.error_mm.data,
    pairs: [],
    states: new Uint8Array(plane.n).fill(IDLE),
    speeds: new Float32Array(2 * plane.n),
  };
}

/** Sets the state of every robot from its speeds, its outcome, and before there is one its place. */
export function setStates(recording, places) {
  const { plane, outcome, speeds, states } = recording, { target } = plane;
  for (let row = 0; row < plane.n; row++) {
    if (!plane.enabled[row]) states[row] = DISABLED;
    else if (speeds[2 * row] !== 0 || speeds[2 * row + 1] !== 0) states[row] = MOVING;
    else if (outcome[row] === NO_OUTCOME) {
      const away = Math.hypot(places[4 * row + 2] - target[2 * row], places[4 * row + 3] - target[2 * row + 1]);
      states[row] = !isAsked(plane, row) ? IDLE : away < ARRIVED_MM ? REACHED : WAITING;
    }
    else if (outcome[row] === 0) states[row] = REACHED;
    else if (outcome[row] === 2) states[row] = FAILED;
    else states[row] = isAsked(plane, row) ? HELD : IDLE;
  }
}

/**
 * Keeps a WebSocket to the console open. Calls on.motion(angles, speeds), on.status(message),
 * on.answer(message) and on.connected(whether).
 */
export class Connection {
  constructor(token, on) {
    Object.assign(this, { token, on });
    this.number = 0;
    this.connect();
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/live?token=${encodeURIComponent(this.token)}`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.addEventListener("open", () => this.on.connected(true));
    socket.addEventListener("close", () => {
      this.on.connected(false);
      setTimeout(() => this.connect(), RETRY_MS);
    });
    socket.addEventListener("message", ({ data }) => {
      if (data instanceof ArrayBuffer) {
        const values = new Float32Array(data), half = values.length / 2;
        this.on.motion(values.subarray(0, half), values.subarray(half));
        return;
      }
      const message = JSON.parse(data);
      this.on[message.kind](message);
    });
  }

  /** Sends an order; returns its number, which its answer has too, null without a connection. */
  order(order, more = {}) {
    if (this.socket.readyState !== WebSocket.OPEN) return null;
    this.number += 1;
    this.socket.send(JSON.stringify({ number: this.number, order, ...more }));
    return this.number;
  }

  /** Returns the bytes of plane.npz, null if the console knows no plane yet. */
  async fetchPlane() {
    const answer = await fetch(`/plane.npz?token=${encodeURIComponent(this.token)}`);
    return answer.ok ? new Uint8Array(await answer.arrayBuffer()) : null;
  }
}
