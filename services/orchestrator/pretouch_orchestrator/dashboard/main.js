// The page around the views: which one is shown, who calls, how the services are, and whether the orchestrator answers.
import { showCamera, showCameras } from "./cameras.js";
import { showDevices } from "./devices.js";
import { showServices } from "./services.js";
import { showSession } from "./session.js";
import { showSessions } from "./sessions.js";
import { connection, get, getPatiently, poll, Problem } from "./api.js";
import { badge, heading, showProblem } from "./wording.js";

const HEALTH_EVERY = 15_000; // ms
const main = document.getElementById("main"), banner = document.getElementById("banner"), announcer = document.getElementById("announcer");
const VIEWS = [
  [/^\/(?:sessions)?$/, showSessions],
  [/^\/sessions\/([^/]+)$/, showSession],
  [/^\/devices(?:\/([^/]+))?$/, showDevices],
  [/^\/cameras$/, showCameras],
  [/^\/cameras\/([^/]+)$/, showCamera],
  [/^\/services$/, showServices],
];
let over = new AbortController(); // ends what the present view has under way
let caller = null;

connection.addEventListener("lost", () => say("Connection lost. Retrying …", true));
connection.addEventListener("back", () => say("Connected again.", false));

function say(text, lost) {
  banner.textContent = text;
  banner.className = lost ? "lost" : "back";
  banner.hidden = false;
  if (!lost) setTimeout(() => { if (banner.className === "back") banner.hidden = true; }, 4000);
}

/** Tells those who do not see what has changed. */
function announce(text) {
  announcer.textContent = text;
}

async function route(event) {
  over.abort();
  over = new AbortController();
  const { signal } = over;
  const [path, query = ""] = (location.hash.slice(1) || "/").split("?");
  const [view, name] = VIEWS.flatMap(([pattern, show]) => (pattern.test(path) ? [[show, pattern.exec(path)[1]]] : []))[0] ?? [];
  for (const link of document.querySelectorAll("nav a")) {
    const current = link.hash.slice(1) === (path === "/" ? "/sessions" : `/${path.split("/")[1]}`);
    if (current) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  main.replaceChildren();
  try {
    caller ??= (await getPatiently("/v1/caller", signal)).document;
    document.getElementById("logout").hidden = !caller.token;
    if (signal.aborted) return;
    if (view) view(main, { signal, announce, caller, name: name && decodeURIComponent(name), query: new URLSearchParams(query) });
    else main.replaceChildren(heading("There is no such page"));
  } catch (error) {
    if (signal.aborted) return;
    if (!(error instanceof Problem)) throw error;
    showProblem(main, error);
  }
  const title = main.querySelector("h1");
  document.title = title ? `${title.textContent} – pretouch` : "pretouch";
  if (event) title?.focus();
}

async function lookForCameras() {
  const forever = new AbortController().signal;
  try {
    await get("/v1/cameras", forever);
    document.getElementById("cameras-link").hidden = false;
  } catch (error) {
    document.getElementById("cameras-link").hidden = !(error instanceof Problem && error.status !== 404);
  }
}

function showHealth({ document: { services } }) {
  const wrong = services.filter((service) => !service.ready);
  const shown = wrong.length ? badge("failed", "✕", `${wrong.map((service) => service.name).join(", ")} not ready`) : badge("converged", "✓", "all services ready");
  const health = document.getElementById("health");
  if (health.textContent !== shown.textContent) health.replaceChildren(shown);
}

window.addEventListener("hashchange", route);
route();
lookForCameras();
poll("/v1/services", HEALTH_EVERY, new AbortController().signal, showHealth, () => {});
