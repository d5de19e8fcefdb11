// SPDX-License-Identifier: Apache-2.0
// Lists to choose from: closest approaches, faults, robots that did not reach their targets, those
// that a camera has a remark about, and disabled robots with a target.
import { flaggedOf } from "./images.js";
import { HELD, FAILED, bodyName, eventText, faultsOf, historyOf, isAsked, reasonOf, stateAt } from "./recording.js";
import { listenToArrows, setTabStop } from "./roving.js";

const MOST_SHOWN = 200; // entries of a list; other robots are found by id

export class Lists {
  constructor({ tabs, list, search, watched }, app) {
    Object.assign(this, { tabs, list, search, watched, app });
    const { recording } = app, { plane, pairs } = recording;
    const missed = [], disabled = [];
    for (let row = 0; row < plane.n; row++) {
      if ([HELD, FAILED].includes(stateAt(recording, row, Infinity))) missed.push(row);
      else if (!plane.enabled[row] && isAsked(plane, row)) disabled.push(row);
    }
    this.missed = missed;
    this.faults = faultsOf(recording);
    this.contents = {
      closest: { name: "Closest", entries: pairs.map((pair) => this.approachEntry(pair)) },
      faults: { name: "Faults", count: this.faults.length, entries: this.faultAndStopEntries() },
      missed: { name: "Not reached", entries: missed.map((row) => this.robotEntry(row)) },
      ...(recording.images && { flagged: { name: "Flagged", entries: flaggedOf(recording).map((each) => this.flaggedEntry(each)) } }),
      disabled: { name: "Disabled, with a target", entries: disabled.map((row) => this.robotEntry(row)) },
    };
    tabs.replaceChildren(...Object.entries(this.contents).map(([key, { name, entries, count }]) => {
      const tab = document.createElement("button");
      tab.setAttribute("role", "tab");
      tab.setAttribute("aria-controls", "list-panel");
      tab.id = `tab-${key}`;
      tab.dataset.tab = key;
      tab.textContent = key === "closest" ? name : `${name} (${count ?? entries.length})`;
      tab.addEventListener("click", () => this.show(key));
      return tab;
    }));
    listenToArrows(tabs, "ArrowRight", "ArrowLeft");
    listenToArrows(list, "ArrowDown", "ArrowUp");
    search.addEventListener("keydown", (event) => this.onSearch(event));
    this.show("closest");
  }

  approachEntry(pair) {
    const { recording } = this.app;
    return {
      cells: [`${pair.gap.toFixed(3)} mm`, `${bodyName(recording, pair.a)} – ${bodyName(recording, pair.b)}`, `at ${pair.time.toFixed(3)} s`],
      action: () => this.app.goToApproach(pair),
    };
  }

  /** Faults, stops of all robots, and resumed motion: a cause before its effect. */
  faultAndStopEntries() {
    return historyOf(this.app.recording, this.faults).map(({ time, fault, text }) =>
      fault ? this.faultEntry(fault) : { cells: [`${time.toFixed(3)} s`, "", text], action: () => this.app.goToStop(time) });
  }

  faultEntry(fault) {
    const subject = fault.row >= 0 ? `robot ${this.app.recording.plane.ids[fault.row]}` : `bus ${fault.bus}`;
    const text = eventText(this.app.recording, fault);
    return { cells: [`${fault.time.toFixed(3)} s`, subject, text], action: () => this.app.goToFault(fault) };
  }

  robotEntry(row) {
    const { recording } = this.app, error = recording.error[row];
    const distance = Number.isFinite(error) ? `, ${error.toFixed(2)} mm from the target` : "";
    return { cells: [`${recording.plane.ids[row]}`, "", reasonOf(recording, row) + distance], action: () => this.app.goToRobot(row) };
  }

  /** A robot about which the camera has a remark. */
  flaggedEntry({ row, verdict, text }) {
    return { cells: [`${this.app.recording.plane.ids[row]}`, verdict, text], action: () => this.app.goToRobot(row) };
  }

  show(key) {
    for (const tab of this.tabs.children) tab.setAttribute("aria-selected", String(tab.dataset.tab === key));
    setTabStop(this.tabs);
    this.list.parentElement.setAttribute("aria-labelledby", `tab-${key}`);
    const { entries } = this.contents[key];
    const rows = entries.slice(0, MOST_SHOWN).map(({ cells, action }) => {
      const item = document.createElement("li"), button = document.createElement("button");
      button.append(...cells.map((text) => {
        const cell = document.createElement("span");
        cell.textContent = text;
        return cell;
      }));
      button.addEventListener("click", () => {
        for (const other of this.list.querySelectorAll("[aria-current]")) other.removeAttribute("aria-current");
        button.setAttribute("aria-current", "true");
        setTabStop(this.list);
        action();
      });
      item.append(button);
      return item;
    });
    const rest = entries.length - rows.length;
    const text = rest > 0 ? `and ${rest} more` : { closest: "no robot has neighbours", faults: "none", missed: "none", flagged: "none", disabled: "none" }[key];
    if (rest > 0 || !entries.length) {
      const item = document.createElement("li");
      item.className = "none";
      item.textContent = text;
      rows.push(item);
    }
    this.list.replaceChildren(...rows);
    setTabStop(this.list);
    this.list.scrollTop = 0;
  }

  onSearch(event) {
    if (event.key !== "Enter") return;
    const row = this.app.recording.plane.rowOf.get(Number(this.search.value.trim()));
    this.search.setCustomValidity(row === undefined ? "no such robot" : "");
    this.search.reportValidity();
    if (row !== undefined) this.app.watch(row, event.shiftKey);
  }

  /** Shows the watched robots as chips; a click on a chip shows the curves of its robot. */
  showWatched() {
    const { robots, recording } = this.app;
    this.watched.replaceChildren(...robots.map((row, at) => {
      const chip = document.createElement("button");
      chip.textContent = recording.plane.ids[row];
      chip.title = reasonOf(recording, row);
      chip.setAttribute("aria-pressed", String(at === 0));
      chip.addEventListener("click", () => this.app.bringToFront(row));
      return chip;
    }));
  }
}
