// One session: what came of it so far, with the report's views, which grow as scans come.
import { html, showViews } from "./views.js";
import { follow, getPatiently, Problem } from "./api.js";
import { askToEnd } from "./ending.js";
import { age, factList, heading, makeTable, mm, setRows, showProblem, stateBadge, stateWord } from "./wording.js";

export async function showSession(root, { signal, announce, caller, name }) {
  const path = `/v1/sessions/${encodeURIComponent(name)}`;
  const page = makePage(name, path), message = html("div");
  root.append(page.head, message, page.body);
  const following = new AbortController();
  signal.addEventListener("abort", () => following.abort());
  let scans = null, state = null;

  const refresh = oneAtATime(async () => {
    try {
      const { document: found, now } = await getPatiently(`${path}/report?format=json`, signal);
      message.replaceChildren();
      page.fill(found, now);
      if (caller.role === "full") page.offer(found.state === "awaiting_scan", askToEnd(path, name, announce));
      if (state !== null && found.state !== state) announce(`The session: ${stateWord(found.state)}. ${found.outcome}`);
      else if (scans !== null && found.scans.length !== scans) announce(`Scan ${found.scans.length}: ${mm(found.estimates.at(-1).expected_error)} of error are expected.`);
      [scans, state] = [found.scans.length, found.state];
      if (state !== "awaiting_scan") following.abort();
    } catch (error) {
      if (signal.aborted) return;
      following.abort();
      if (!(error instanceof Problem)) throw error;
      showProblem(message, error);
      page.body.hidden = true;
    }
  });

  if (caller.role !== "full") page.refuse();
  try {
    await follow(`${path}/events`, following.signal, refresh, refresh);
  } catch (error) {
    if (signal.aborted) return;
    showProblem(message, error);
  }
}

/** The task, never twice at a time; one that is asked for meanwhile is done once more. */
function oneAtATime(task) {
  let running = false, again = false;
  return async () => {
    again = true;
    if (running) return;
    running = true;
    try {
      while (again) {
        again = false;
        await task();
      }
    } finally {
      running = false;
    }
  };
}

function makePage(name, path) {
  const badge = html("span"), camera = html("span"), facts = html("div"), outcome = html("p", { class: "outcome" }), warnings = html("div");
  const buttons = html("span", { class: "controls" });
  const links = html("p", { class: "controls" },
    html("a", { href: `${path}/report`, target: "_blank" }, "Open the report"),
    html("a", { href: `${path}/report`, download: `session-${name}.html` }, "Download the report"),
    html("a", { href: `${path}/recording.mcap`, download: `session-${name}.mcap` }, "Recording for Foxglove or Rerun (MCAP)"), buttons);
  const image = html("img"), seen = html("p", { class: "note" });
  const scans = makeTable("Scans", ["After:", "Path:", "Returns", "Samples", "Robot time", "Expected error", "At most (95 %)", "Fit (p)"]);
  const regions = makeTable("Regions", ["Region:", "Confidence", "Error expected after", "Scanned as:"]);
  const request = html("pre", { tabindex: "0" }), made = html("summary");
  const view = (kind) => html("div", { "data-view": kind });
  const picture = html("div", { class: "picture", "data-view": "picture" }, image);
  const head = html("div", {}, html("p", {}, html("a", { href: "#/sessions" }, "← Sessions")), heading(`Session ${name}`), html("p", {}, badge, camera));
  const body = html("div", {}, outcome, links, warnings,
    row(panel("What the camera saw, and where the finger went", picture, seen), panel("In numbers", facts, html("h2", {}, "Error over the session"), view("errors"))),
    panel("Before and after, in the robot's base frame", view("scene"), note("Drag or use the arrow keys to turn; pinch, Ctrl and wheel, or + and - to zoom; z is up.")),
    panel("Scans", scans.element, note("Fit: the p-value of the samples under the answer. Below 0.01 they do not fit it, and the session does not converge.")),
    row(panel("Residuals by scan", view("residuals")), panel("Regions, the proposer's best first", regions.element)),
    html("details", { class: "panel" }, made, request));
  body.hidden = true;

  function fill(found, now) {
    const { near, far, data, window: [, , width, height] } = found.picture;
    body.hidden = false;
    badge.replaceChildren(stateBadge(found.state), `, opened ${age(Date.parse(found.created) / 1000, now)} ago`);
    camera.replaceChildren(...(found.camera ? [", camera ", html("a", { href: `#/cameras/${encodeURIComponent(found.camera.id)}` }, found.camera.id)] : []));
    outcome.textContent = found.outcome;
    warnings.replaceChildren(...found.warnings.map(({ code, detail, remedy }) => html("div", { class: "warning" }, html("strong", {}, code), `: ${detail} ${remedy}`)));
    facts.replaceChildren(factList(found.facts));
    if (image.src !== data) Object.assign(image, { src: data, width, height });
    image.alt = `Depth image around the object: ${found.regions.length} regions, and ${found.scans.length} scans in their order; the tables name them.`;
    seen.textContent = `The object in colour from ${near.toFixed(3)} m (yellow) to ${far.toFixed(3)} m (dark blue); pale grey: the table; dark grey: other things; black: no depth. White outlines: regions; dots: where the finger's beams ended, numbered by scan.`;
    setRows(scans.rows, found.estimates.map((estimate, k) => [String(k), describeScan(found.scans[k - 1], estimate, k)]));
    setRows(regions.rows, found.regions.map((region) => [region.id, [region.id, region.confidence.toFixed(2), mm(region.expected_error, 2), region.scans.join(", ") || "not scanned"]]));
    made.textContent = `To reproduce it: created ${found.created}, by pretouch ${found.version}`;
    request.textContent = JSON.stringify(found.request, null, 1);
    keepFocus(body, () => showViews(body, found));
  }

  function offer(running, ask) {
    const wanted = running ? ["cancel", "purge"] : ["purge"];
    if (buttons.shown === wanted.join()) return;
    buttons.shown = wanted.join();
    buttons.replaceChildren(...wanted.map((kind) => {
      const button = html("button", { type: "button", class: "danger" }, kind === "cancel" ? "Cancel the session …" : "Remove it …");
      button.addEventListener("click", () => ask(kind));
      return button;
    }));
  }

  const refuse = () => buttons.replaceChildren(html("span", { class: "note" }, "Your token may only read: it cannot cancel or remove sessions."));
  return { head, body, fill, offer, refuse };
}

function describeScan(scan, estimate, k) {
  const errors = [mm(estimate.expected_error, 2), mm(estimate.error_quantile, 2), estimate.fit.toPrecision(3)];
  if (!scan) return ["no scan", "", "", "", "", ...errors];
  return [`scan ${k}`, scan.path, String(scan.returns), String(scan.samples), `${scan.seconds.toFixed(1)} s`, ...errors];
}

/** Updates what is under `root`; what had the focus in one of its views has it again, if there is such a thing still. */
function keepFocus(root, update) {
  const place = document.activeElement?.closest("[data-view]");
  const controls = () => [...place.querySelectorAll("canvas, input, button")];
  const index = place && root.contains(place) ? controls().indexOf(document.activeElement) : -1;
  update();
  if (index >= 0) controls()[index]?.focus({ preventScroll: true });
}

function panel(title, ...children) {
  return html("section", { class: "panel" }, html("h2", {}, title), ...children);
}

function row(...panels) {
  return html("div", { class: "row" }, ...panels);
}

function note(text) {
  return html("p", { class: "note" }, text);
}
