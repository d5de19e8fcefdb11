// SPDX-License-Identifier: Apache-2.0
// Actions of the keyboard; page.html lists them in its help.

const STEPS = 200; // steps of the arrow keys from begin to end

/** Listens to keys; `current` returns the app, which changes when another file is dropped. */
export function listenToKeys(current, { search, keys, otherTheme }) {
  document.addEventListener("keydown", (event) => {
    const app = current();
    if (event.target === search && event.key === "Escape") search.blur();
    if (!app || event.ctrlKey || event.metaKey || event.altKey) return;
    if (["INPUT", "SELECT", "TEXTAREA"].includes(event.target.tagName) || keys.open) return;
    const { begin, end, pairs } = app.recording;
    const step = ((end - begin) / STEPS) * (event.shiftKey ? 10 : 1);
    const actions = {
      " ": () => app.play(!app.playing),
      ArrowLeft: () => app.seek(app.t - step),
      ArrowRight: () => app.seek(app.t + step),
      Home: () => app.seek(0),
      End: () => app.seek(end),
      c: () => pairs.length && app.goToApproach(nextApproach(app, pairs, 1)),
      C: () => pairs.length && app.goToApproach(nextApproach(app, pairs, -1)),
      f: () => app.list.faults.length && app.goToFault(nextFault(app)),
      "/": () => search.focus(),
      "+": () => app.plane.zoom(1.5),
      "=": () => app.plane.zoom(1.5),
      "-": () => app.plane.zoom(1 / 1.5),
      0: () => app.plane.reset(),
      z: () => app.zoomToWatched(),
      d: otherTheme,
      "?": () => keys.showModal(),
      Escape: () => app.panel && app.alone(app.panel),
    };
    for (const panel of document.querySelectorAll(".panel:not([hidden])")) {
      actions[panel.dataset.panel] = () => app.alone(Number(panel.dataset.panel));
    }
    // the space key presses a focused button
    if (event.target.tagName === "BUTTON" && event.key === " ") return;
    if (!actions[event.key]) return;
    event.preventDefault();
    actions[event.key]();
  });
}

function nextApproach(app, pairs, step) {
  app.approachIndex = ((app.approachIndex ?? (step > 0 ? -1 : 0)) + step + pairs.length) % pairs.length;
  return pairs[app.approachIndex];
}

function nextFault(app) {
  const { faults } = app.list;
  app.faultIndex = ((app.faultIndex ?? -1) + 1) % faults.length;
  return faults[app.faultIndex];
}
