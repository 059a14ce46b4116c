// What sessions need, and what is wrong with it.
import { html } from "./views.js";
import { poll } from "./api.js";
import { badge, heading, makeTable, setRows, showProblem } from "./wording.js";

const EVERY = 5000; // ms
const TASKS = {
  store: "keeps the sessions", detector: "finds regions worth scanning", registrar: "matches scans with what the camera saw",
  "sensor gateway": "reads the fingertips' sensors",
};

export function showServices(root, { signal, announce }) {
  const { element, rows } = makeTable("Services", ["Service:", "State:", "What it does:", "Problem and remedy:"]);
  const message = html("div"), about = html("p", { class: "note" });
  root.append(
    heading("Services"),
    html("p", { class: "note" }, "What the orchestrator, which serves this page, needs for a session."),
    message, element, about,
    html("p", {}, html("a", { href: "/metrics" }, "Metrics"), " for Prometheus, ", html("a", { href: "/docs" }, "the API"), " for programs."),
  );
  let before = null;

  function take({ document: { version, services } }) {
    message.replaceChildren();
    about.textContent = `pretouch ${version}`;
    setRows(rows, services.map(({ name, ready, problem }) => [name, [
      name, ready ? badge("converged", "✓", "ready") : badge("failed", "✕", "not ready"), TASKS[name] ?? "", problem ?? "none",
    ]]));
    const now = new Map(services.map(({ name, ready }) => [name, ready]));
    const news = [...now].filter(([name, ready]) => before && before.get(name) !== ready).map(([name, ready]) => `${name} is ${ready ? "ready again" : "not ready"}.`);
    if (news.length) announce(news.join(" "));
    before = now;
  }

  poll("/v1/services", EVERY, signal, take, (problem) => showProblem(message, problem));
}
