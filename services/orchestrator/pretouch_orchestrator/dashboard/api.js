// Calls of the REST API and streams of its events. While the orchestrator cannot be reached they are tried again, ever more
// seldom; `connection` tells of it with events `lost` and `back`. Nothing is asked while the page is hidden: a browser opens
// six connections to a host, for all of its tabs.
const TIMEOUT = 20_000, SILENCE = 45_000, FIRST_DELAY = 500, LAST_DELAY = 10_000; // ms
const FROM_NOW = "999999999999999999"; // an event's id beyond all: the stream begins with the next event

export const connection = new EventTarget();
let reached = true;

function note(now) {
  if (now !== reached) connection.dispatchEvent(new Event(now ? "back" : "lost"));
  reached = now;
}

/** The orchestrator, or what is before it, does not answer. */
export class Lost extends Error {}

/** The orchestrator answered with a problem document. */
export class Problem extends Error {
  constructor(document) {
    super(`${document.detail} ${document.remedy ?? ""}`.trim());
    this.status = document.status;
    this.retryAfter = 1000 * (document.retry_after ?? 0);
  }

  get passes() { return this.status === 429 || this.status === 503 || this.status === 504; }
}

async function request(path, options) {
  let answer;
  try {
    answer = await fetch(path, { cache: "no-store", ...options });
  } catch (error) {
    const { aborted, reason } = options.signal;
    if (!aborted || reason === "silent" || reason?.name === "TimeoutError") note(false);
    throw new Lost(error.message);
  }
  if (answer.ok) {
    note(true);
    return answer;
  }
  const problem = await answer.json().catch(() => null);
  if (!problem?.detail) {
    note(false);
    throw new Lost(`${path}: ${answer.status}`);
  }
  note(true);
  if (answer.status === 401) location.assign(`/login?next=${encodeURIComponent(`/${location.hash}`)}`);
  throw new Problem(problem);
}

/** The JSON document at `path`, and the present by the orchestrator's clock, s. */
export async function get(path, signal) {
  const answer = await request(path, { headers: { Accept: "application/json" }, signal: AbortSignal.any([signal, AbortSignal.timeout(TIMEOUT)]) });
  const now = Date.parse(answer.headers.get("Date")) / 1000 || Date.now() / 1000;
  try {
    return { document: await answer.json(), now };
  } catch (error) {
    if (!signal.aborted) note(false);
    throw new Lost(error.message);
  }
}

export async function remove(path) {
  await request(path, { method: "DELETE", signal: AbortSignal.timeout(TIMEOUT) });
}

function wait(milliseconds, signal) {
  return new Promise((resolve) => {
    const timer = setTimeout(resolve, milliseconds);
    signal.addEventListener("abort", () => { clearTimeout(timer); resolve(); }, { once: true });
  });
}

async function shown(signal) {
  while (document.hidden && !signal.aborted)
    await new Promise((resolve) => {
      document.addEventListener("visibilitychange", resolve, { once: true, signal });
      signal.addEventListener("abort", resolve, { once: true });
    });
}

function makeBackoff() {
  let delay = FIRST_DELAY;
  return { reset: () => { delay = FIRST_DELAY; }, next: () => (delay = Math.min(LAST_DELAY, 2 * delay)) * (0.75 + Math.random() / 2) };
}

/** As `get`, again and again while the orchestrator is out of reach or busy; raises any other problem, and ends with `signal`. */
export async function getPatiently(path, signal) {
  const backoff = makeBackoff();
  for (;;) {
    try {
      return await get(path, signal);
    } catch (error) {
      if (signal.aborted || (error instanceof Problem && !error.passes)) throw error;
      await wait(Math.max(backoff.next(), error.retryAfter ?? 0), signal);
    }
  }
}

/** Calls `take` with what `get` returns, every `interval` ms or more seldom on a slow network; `fail` with a problem. */
export async function poll(path, interval, signal, take, fail) {
  const backoff = makeBackoff();
  while (!signal.aborted) {
    await shown(signal);
    const began = performance.now();
    let pause = interval;
    try {
      const found = await get(path, signal);
      if (signal.aborted) return;
      backoff.reset();
      take(found);
    } catch (error) {
      if (signal.aborted) return;
      if (error instanceof Problem) fail(error);
      else if (!(error instanceof Lost)) throw error;
      pause = error instanceof Lost ? backoff.next() : Math.max(interval, error.retryAfter);
    }
    await wait(Math.max(pause, Math.min(LAST_DELAY, 3 * (performance.now() - began))), signal);
  }
}

/**
 * Follows the server-sent events at `path`, from now on, until `signal`. `open` is called at each connection: what happened
 * before is to be read then. Raises a problem that does not pass.
 */
export async function follow(path, signal, open, take) {
  const backoff = makeBackoff();
  while (!signal.aborted) {
    await shown(signal);
    const stop = new AbortController(), abort = () => stop.abort("over");
    const hide = () => document.hidden && abort();
    signal.addEventListener("abort", abort);
    document.addEventListener("visibilitychange", hide);
    let silence = setTimeout(() => stop.abort("silent"), SILENCE);
    try {
      const answer = await request(path, { headers: { Accept: "text/event-stream", "Last-Event-ID": FROM_NOW }, signal: stop.signal });
      backoff.reset();
      open();
      for await (const event of readEvents(answer.body, () => {
        clearTimeout(silence);
        silence = setTimeout(() => stop.abort("silent"), SILENCE);
      })) take(event);
    } catch (error) {
      if (signal.aborted) return;
      if (error instanceof Problem && !error.passes) throw error;
    } finally {
      clearTimeout(silence);
      signal.removeEventListener("abort", abort);
      document.removeEventListener("visibilitychange", hide);
    }
    if (!document.hidden) await wait(backoff.next(), signal);
  }
}

async function* readEvents(body, heard) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let text = "";
  try {
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      heard();
      text += value;
      const blocks = text.split("\n\n");
      text = blocks.pop();
      for (const block of blocks) {
        const fields = Object.fromEntries(block.split("\n").map((line) => [line.slice(0, line.indexOf(": ")), line.slice(line.indexOf(": ") + 2)]));
        if (fields.data) yield { type: fields.event, data: JSON.parse(fields.data) };
      }
    }
  } finally {
    reader.cancel().catch(() => {});
  }
}
