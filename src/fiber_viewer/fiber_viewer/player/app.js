// SPDX-License-Identifier: Apache-2.0
// The page: opens the embedded recording, keeps the time, and redraws the panels.
import { fromBase64 } from "./npz.js";
import { STATE_NAMES, openRecording, stateAt } from "./recording.js";
import { anglesOfAll, placesOfAll } from "./kinematics.js";
import { readAddress, toAddress } from "./address.js";
import { colors, setTheme } from "./theme.js";
import { showHeadline } from "./headline.js";
import { Lists } from "./lists.js";
import { Coloring, modesOf } from "./coloring.js";
import { PlanePanel } from "./plane.js";
import { NeighbourhoodPanel, SnapshotsPanel, closestApproach } from "./neighbourhood.js";
import { PositionPanel, VelocityPanel } from "./profiles.js";
import { BusesPanel } from "./buses.js";
import { MotorsPanel } from "./motors.js";
import { ImagesPanel } from "./images.js";
import { Timeline } from "./timeline.js";
import { listenToKeys } from "./keys.js";

const SPEEDS = [0.02, 0.05, 0.1, 0.25, 0.5, 1, 2, 5, 10];
const PLAY_S = 8; // approximate time to play a whole motion [s]
const MOST_WATCHED = 3;
const ADDRESS_MS = 300; // least time between two changes of the address line

const byId = (id) => document.getElementById(id);

class App {
  constructor(recording) {
    this.recording = recording;
    const { plane, motion } = recording;
    this.t = 0;
    this.playing = false;
    this.robots = [];
    this.pair = null; // the chosen approach, as long as its robots are watched
    this.panel = null;
    this.angles = new Float64Array(2 * plane.n);
    this.places = new Float64Array(4 * plane.n);
    this.neighbours = neighboursOf(recording);
    this.coloring = new Coloring(modesOf(recording));
    byId("coloring").replaceChildren(...Object.entries(this.coloring.modes).map(([key, { name }]) => new Option(name, key)));
    this.list = new Lists({ tabs: byId("tabs"), list: byId("list"), search: byId("search"), watched: byId("watched") }, this);
    this.marked = this.list.missed;
    this.panels = [
      new PlanePanel(byId("plane"), this),
      new NeighbourhoodPanel(byId("neighbourhood"), byId("neighbourhood-note"), this),
      new SnapshotsPanel(byId("snapshots"), byId("snapshots-note"), this),
      new VelocityPanel(byId("velocity"), byId("velocity-note"), this),
      new PositionPanel(byId("position"), byId("position-note"), this),
      new BusesPanel(byId("buses"), byId("buses-note"), this),
      new MotorsPanel(byId("motors"), byId("motors-note"), this),
      new ImagesPanel(byId("images"), byId("images-note"), this, byId("image")),
      new Timeline(byId("timeline"), this),
    ];
    [this.plane] = this.panels;
    this.visible = new Set(); // canvases on the screen: only these are drawn
    this.observer = new IntersectionObserver((changes) => {
      for (const { target, isIntersecting } of changes) this.visible[isIntersecting ? "add" : "delete"](target);
      this.redraw();
    });
    for (const { canvas } of this.panels) this.observer.observe(canvas);
    showHeadline(this, { title: byId("title"), subtitle: byId("subtitle"), figures: byId("figures"), notes: byId("notes") });
    const ideal = Math.max(motion.makespan, 0.01) / PLAY_S;
    const off = (speed) => Math.abs(Math.log(speed / ideal));
    this.speed = SPEEDS.reduce((best, speed) => (off(speed) < off(best) ? speed : best));
    byId("speed").replaceChildren(...SPEEDS.map((speed) => new Option(`${speed}×`, speed, false, speed === this.speed)));
  }

  /** Shows the view of the address line; without one, the pair of the closest approach at the begin. */
  open() {
    const { t, robots, panel, color } = readAddress(location.hash);
    const rows = robots.map((id) => this.recording.plane.rowOf.get(id)).filter((row) => row !== undefined);
    const closest = this.recording.pairs[0], { n } = this.recording.plane;
    if (rows.length) this.robots = rows.slice(0, MOST_WATCHED);
    else if (closest) this.robots = [closest.a, closest.b].filter((body) => body < n);
    this.pair = null;
    this.colorBy(color ?? "state");
    this.t = this.clamp(t ?? 0);
    if (panel) this.alone(panel);
    this.list.showWatched();
    this.redraw();
  }

  colorBy(key) {
    this.coloring.choose(key);
    byId("coloring").value = this.coloring.key;
    this.redraw();
  }

  zoomToWatched() {
    if (this.robots.length) this.plane.zoomTo(this.robots[0]);
  }

  clamp(t) {
    return Math.min(this.recording.end, Math.max(this.recording.begin, t));
  }

  seek(t) {
    this.t = this.clamp(t);
    this.redraw();
  }

  play(playing) {
    if (playing && this.t >= this.recording.end) this.t = 0;
    this.playing = playing;
    byId("play").classList.toggle("playing", playing);
    byId("play").setAttribute("aria-label", playing ? "Pause" : "Play");
    this.before = null;
    this.redraw();
  }

  watch(row, add = false) {
    this.pair = null;
    const others = add ? this.robots.filter((other) => other !== row) : [];
    this.robots = [row, ...others].slice(0, MOST_WATCHED);
    this.plane.reveal(row);
    this.list.showWatched();
    this.redraw();
  }

  bringToFront(row) {
    this.robots = [row, ...this.robots.filter((other) => other !== row)];
    this.list.showWatched();
    this.redraw();
  }

  showHint(row) {
    const { plane } = this.recording;
    byId("hint").textContent = row < 0 ? "" : `robot ${plane.ids[row]}, ${STATE_NAMES[stateAt(this.recording, row, this.t)]}`;
  }

  goToApproach(pair) {
    const rows = [pair.a, pair.b].filter((body) => body < this.recording.plane.n);
    this.robots = rows;
    this.pair = pair;
    this.plane.reveal(rows[0]);
    this.list.showWatched();
    this.play(false);
    this.seek(pair.time);
  }

  goToFault(fault) {
    if (fault.row >= 0) this.watch(fault.row);
    this.play(false);
    this.seek(fault.time);
  }

  goToStop(time) {
    this.play(false);
    this.seek(time);
  }

  goToRobot(row) {
    this.watch(row);
    const pair = closestApproach(this.recording, [row]);
    this.play(false);
    this.seek(this.recording.started[row] && pair ? pair.time : this.t);
  }

  /** The number of the image that is shown. */
  get image() {
    return this.panels.find((panel) => panel instanceof ImagesPanel).shown;
  }

  /** Shows one panel alone, or all panels if it is alone already. */
  alone(number) {
    this.panel = this.panel === number ? null : number;
    for (const section of document.querySelectorAll(".panel")) {
      section.classList.toggle("alone", Number(section.dataset.panel) === this.panel);
    }
    this.redraw();
  }

  /** Requests a frame; many requests make one frame. */
  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame((now) => {
      this.waiting = false;
      this.frame(now);
    });
  }

  frame(now) {
    if (this.playing) {
      if (this.before) this.t = this.clamp(this.t + ((now - this.before) / 1e3) * this.speed);
      this.before = now;
      if (this.t >= this.recording.end) this.play(false);
      else this.redraw();
    }
    anglesOfAll(this.recording.motion, this.t, this.angles);
    placesOfAll(this.recording.plane, this.angles, this.places);
    for (const panel of this.panels) {
      if (this.visible.has(panel.canvas)) panel.draw(this.t, this.angles, this.places);
    }
    byId("clock").textContent = `${this.t.toFixed(3)} s`;
    this.coloring.showLegend(byId("legend"), this.recording.plane.n, this.t);
    this.updateAddress();
  }

  updateAddress() {
    clearTimeout(this.addressTimer);
    this.addressTimer = setTimeout(() => {
      const ids = this.robots.map((row) => this.recording.plane.ids[row]);
      history.replaceState(null, "", toAddress({ t: this.t, ids, panel: this.panel, color: this.coloring.key }));
    }, ADDRESS_MS);
  }
}

// Neighbours of each robot: robots and fixed discs.
function neighboursOf(recording) {
  const neighbours = new Map();
  const add = (row, body) => neighbours.set(row, [...(neighbours.get(row) ?? []), body]);
  for (const { a, b } of recording.pairs) {
    add(a, b);
    if (b < recording.plane.n) add(b, a);
  }
  return neighbours;
}

function showProblem(error) {
  byId("problem").textContent = error.message;
  byId("problem").hidden = false;
}

async function start(bytes) {
  globalThis.player?.observer.disconnect();
  byId("problem").hidden = true;
  try {
    const recording = await openRecording(bytes);
    document.querySelector("main").hidden = false;
    document.querySelector("footer").hidden = false;
    globalThis.player = new App(recording);
    globalThis.player.open();
  } catch (error) {
    showProblem(error);
  }
}

function listen() {
  byId("play").addEventListener("click", () => player.play(!player.playing));
  byId("speed").addEventListener("change", (event) => { player.speed = Number(event.target.value); });
  byId("zoom-in").addEventListener("click", () => player.plane.zoom(1.5));
  byId("zoom-out").addEventListener("click", () => player.plane.zoom(1 / 1.5));
  byId("zoom-fit").addEventListener("click", () => player.plane.reset());
  byId("zoom-watched").addEventListener("click", () => player.zoomToWatched());
  byId("coloring").addEventListener("change", (event) => player.colorBy(event.target.value));
  byId("help").addEventListener("click", () => byId("keys").showModal());
  const otherTheme = () => {
    setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
    player.redraw();
  };
  byId("theme").addEventListener("click", otherTheme);
  listenToKeys(() => globalThis.player, { search: byId("search"), keys: byId("keys"), otherTheme });
  const resized = new ResizeObserver(() => globalThis.player?.redraw());
  // a canvas can change its size beside others, or under a head that has got another line
  for (const place of [document.body, ...document.querySelectorAll("canvas")]) resized.observe(place);
  addEventListener("hashchange", () => globalThis.player?.open());
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.add("dropping");
  });
  document.addEventListener("dragleave", () => document.body.classList.remove("dropping"));
  document.addEventListener("drop", async (event) => {
    event.preventDefault();
    document.body.classList.remove("dropping");
    const [file] = event.dataTransfer.files;
    if (file) location.hash = "";
    if (file) start(new Uint8Array(await file.arrayBuffer()));
  });
}

setTheme(readAddress(location.hash).theme);
listen();
if (!damageOfPage()) start(fromBase64(byId("recording").textContent));
