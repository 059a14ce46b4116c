// The fingertips: how each is, and the live ranges of one.
import { frame, html, make } from "./views.js";
import { follow, poll, Problem } from "./api.js";
import { badge, factList, heading, makeTable, mm, setRows, showProblem } from "./wording.js";

const EVERY = 2500, REDRAW_EVERY = 200, SPAN = 20, MOST_LINES = 8; // ms, ms, s, modules
const STATES = { streaming: ["converged", "✓"], connecting: ["exhausted", "…"], silent: ["exhausted", "▲"], ended: ["cancelled", "■"] };
const DASHES = ["", "6 3", "2 3", "8 3 2 3", "12 4", "4 4", "1 4", "10 2 2 2"];

export function showDevices(root, { signal, announce, name }) {
  const { element, rows } = makeTable("Fingertips", ["Fingertip:", "State:", "Port:", "Measurements", "Refused", "Lost", "Problem and remedy:"]);
  const message = html("div"), detail = html("div");
  root.append(
    heading("Fingertips"),
    html("p", { class: "note" }, "The range sensors that the sensor gateway reads, and what each measures now."),
    message, element, detail,
  );
  let chosen = null, problems = null;

  function take({ document: { devices } }) {
    message.replaceChildren();
    element.hidden = devices.length === 0;
    if (!devices.length) message.replaceChildren(html("p", {}, "The gateway was started without a device. Start it with one, such as ", html("code", {}, "pretouch up --device finger=/dev/ttyACM0"), "."));
    const shown = name ?? devices[0]?.name;
    setRows(rows, devices.map((device) => [device.name, [
      html("a", { href: `#/devices/${encodeURIComponent(device.name)}`, ...(device.name === shown ? { "aria-current": "true" } : {}) }, device.name),
      badge(...(STATES[device.state] ?? ["failed", "?"]), device.state),
      device.port, ...[device.measurements, device.refused, device.lost].map((count) => count.toLocaleString("en")), device.problem ?? "none",
    ]]));
    const now = new Map(devices.map((device) => [device.name, device.problem]));
    const news = [...now].filter(([each, problem]) => problems && problems.get(each) !== problem).map(([each, problem]) => `${each}: ${problem ?? "no problem any more"}`);
    if (news.length) announce(news.join(" "));
    problems = now;
    if (shown && !chosen) watch((chosen = shown));
  }

  function watch(device) {
    const facts = html("div"), values = html("p", { class: "values" }), chart = html("div"), failure = html("div");
    detail.replaceChildren(html("section", { class: "panel" }, html("h2", {}, `Live ranges of ${device}`), failure, html("div", { class: "live" }, chart, html("div", {}, values, facts))));
    const path = `/v1/devices/${encodeURIComponent(device)}`;
    poll(path, EVERY, signal, ({ document: status }) => {
      failure.replaceChildren();
      facts.replaceChildren(describe(status));
    }, (problem) => showProblem(failure, problem));
    const draw = makeChart(chart, values);
    follow(`${path}/ranges`, signal, () => {}, ({ type, data }) => {
      if (type === "ranges") draw(data);
      else showProblem(failure, new Problem(data));
    }).catch((error) => showProblem(failure, error));
  }

  poll("/v1/devices", EVERY, signal, take, (problem) => {
    element.hidden = true;
    showProblem(message, problem);
  });
}

function describe({ format, rate, clock, modules }) {
  return factList([
    ["Wire format", format ?? "not recognised yet"],
    ["Measurements per second", rate.toFixed(1)],
    ["Clock", clock.synchronised ? `synchronised${clock.std === null ? "" : `, to ${(1000 * clock.std).toFixed(1)} ms`}` : "not synchronised yet: no range is passed on"],
    ["Modules", String(modules.length)],
  ]);
}

/** A function that takes batches of ranges, and draws the last SPAN seconds every now and then. */
function makeChart(chart, values) {
  let kept = [], drawn = 0;
  return ({ t, range, range_status: statuses }) => {
    if (kept.length && t[0] < kept.at(-1).time) kept = []; // the gateway started anew
    t.forEach((time, k) => kept.push({ time, range: range[k], statuses: statuses[k] }));
    const last = kept.at(-1);
    if (!last || performance.now() - drawn < REDRAW_EVERY) return;
    drawn = performance.now();
    kept = kept.filter(({ time }) => time > last.time - SPAN);
    values.textContent = `Now: ${last.range.map((each, k) => `${last.range.length > 1 ? `${k}: ` : ""}${each === null ? last.statuses[k].replace("_", " ") : mm(each)}`).join(", ")}`;
    if (last.range.length > MOST_LINES) chart.replaceChildren(html("p", { class: "note" }, `${last.range.length} modules: too many for a chart.`));
    else chart.replaceChildren(drawRanges(chart, kept, last), html("p", { class: "note" }, "Where there is no line, the sensor gave no range, most often because nothing was near."));
  };
}

function drawRanges(place, kept, last) {
  const high = 1.1 * Math.max(20, ...kept.flatMap(({ range }) => range.map((each) => 1000 * each)));
  const xs = [-20, -15, -10, -5, 0].map((at) => ({ at, text: String(at) }));
  const { svg, x, y } = frame(place, 0, high, xs, "seconds before the last measurement", `Ranges of the last ${SPAN} seconds; the last ones are above.`);
  last.range.forEach((_, module) => {
    const runs = [[]];
    for (const { time, range } of kept) {
      if (range[module] === null) runs.push([]);
      else runs.at(-1).push(`${x(time - last.time)},${y(1000 * range[module])}`);
    }
    for (const run of runs.filter((points) => points.length > 1)) svg.append(make("polyline", { class: "expected", points: run.join(" "), "stroke-dasharray": DASHES[module] }));
    for (const run of runs.filter((points) => points.length === 1)) svg.append(make("circle", { class: "dot", cx: run[0].split(",")[0], cy: run[0].split(",")[1], r: 2 }));
  });
  return svg;
}
