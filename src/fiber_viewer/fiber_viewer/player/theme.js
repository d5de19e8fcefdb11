// SPDX-License-Identifier: Apache-2.0
// Colours and canvases for all panels.

const NAMES = [
  "ground", "card", "ink", "soft", "line", "faint", "accent", "watch", "moving", "reached",
  "held", "failed", "target", "idle", "disabled", "stopped", "waiting", "theta", "phi", "plan", "gap",
];

/** Colours by name, `states` in the order of STATE_NAMES, `series` of groups, `ramp` of a scale; set by readColors. */
export const colors = {};

/** Reads the colours from the style sheet, after a change of the theme. */
export function readColors() {
  const style = getComputedStyle(document.documentElement);
  for (const name of NAMES) colors[name] = style.getPropertyValue(`--${name}`).trim();
  colors.states = ["moving", "reached", "held", "failed", "idle", "disabled", "stopped", "waiting"].map((n) => colors[n]);
  for (const name of ["series", "ramp"]) colors[name] = style.getPropertyValue(`--${name}`).trim().split(/\s+/);
}

/** Sets the theme "light" or "dark"; null: the preference of the system. */
export function setTheme(theme) {
  const dark = theme ? theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  readColors();
}

const MAX_RATIO = 2; // canvas pixels per CSS pixel; more cost time and are not visible

/** Sets the size of a canvas to its place on the page and clears it; returns {ctx, width, height} in CSS pixels. */
export function cleared(canvas) {
  const ratio = Math.min(globalThis.devicePixelRatio || 1, MAX_RATIO);
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) [canvas.width, canvas.height] = [w, h];
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, width, height);
  ctx.font = "11px system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', sans-serif";
  ctx.textBaseline = "middle";
  ctx.lineJoin = ctx.lineCap = "round";
  return { ctx, width, height };
}

/** Writes text with a border that keeps it legible on any ground. */
export function label(ctx, text, x, y, color, align = "left") {
  ctx.textAlign = align;
  ctx.strokeStyle = colors.card;
  ctx.lineWidth = 3.5;
  ctx.strokeText(text, x, y);
  write(ctx, text, x, y, color, align);
}

/** Writes text; align is left, center or right. */
export function write(ctx, text, x, y, color, align = "left") {
  ctx.fillStyle = color;
  ctx.textAlign = align;
  ctx.fillText(text, x, y);
}
