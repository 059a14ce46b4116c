// Cameras that calibrate themselves: what was learned of each, and whether one was moved.
import { html, showCameraHistory } from "./views.js";
import { getPatiently, poll, Problem } from "./api.js";
import { badge, factList, heading, makeTable, mm, setRows, showProblem } from "./wording.js";

const EVERY = 5000; // ms
const DRIFTS = { steady: ["converged", "✓", "steady"], suspected: ["exhausted", "▲", "suspected to have moved"], moved: ["failed", "✕", "moved"] };
const NOTE = "What the sessions of a camera have in common is the camera's own calibration error: it is learned, and the next session starts from it.";

export function showCameras(root, { signal, announce }) {
  const { element, rows } = makeTable("Cameras", ["Camera:", "State:", "Sessions", "Correction, camera's side:", "Correction, base's side:", "Differs from session to session:"]);
  const message = html("div");
  element.hidden = true;
  root.append(heading("Cameras"), html("p", { class: "note" }, NOTE), message, element);
  let before = null;

  function take({ document: { cameras } }) {
    element.hidden = cameras.length === 0;
    message.replaceChildren(...(cameras.length ? [] : [html("p", {}, "No camera is known yet: a request names its camera by ", html("code", {}, "camera.id"), ".")]));
    setRows(rows, cameras.map((camera) => [camera.id, [
      html("a", { href: `#/cameras/${encodeURIComponent(camera.id)}` }, camera.id),
      badge(...(DRIFTS[camera.drift.state] ?? ["failed", "?", camera.drift.state])),
      String(camera.sessions), describePose(camera.camera_T_camera), describePose(camera.base_T_base), describeResidual(camera.residual),
    ]]));
    const now = new Map(cameras.map((camera) => [camera.id, camera.drift.state]));
    const news = [...now].filter(([id, state]) => before && before.get(id) !== state).map(([id, state]) => `Camera ${id}: ${state}.`);
    if (news.length) announce(news.join(" "));
    before = now;
  }

  poll("/v1/cameras", EVERY, signal, take, (problem) => showProblem(message, problem));
}

export async function showCamera(root, { signal, name }) {
  const message = html("div"), body = html("div");
  root.append(html("p", {}, html("a", { href: "#/cameras" }, "← Cameras")), heading(`Camera ${name}`), message, body);
  const path = `/v1/cameras/${encodeURIComponent(name)}`;
  try {
    await getPatiently(path, signal);
  } catch (error) {
    if (signal.aborted) return;
    if (!(error instanceof Problem)) throw error;
    showProblem(message, error);
    return;
  }
  const state = html("p"), facts = html("div"), chart = html("div"), leftOut = html("div");
  body.append(state, html("div", { class: "row" }, html("section", { class: "panel" }, html("h2", {}, "What was learned"), facts),
    html("section", { class: "panel" }, html("h2", {}, "Error, session by session"), chart)), leftOut);
  poll(path, EVERY, signal, ({ document: camera }) => {
    message.replaceChildren();
    const { state: drift, since } = camera.drift;
    state.replaceChildren(badge(...(DRIFTS[drift] ?? ["failed", "?", drift])), ...(since ? [" since session ", html("a", { href: `#/sessions/${encodeURIComponent(since)}` }, since)] : []));
    facts.replaceChildren(factList([
      ["Sessions that count", String(camera.sessions)],
      ["Correction, camera's side", describePose(camera.camera_T_camera)],
      ["Correction, base's side", describePose(camera.base_T_base)],
      ["Differs from session to session", describeResidual(camera.residual)],
    ]));
    showCameraHistory(chart, camera);
    leftOut.replaceChildren(...(camera.left_out ?? []).map(({ session, reason }) => html("p", { class: "note" }, `Session ${session} does not count. ${reason}`)));
  }, (problem) => showProblem(message, problem));
}

function describePose({ translation, rotation: [x, y, z, w] }) {
  return `${mm(Math.hypot(...translation))} and ${((360 / Math.PI) * Math.atan2(Math.hypot(x, y, z), Math.abs(w))).toFixed(2)}°`;
}

function describeResidual({ translation_std: translation, rotation_std: rotation }) {
  return `${mm(translation)} and ${((180 / Math.PI) * rotation).toFixed(2)}° per axis`;
}
