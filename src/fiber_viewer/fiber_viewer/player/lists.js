// Where to look: closest approaches, faults, robots that did not reach their targets.
import { HELD, FAILED, bodyName, eventText, faultsOf, reasonOf, stateAt, stopsOf } from "./recording.js";

const SHOWN = 200; // entries of a list; more are found by id

export class Lists {
  constructor({ tabs, list, search, watched }, app) {
    Object.assign(this, { tabs, list, search, watched, app });
    const { recording } = app, { plane, pairs } = recording;
    const missed = [];
    for (let row = 0; row < plane.n; row++) {
      if ([HELD, FAILED].includes(stateAt(recording, row, Infinity))) missed.push(row);
    }
    this.missed = missed;
    this.faults = faultsOf(recording);
    this.contents = {
      closest: { name: "Closest", entries: pairs.map((pair) => this.approach(pair)) },
      faults: { name: "Faults", count: this.faults.length, entries: this.story() },
      missed: { name: "Not reached", entries: missed.map((row) => this.robot(row)) },
    };
    tabs.replaceChildren(...Object.entries(this.contents).map(([key, { name, entries, count }]) => {
      const tab = document.createElement("button");
      tab.setAttribute("role", "tab");
      tab.dataset.tab = key;
      tab.textContent = key === "closest" ? name : `${name} (${count ?? entries.length})`;
      tab.addEventListener("click", () => this.show(key));
      return tab;
    }));
    search.addEventListener("keydown", (event) => this.onSearch(event));
    this.show("closest");
  }

  approach(pair) {
    const { recording } = this.app;
    return {
      cells: [`${pair.gap.toFixed(3)} mm`, `${bodyName(recording, pair.a)} – ${bodyName(recording, pair.b)}`, `at ${pair.time.toFixed(3)} s`],
      act: () => this.app.goToApproach(pair),
    };
  }

  /** Faults, and the stops and new starts that came of them, in order of time. */
  story() {
    const faults = this.faults.map((fault) => ({ time: fault.time, ...this.fault(fault) }));
    const stops = stopsOf(this.app.recording).map(({ time, what }) => ({
      time, cells: [`${time.toFixed(3)} s`, "", what], act: () => this.app.goToStop(time),
    }));
    return [...faults, ...stops].sort((a, b) => a.time - b.time);
  }

  fault(fault) {
    const who = fault.row >= 0 ? `robot ${this.app.recording.plane.ids[fault.row]}` : `bus ${fault.bus}`;
    const what = eventText(this.app.recording, fault);
    return { cells: [`${fault.time.toFixed(3)} s`, who, what], act: () => this.app.goToFault(fault) };
  }

  robot(row) {
    const { recording } = this.app, error = recording.error[row];
    const far = Number.isFinite(error) ? `, ${error.toFixed(2)} mm off` : "";
    return { cells: [`${recording.plane.ids[row]}`, "", reasonOf(recording, row) + far], act: () => this.app.goToRobot(row) };
  }

  show(key) {
    for (const tab of this.tabs.children) tab.setAttribute("aria-selected", String(tab.dataset.tab === key));
    const { entries } = this.contents[key];
    const rows = entries.slice(0, SHOWN).map(({ cells, act }) => {
      const item = document.createElement("li"), button = document.createElement("button");
      button.append(...cells.map((text) => {
        const cell = document.createElement("span");
        cell.textContent = text;
        return cell;
      }));
      button.addEventListener("click", () => {
        for (const other of this.list.querySelectorAll("[aria-current]")) other.removeAttribute("aria-current");
        button.setAttribute("aria-current", "true");
        act();
      });
      item.append(button);
      return item;
    });
    const rest = entries.length - rows.length;
    const words = rest > 0 ? `and ${rest} more` : { closest: "nobody comes near", faults: "none", missed: "none" }[key];
    if (rest > 0 || !entries.length) {
      const item = document.createElement("li");
      item.className = "none";
      item.textContent = words;
      rows.push(item);
    }
    this.list.replaceChildren(...rows);
    this.list.scrollTop = 0;
  }

  onSearch(event) {
    if (event.key !== "Enter") return;
    const row = this.app.recording.plane.rowOf.get(Number(this.search.value.trim()));
    this.search.setCustomValidity(row === undefined ? "no such robot" : "");
    this.search.reportValidity();
    if (row !== undefined) this.app.watch(row, event.shiftKey);
  }

  /** Shows who is watched; a chip brings its robot's curves up. */
  showWatched() {
    const { robots, recording } = this.app;
    this.watched.replaceChildren(...robots.map((row, at) => {
      const chip = document.createElement("button");
      chip.textContent = recording.plane.ids[row];
      chip.title = reasonOf(recording, row);
      chip.setAttribute("aria-pressed", String(at === 0));
      chip.addEventListener("click", () => this.app.front(row));
      return chip;
    }));
  }
}
