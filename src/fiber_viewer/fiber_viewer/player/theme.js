// Colours and canvases: what all panels draw with.

const NAMES = [
  "ground", "card", "ink", "soft", "line", "faint", "accent", "watch", "moving", "reached",
  "held", "failed", "idle", "disabled", "stopped", "theta", "phi", "plan", "gap",
];

/** Colours by name, and those of states in the order of STATE_NAMES; see readColors. */
export const colors = {};

/** Reads the colours of the style sheet again, after the theme has changed. */
export function readColors() {
  const style = getComputedStyle(document.documentElement);
  for (const name of NAMES) colors[name] = style.getPropertyValue(`--${name}`).trim();
  colors.states = ["moving", "reached", "held", "failed", "idle", "disabled", "stopped"].map((n) => colors[n]);
}

/** Sets light or dark; null for what the system prefers. */
export function setTheme(theme) {
  const dark = theme ? theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  readColors();
}

const MAX_RATIO = 2; // finer pixels cost time and show nothing

/** Fits a canvas to its place and clears it; returns {ctx, width, height} in CSS pixels. */
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

/** Writes text that stays legible on whatever is below it. */
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
