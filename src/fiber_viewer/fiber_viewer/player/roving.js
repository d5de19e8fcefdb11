// SPDX-License-Identifier: Apache-2.0
// Rows of buttons that are one Tab stop: arrow keys move between the buttons.

/** Makes the Tab key stop at one button of a row only: the chosen one, else the first. */
export function setTabStop(row) {
  const buttons = [...row.querySelectorAll("button")];
  const chosen = buttons.find((button) => button.matches("[aria-selected=true], [aria-current=true]")) ?? buttons[0];
  for (const button of buttons) button.tabIndex = button === chosen ? 0 : -1;
}

/** Listens to the keys that move between the buttons of a row; setTabStop comes after each change of the row. */
export function listenToArrows(row, next, previous) {
  row.addEventListener("keydown", (event) => {
    const buttons = [...row.querySelectorAll("button")], at = buttons.indexOf(event.target);
    const to = { [next]: at + 1, [previous]: at - 1, Home: 0, End: buttons.length - 1 }[event.key];
    if (at < 0 || to === undefined) return;
    event.preventDefault();
    event.stopPropagation(); // the same keys move in time elsewhere
    const button = buttons[Math.min(buttons.length - 1, Math.max(0, to))];
    for (const other of buttons) other.tabIndex = other === button ? 0 : -1;
    button.focus();
  });
}
