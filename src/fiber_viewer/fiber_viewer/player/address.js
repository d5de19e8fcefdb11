// SPDX-License-Identifier: Apache-2.0
// Time, watched robots and panel in the address line, so that a link shows the same view.

/** Returns the parts of an address such as "#t=1.25&robots=12,40&panel=2&theme=dark". */
export function readAddress(hash) {
  const found = new URLSearchParams(hash.replace(/^#/, ""));
  const number = (name) => (found.has(name) && Number.isFinite(Number(found.get(name))) ? Number(found.get(name)) : null);
  const robots = (found.get("robots") ?? "").split(",").filter((s) => /^\d+$/.test(s)).map(Number);
  return { t: number("t"), panel: number("panel"), robots, theme: found.get("theme"), color: found.get("color") };
}

/** Returns the address of a view: time, ids of the watched robots, panel, what robots are coloured by. */
export function toAddress({ t, ids, panel, color = "state" }) {
  const parts = [`t=${t.toFixed(4)}`];
  if (ids.length) parts.push(`robots=${ids.join(",")}`);
  if (panel) parts.push(`panel=${panel}`);
  if (color !== "state") parts.push(`color=${color}`);
  return `#${parts.join("&")}`;
}
