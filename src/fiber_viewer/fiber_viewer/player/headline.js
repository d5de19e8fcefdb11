// SPDX-License-Identifier: Apache-2.0
// The head of the page: outcomes, makespan and clearance of the plan.
import { flaggedOf, imageName, quantile, residualsOf, rms } from "./images.js";
import { FAILED, HELD, REACHED, bodyName, isAsked, stateAt } from "./recording.js";

/**
 * Returns the numbers of the headline: {reached, held, failed, disabled, asked, makespan, bound, ...}.
 * They count the same robots as the lists; `disabled` are those of them with a target.
 */
export function figuresOf(recording) {
  const { report, certificate } = recording.about, { plane } = recording;
  const counts = { asked: 0, disabled: 0, [REACHED]: 0, [HELD]: 0, [FAILED]: 0 };
  for (let row = 0; row < plane.n; row++) {
    const asked = isAsked(plane, row);
    counts.asked += asked;
    if (!plane.enabled[row]) counts.disabled += asked;
    else counts[stateAt(recording, row, Infinity)] += 1;
  }
  return {
    asked: counts.asked, disabled: counts.disabled,
    reached: report.reached, held: counts[HELD], failed: counts[FAILED],
    makespan: report.makespan_s, bound: report.lower_bound_s,
    clearance: report.min_clearance_mm, nearer: (report.nearer_from_start ?? []).length, margin: certificate.margin_mm,
    certified: certificate.ok, segments: report.segments_mean, bus: report.bus_time_s,
  };
}

/** Returns the outcomes in one sentence; after images it says that counters told them. */
export function verdict({ asked, reached, held, failed, disabled }, byCounters = false) {
  if (asked === 0) return "No robot had a target.";
  const by = byCounters ? ", by their counters" : "";
  if (reached === asked) return `All ${asked} robots reached their targets${by}.`;
  const rest = [held && `${held} held`, disabled && `${disabled} disabled`, failed && `${failed} failed`].filter(Boolean).join(", ");
  return `${reached} of ${asked} robots reached their targets${by}; ${rest}.`;
}

/** Returns in one sentence what the last image of a camera tells. */
export function imagesNote(recording) {
  const last = recording.images.count - 1, { um } = residualsOf(recording, last), flagged = flaggedOf(recording).length;
  return `seen by a camera ${imageName(last)}: ${um.length} fibres ${rms(um).toFixed(1)} um rms from their targets, ` +
    `99 % within ${quantile(um, 0.99).toFixed(1)} um; ${flagged} robots flagged`;
}

/** Fills title, subtitle and figures of the page. */
export function showHeadline(app, { title, subtitle, figures, notes }) {
  const { recording } = app, { about, plane } = recording, numbers = figuresOf(recording);
  title.textContent = `${about.report.plane || "Focal plane"}: ${verdict(numbers, Boolean(recording.images))}`;
  const when = new Date(about.plan_ns / 1e6).toISOString().slice(0, 19).replace("T", " ");
  subtitle.textContent = [
    `${plane.n} robots`, about.plan_ns > 0 && `${when} UTC`, about.planner && `planner ${about.planner}`,
    about.seed >= 0 && `seed ${about.seed}`, about.software,
  ].filter(Boolean).join("  ·  ");
  const remarks = [...(about.notes ?? []), ...(recording.images ? [imagesNote(recording)] : [])];
  notes.replaceChildren(...remarks.map((note) => {
    const item = document.createElement("li");
    item.textContent = note;
    return item;
  }));
  notes.hidden = !remarks.length;
  const closest = recording.pairs[0];
  const rows = [
    ["reached", `${numbers.reached}`, ` of ${numbers.asked}`],
    ["held", `${numbers.held}`, "", numbers.held ? "warn" : "", () => app.list.show("missed")],
    ...(numbers.disabled ? [["disabled", `${numbers.disabled}`, " with a target", "warn", () => app.list.show("disabled")]] : []),
    ["failed", `${numbers.failed}`, "", numbers.failed ? "bad" : "", () => app.list.show("faults")],
    ["makespan", numbers.makespan.toFixed(2), ` s, at least ${numbers.bound.toFixed(2)}`],
    ["least clearance", numbers.clearance === null ? "no neighbours" : numbers.clearance.toFixed(3),
      (numbers.clearance === null ? "" : ` mm, margin ${numbers.margin}`) +
        (numbers.nearer ? `; ${numbers.nearer} pairs nearer from the start` : ""), "",
      closest && (() => app.goToApproach(closest))],
    ["certified", numbers.certified ? "yes" : "NO", "", numbers.certified ? "" : "bad"],
    ["segments per motor", numbers.segments.toFixed(2), ""],
    ["load, verify, go", (1e3 * numbers.bus).toFixed(0), " ms"],
  ];
  figures.replaceChildren(...rows.map(([name, value, unit, kind, action]) => figure(name, value, unit, kind, action)));
  if (closest) figures.querySelector("[data-name='least clearance'] dd").title =
    `robots ${bodyName(recording, closest.a)} and ${bodyName(recording, closest.b)}`;
}

function figure(name, value, unit, kind, action) {
  const box = document.createElement("div"), dt = document.createElement("dt"), dd = document.createElement("dd");
  box.dataset.name = name;
  if (kind) box.className = kind;
  dt.textContent = name;
  const number = document.createElement(action ? "button" : "span");
  number.textContent = value;
  if (action) number.addEventListener("click", action);
  const small = document.createElement("small");
  small.textContent = unit ?? "";
  dd.append(number, small);
  box.append(dt, dd);
  return box;
}
