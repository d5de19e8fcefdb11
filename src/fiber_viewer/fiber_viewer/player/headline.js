// What an observer reads first: what became of the robots, how long it took, how near they came.
import { bodyName } from "./recording.js";

/** Returns the numbers of the headline: {reached, held, failed, asked, makespan, bound, ...}. */
export function figuresOf(recording) {
  const { report, certificate } = recording.about;
  return {
    asked: report.asked, reached: report.reached, held: report.held, failed: report.failed,
    makespan: report.makespan_s, bound: report.lower_bound_s,
    clearance: report.min_clearance_mm, margin: certificate.margin_mm,
    certified: certificate.ok, segments: report.segments_mean, bus: report.bus_time_s,
  };
}

/** Returns one sentence on how it went. */
export function verdict({ asked, reached, held, failed }) {
  if (asked === 0) return "Nothing was asked of any robot.";
  if (reached === asked) return `All ${asked} robots reached their targets.`;
  const rest = [held && `${held} held`, failed && `${failed} failed`].filter(Boolean).join(", ");
  return `${reached} of ${asked} robots reached their targets; ${rest}.`;
}

/** Fills title, subtitle and figures of the page. */
export function showHeadline(app, { title, subtitle, figures, notes }) {
  const { recording } = app, { about, plane } = recording, told = figuresOf(recording);
  title.textContent = `${about.report.plane || "Focal plane"}: ${verdict(told)}`;
  const when = new Date(about.plan_ns / 1e6).toISOString().slice(0, 19).replace("T", " ");
  subtitle.textContent = [
    `${plane.n} robots`, `${when} UTC`, about.planner && `planner ${about.planner}`,
    about.seed >= 0 && `seed ${about.seed}`, about.software,
  ].filter(Boolean).join("  ·  ");
  notes.replaceChildren(...(about.notes ?? []).map((note) => {
    const item = document.createElement("li");
    item.textContent = note;
    return item;
  }));
  notes.hidden = !about.notes?.length;
  const nearest = recording.pairs[0];
  const rows = [
    ["reached", `${told.reached}`, ` of ${told.asked}`],
    ["held", `${told.held}`, "", told.held ? "warn" : "", () => app.list.show("missed")],
    ["failed", `${told.failed}`, "", told.failed ? "bad" : "", () => app.list.show("faults")],
    ["makespan", told.makespan.toFixed(2), ` s, at least ${told.bound.toFixed(2)}`],
    ["least clearance", told.clearance === null ? "none near" : told.clearance.toFixed(3),
      told.clearance === null ? "" : ` mm, margin ${told.margin}`, "",
      nearest && (() => app.goToApproach(nearest))],
    ["certified", told.certified ? "yes" : "NO", "", told.certified ? "" : "bad"],
    ["segments a motor", told.segments.toFixed(2), ""],
    ["load, verify, go", (1e3 * told.bus).toFixed(0), " ms"],
  ];
  figures.replaceChildren(...rows.map(([name, value, unit, kind, act]) => figure(name, value, unit, kind, act)));
  if (nearest) figures.querySelector("[data-name='least clearance'] dd").title =
    `robots ${bodyName(recording, nearest.a)} and ${bodyName(recording, nearest.b)}`;
}

function figure(name, value, unit, kind, act) {
  const box = document.createElement("div"), dt = document.createElement("dt"), dd = document.createElement("dd");
  box.dataset.name = name;
  if (kind) box.className = kind;
  dt.textContent = name;
  const number = document.createElement(act ? "button" : "span");
  number.textContent = value;
  if (act) number.addEventListener("click", act);
  const small = document.createElement("small");
  small.textContent = unit ?? "";
  dd.append(number, small);
  box.append(dt, dd);
  return box;
}
