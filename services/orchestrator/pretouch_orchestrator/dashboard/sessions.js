// The list of sessions, the newest first, a page at a time.
import { html } from "./views.js";
import { poll } from "./api.js";
import { age, heading, makeTable, mm, setRows, shortReason, showProblem, stateBadge, stateWord } from "./wording.js";

const PAGE = 25, EVERY = 2500, EVERY_OLDER = 15_000; // sessions; ms

export function showSessions(root, { signal, announce, query }) {
  const cursor = query.get("cursor") ?? "";
  const { element, rows } = makeTable("Sessions, the newest first", ["Session:", "State:", "Expected error", "At most (95 %)", "Scans", "Robot time", "Age", "Why it ended:"]);
  const message = html("div"), pages = html("nav", { "aria-label": "Pages", class: "controls" });
  element.hidden = true;
  root.append(
    heading("Sessions"),
    html("p", { class: "note" }, "Each session corrects the pose of one object that a camera saw: a robot's fingertip scans it until the error that is still expected is small enough. The newest is first."),
    message, element, pages,
  );
  let states = null;

  function take({ document: { sessions, next }, now }) {
    element.hidden = sessions.length === 0;
    if (sessions.length) message.replaceChildren();
    else message.replaceChildren(html("p", {}, cursor ? "There are no older sessions." : "There is no session yet. A robot's program opens one, over REST or gRPC: ", ...(cursor ? [] : [html("a", { href: "/docs" }, "the API"), "."])));
    setRows(rows, sessions.map((session) => [session.id, [
      html("a", { href: `#/sessions/${encodeURIComponent(session.id)}` }, session.id),
      stateBadge(session.state),
      mm(session.estimate.expected_error),
      mm(session.estimate.error_quantile),
      String(session.budget_used.scans),
      `${session.budget_used.seconds.toFixed(1)} s`,
      age(session.created, now),
      shortReason(session.reason),
    ]]));
    const links = [];
    if (cursor) links.push(html("a", { href: "#/sessions" }, "← Newest"));
    if (next) links.push(html("a", { href: `#/sessions?cursor=${encodeURIComponent(next)}` }, "Older →"));
    if (pages.shown !== `${next}`) pages.replaceChildren(...links);
    pages.shown = `${next}`;
    tellChanges(sessions);
  }

  function tellChanges(sessions) {
    const present = new Map(sessions.map((session) => [session.id, session.state]));
    if (states) {
      const news = [...present].filter(([id, state]) => states.get(id) !== state)
        .map(([id, state]) => (states.has(id) ? `Session ${id}: ${stateWord(state)}.` : `New session ${id}.`));
      if (news.length) announce(news.slice(0, 3).join(" "));
    }
    states = present;
  }

  poll(`/v1/sessions?limit=${PAGE}&cursor=${encodeURIComponent(cursor)}`, cursor ? EVERY_OLDER : EVERY, signal, take, (problem) => showProblem(message, problem));
}
