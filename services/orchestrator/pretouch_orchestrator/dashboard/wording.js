// What numbers and states are called, and the elements that say it. Whatever came from a client is set as text.
import { html } from "./views.js";

const STATES = {
  awaiting_scan: ["●", "Under way"],
  converged: ["✓", "Converged"],
  exhausted: ["▲", "Exhausted"],
  failed: ["✕", "Failed"],
  cancelled: ["■", "Cancelled"],
};
const REASONS = {
  scans: "no scan left", seconds: "no robot time left", fraction: "scanned enough of it", "nothing-to-gain": "nothing to gain",
  "out-of-range": "nothing in range", misfit: "samples fit no pose", sensor: "sensor faulty",
};

/** A symbol and a word: colour alone says nothing. */
export function badge(kind, symbol, word) {
  return html("span", { class: `badge ${kind}` }, html("span", { "aria-hidden": "true" }, symbol), ` ${word}`);
}

export function stateBadge(state) {
  const [symbol, word] = STATES[state] ?? ["?", state];
  return badge(state, symbol, word);
}

export function stateWord(state) {
  return STATES[state]?.[1] ?? state;
}

export function shortReason(reason) {
  const name = reason?.type?.split(":").at(-1) ?? "";
  return REASONS[name] ?? name.replaceAll("-", " ");
}

export function mm(metres, digits = 1) {
  return metres === null || metres === undefined ? "–" : `${(1000 * metres).toFixed(digits)} mm`;
}

export function age(created, now) {
  if (created === null || created === undefined) return "–";
  const seconds = Math.max(0, now - created);
  for (const [unit, name] of [[86400, "d"], [3600, "h"], [60, "min"]]) if (seconds >= unit) return `${Math.floor(seconds / unit)} ${name}`;
  return `${Math.floor(seconds)} s`;
}

export function heading(text, ...more) {
  return html("h1", { tabindex: "-1" }, text, ...more);
}

/** A problem of the API in place of what could not be shown. */
export function showProblem(place, error) {
  place.replaceChildren(html("p", { class: "warning", role: "alert" }, error.message));
}

/** An empty table in a place that scrolls by itself; `rows` is its body. Columns whose heading ends in ":" hold text, others numbers. */
export function makeTable(label, headings) {
  const rows = html("tbody");
  rows.kinds = headings.map((heading) => (heading.endsWith(":") ? "text" : "number"));
  const head = html("tr", {}, ...headings.map((heading, k) => html("th", { scope: "col", class: rows.kinds[k] }, heading.replace(/:$/, ""))));
  const table = html("table", { class: "wide" }, html("caption", { class: "unseen" }, label), html("thead", {}, head), rows);
  return { element: html("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": label }, table), rows };
}

/** Sets the body's rows, of texts or elements; a row keeps its element, and so the focus, as long as its key is there. */
export function setRows(rows, keyed) {
  const present = new Map([...rows.children].map((row) => [row.dataset.key, row]));
  let before = null;
  for (const [key, cells] of keyed) {
    const row = present.get(key) ?? html("tr", { "data-key": key });
    present.delete(key);
    cells.forEach((cell, k) => {
      const place = row.children[k] ?? row.appendChild(html(k ? "td" : "th", { class: rows.kinds[k], ...(k ? {} : { scope: "row" }) }));
      const text = typeof cell === "string" ? cell : cell.outerHTML;
      if (place.shown === text) return;
      place.shown = text;
      place.replaceChildren(cell);
    });
    const next = before ? before.nextElementSibling : rows.firstElementChild;
    if (row !== next) rows.insertBefore(row, next);
    before = row;
  }
  for (const row of present.values()) row.remove();
}

/** Pairs of a name and a value as a description list. */
export function factList(pairs) {
  return html("dl", { class: "facts" }, ...pairs.flatMap(([name, value]) => [html("dt", {}, name), html("dd", {}, value)]));
}
