// SPDX-License-Identifier: Apache-2.0
// The console: a running plane as its encoders tell, its stages, alerts, buses and last plans, and orders.
import { STATE_NAMES, stateAt } from "./recording.js";
import { placesOfAll } from "./kinematics.js";
import { setTheme } from "./theme.js";
import { Coloring, placeModes, speedMode, stateMode } from "./coloring.js";
import { reachOf } from "./drawing.js";
import { PlanePanel } from "./plane.js";
import { NeighbourhoodPanel } from "./neighbourhood.js";
import { readAddress } from "./address.js";
import { Connection, openPlane, setStates } from "./live.js";
import { Orders } from "./orders.js";

const MOST_WATCHED = 3;
const GLIDE_MS = 50; // from one reading of the encoders to the next
const ALERTS_SHOWN = 30;

const element = (id) => document.getElementById(id);

class Console {
  constructor() {
    this.t = 0;
    this.robots = [];
    this.marked = [];
    this.frames = 0; // pictures of moving robots so far
    this.listen();
    this.connection = new Connection(new URLSearchParams(location.search).get("token") ?? "", {
      connected: (whether) => this.connected(whether),
      motion: (angles, speeds) => this.move(angles, speeds),
      status: (message) => this.showStatus(message),
      answer: (message) => this.answered(message),
    });
    this.orders = new Orders(this, (order, more) => this.connection.order(order, more), {
      buttons: element("orders"), dialog: element("confirm"), heading: element("confirm-title"),
      text: element("confirm-text"), robotsBox: element("confirm-robots"), ids: element("robots"),
      why: element("why"), whyLabel: element("why-label"), yes: element("confirm-yes"), answers: element("answers"),
    });
  }

  connected(whether) {
    this.isConnected = whether;
    element("problem").textContent = "The console does not answer; the robots do not depend on it. Trying again.";
    element("problem").hidden = whether;
    this.version = null;
    document.body.classList.toggle("lost", !whether);
    if (!whether) this.orders?.lost();
  }

  answered(message) {
    this.orders.answered(message);
    if (this.newest) this.move(...this.newest); // what came while a stop waited
  }

  /** Opens the plane again when its version has changed: another layout, targets or outcome. */
  async openPlane(version) {
    if (this.version === version) return;
    this.version = version;
    const bytes = await this.connection.fetchPlane();
    if (!bytes) return;
    const recording = await openPlane(bytes);
    if (this.version !== version) return; // a newer one was asked for meanwhile
    const { plane } = recording, sameRobots = this.recording?.plane.ids.join() === plane.ids.join();
    if (sameRobots) recording.speeds.set(this.recording.speeds);
    this.recording = recording;
    if (!sameRobots) {
      this.robots = [];
      this.angles = new Float64Array(2 * plane.n);
      this.before = this.after = null;
      this.places = new Float64Array(4 * plane.n);
      this.neighbours = { get: (row) => neighboursOf(this.recording.plane, row) };
      this.coloring = new Coloring({
        state: stateMode("state", (row, t) => stateAt(this.recording, row, t)),
        ...placeModes(plane),
        speed: speedMode(plane, (profile) => this.recording.speeds[profile]),
      });
      element("coloring").replaceChildren(...Object.entries(this.coloring.modes).map(([key, { name }]) => new Option(name, key)));
      if (!this.plane) {
        this.plane = new PlanePanel(element("plane"), this);
        this.neighbourhood = new NeighbourhoodPanel(element("neighbourhood"), element("neighbourhood-note"), this);
      }
      this.plane.robotsChanged();
    }
    this.refreshStates();
    if (this.newest) this.move(...this.newest);
    this.redraw();
  }

  refreshStates() {
    setStates(this.recording, placesOfAll(this.recording.plane, this.after ?? this.angles, this.places));
    this.marked = Array.from(this.recording.plane.ids.keys());
  }

  move(angles, speeds) {
    this.newest = [angles, speeds];
    if (this.orders.isStopping || !this.recording || angles.length !== this.angles.length) return;
    this.before = this.after ? Float64Array.from(this.angles) : angles;
    this.after = angles;
    this.arrived = performance.now();
    this.recording.speeds.set(speeds);
    this.refreshStates();
    this.redraw();
  }

  redraw() {
    if (this.waiting || !this.recording) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      if (this.orders.isStopping) this.redraw();
      else this.frame();
    });
  }

  frame() {
    const { recording, before, after } = this;
    if (after) {
      const share = Math.min(1, (performance.now() - this.arrived) / GLIDE_MS);
      for (let p = 0; p < after.length; p++) this.angles[p] = before[p] + share * (after[p] - before[p]);
      if (share < 1) this.redraw();
      this.frames += 1;
      placesOfAll(recording.plane, this.angles, this.places);
      this.plane.draw(0, this.angles, this.places);
      this.neighbourhood.draw(0, this.angles);
    }
    this.coloring.showLegend(element("legend"), recording.plane.n, 0);
  }

  showStatus(message) {
    const { stages, alerts, buses, plans, ready, ended, version, nodes } = message;
    this.openPlane(version);
    this.ready = ready;
    element("orders").querySelector("[data-order=start]").disabled = !ready;
    const moving = this.recording?.states.some((state) => STATE_NAMES[state] === "moving");
    const result = ended ? `Plan ${ended.plan}: ${ended.reached} reached, ${ended.held} held, ${ended.failed} failed` : null;
    const waiting = this.recording ? "No plan has ended yet" : "Waiting for the plane";
    element("title").textContent = ready && !moving ? `Plan ${ready} can be started` : result ?? waiting;
    const size = this.recording && `${this.recording.plane.n} robots`, names = nodes.map(({ name }) => name).join(", ");
    element("subtitle").textContent = [size, names].filter(Boolean).join("  ·  ");
    fill("stages", stages.map(({ stage, fraction, text, plan, refused }) => row(
      refused ? "error" : "", `${stage} ${Math.round(100 * fraction)} %`, `${text} (plan ${plan})`)), "no stage has worked yet");
    fill("alerts", alerts.slice(-ALERTS_SHOWN).reverse().map(({ text, level }) => row(level, text)), "none");
    fill("buses", buses.map(({ name, level, text }) => row(level, name.replace("bridge: ", ""), text)), "no bus is known yet");
    fill("plans", plans.map((name) => {
      const item = document.createElement("li"), link = document.createElement("a");
      link.href = `/plans/${name}.html?token=${encodeURIComponent(this.connection.token)}`;
      link.target = "_blank";
      link.rel = "noopener";
      link.textContent = name;
      item.append(link);
      return item;
    }), "no plan was recorded yet");
  }

  watch(row, add = false) {
    const others = add ? this.robots.filter((other) => other !== row) : [];
    this.robots = [row, ...others].slice(0, MOST_WATCHED);
    this.redraw();
  }

  showHint(row) {
    const { plane } = this.recording;
    element("hint").textContent = row < 0 ? "" : `robot ${plane.ids[row]}, ${STATE_NAMES[stateAt(this.recording, row, 0)]}`;
  }

  listen() {
    element("coloring").addEventListener("change", (event) => {
      this.coloring.choose(event.target.value);
      this.redraw();
    });
    const onPlane = (id, action) => element(id).addEventListener("click", () => this.plane && action());
    onPlane("zoom-in", () => this.plane.zoom(1.5));
    onPlane("zoom-out", () => this.plane.zoom(1 / 1.5));
    onPlane("zoom-fit", () => this.plane.reset());
    onPlane("zoom-watched", () => this.robots.length && this.plane.zoomTo(this.robots[0]));
    element("theme").addEventListener("click", () => {
      setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
      this.redraw();
    });
    new ResizeObserver(() => this.redraw()).observe(document.body);
  }
}

// Robots that can come near a robot.
function neighboursOf(plane, row) {
  const near = [], own = reachOf(plane, row);
  for (let other = 0; other < plane.n; other++) {
    const away = Math.hypot(plane.center[2 * row] - plane.center[2 * other], plane.center[2 * row + 1] - plane.center[2 * other + 1]);
    if (other !== row && away < own + reachOf(plane, other)) near.push(other);
  }
  return near;
}

function row(level, name, text = "") {
  const item = document.createElement("li"), bold = document.createElement("b");
  item.className = level;
  bold.textContent = name;
  item.append(bold, text && ` ${text}`);
  return item;
}

// Fills a list, if it changed: a list that is filled anew loses its place and its focus.
function fill(id, rows, none) {
  const list = element(id), content = rows.length ? rows : [row("none", none)];
  const text = content.map((item) => `${item.className} ${item.textContent}`).join("\n");
  if (list.shown === text) return;
  list.shown = text;
  list.replaceChildren(...content);
}

setTheme(readAddress(location.hash).theme);
globalThis.player = new Console();
