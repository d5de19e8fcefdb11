// What the keyboard does; the same list stands in the page's help.

const STEPS = 200; // that a motion is cut into for the arrow keys

/** Listens to keys; `current` returns the page, which may change when another file is dropped. */
export function listenToKeys(current, { search, keys, otherTheme }) {
  document.addEventListener("keydown", (event) => {
    const app = current();
    if (event.target === search && event.key === "Escape") search.blur();
    if (!app || event.ctrlKey || event.metaKey || event.altKey) return;
    if (["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName) || keys.open) return;
    const { begin, end, pairs } = app.recording;
    const step = ((end - begin) / STEPS) * (event.shiftKey ? 10 : 1);
    const acts = {
      " ": () => app.play(!app.playing),
      ArrowLeft: () => app.seek(app.t - step),
      ArrowRight: () => app.seek(app.t + step),
      Home: () => app.seek(0),
      End: () => app.seek(end),
      c: () => pairs.length && app.goToApproach(turn(app, pairs, 1)),
      C: () => pairs.length && app.goToApproach(turn(app, pairs, -1)),
      f: () => app.list.faults.length && app.goToFault(nextFault(app)),
      "/": () => search.focus(),
      "+": () => app.plane.zoom(1.5),
      "=": () => app.plane.zoom(1.5),
      "-": () => app.plane.zoom(1 / 1.5),
      0: () => app.plane.reset(),
      d: otherTheme,
      "?": () => keys.showModal(),
      Escape: () => app.panel && app.alone(app.panel),
    };
    for (const number of [1, 2, 3, 4, 5, 6]) acts[number] = () => app.alone(number);
    // a focused button keeps its own space and enter
    if (event.target.tagName === "BUTTON" && event.key === " ") return;
    if (!acts[event.key]) return;
    event.preventDefault();
    acts[event.key]();
  });
}

function turn(app, pairs, by) {
  app.turned = ((app.turned ?? (by > 0 ? -1 : 0)) + by + pairs.length) % pairs.length;
  return pairs[app.turned];
}

function nextFault(app) {
  const { faults } = app.list;
  app.fault = ((app.fault ?? -1) + 1) % faults.length;
  return faults[app.fault];
}
