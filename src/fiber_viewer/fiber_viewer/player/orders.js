// SPDX-License-Identifier: Apache-2.0
// The buttons of the console: an order is confirmed, sent, and its answer is listed. Stop is sent at once.

const QUESTIONS = {
  start: ["Start the plan?", "Its robots begin to move."],
  home: ["Fold all robots?", "All robots that can be commanded move."],
  clear: ["Clear?", "Faults and orders of robots at rest are cleared."],
  configure: ["Configure the robots?", "Their settings are sent again."],
  disable: ["Disable robots?", "They stay where they are, as obstacles."],
  enable: ["Enable robots?", "They are part of the next plan."],
};
const ANSWERS_KEPT = 20;
const STOP_WAIT_MS = 500; // longest time that drawing waits for the answer of a stop

export class Orders {
  /** `send(order, more)` returns the number of the order; `app` has `ready`, the plan, and the watched robots. */
  constructor(app, send, elements) {
    Object.assign(this, { app, send, ...elements });
    this.sent = new Map();
    for (const place of [this.buttons, this.dialog]) { // a stop is in reach while a question is open
      for (const button of place.querySelectorAll("[data-order]")) {
        button.addEventListener("click", () => this.ask(button.dataset.order));
      }
    }
    this.dialog.addEventListener("close", () => {
      if (this.dialog.returnValue === "yes") this.confirmed();
    });
  }

  ask(order) {
    if (order === "stop") {
      this.dialog.close("cancel");
      this.order(order);
      return;
    }
    const [title, text] = QUESTIONS[order], { recording, robots, ready } = this.app;
    this.asked = order;
    this.plan = ready;
    this.heading.textContent = title;
    this.text.textContent = order === "start" ? `Plan ${ready}. ${text}` : text;
    const named = order === "disable" || order === "enable";
    this.robotsBox.hidden = !named;
    this.whyLabel.hidden = order !== "disable";
    if (named) this.ids.value = robots.map((row) => recording.plane.ids[row]).join(", ");
    this.dialog.returnValue = "";
    this.dialog.showModal();
    this.yes.focus();
  }

  confirmed() {
    const order = this.asked;
    if (order === "start") this.order(order, { plan: this.plan });
    else if (order === "disable" || order === "enable") {
      const ids = this.ids.value.split(/[\s,;]+/).filter(Boolean);
      const wrong = ids.find((id) => !/^\d+$/.test(id));
      if (wrong) this.list(`${order}: ${wrong} is not the id of a robot`, false);
      else this.order(order, { ids: ids.map(Number), why: this.why.value });
    } else this.order(order);
  }

  order(order, more = {}) {
    const number = this.send(order, more);
    if (number === null) this.list(`${order}: not sent, as the console does not answer`, false);
    else this.sent.set(number, { order, began: performance.now(), plan: more.plan });
  }

  /** Whether a stop waits for its answer: a page that draws meanwhile would delay it. */
  get isStopping() {
    const since = performance.now() - STOP_WAIT_MS;
    return [...this.sent.values()].some(({ order, began }) => order === "stop" && began > since);
  }

  /** Lists the orders whose answers cannot come any more, as the connection is lost. */
  lost() {
    for (const { order } of this.sent.values()) this.list(`${order}: no answer, the connection was lost; look at the plane`, false);
    this.sent.clear();
  }

  answered({ number, order, ok, text }) {
    const { began, plan } = this.sent.get(number) ?? {};
    this.sent.delete(number);
    this.lasted = performance.now() - began;
    const about = plan ? `${order}, plan ${plan}` : order ?? "order";
    this.list(`${about}: ${ok ? "" : "refused: "}${text}`, ok, began === undefined ? "" : `${this.lasted.toFixed(0)} ms`);
  }

  list(text, ok, note = "") {
    const row = document.createElement("li"), small = document.createElement("small");
    row.className = ok ? "ok" : "error";
    small.textContent = note;
    row.append(text, " ", small);
    this.answers.prepend(row);
    while (this.answers.children.length > ANSWERS_KEPT) this.answers.lastChild.remove();
  }
}
