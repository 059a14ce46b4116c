// The views of one session: the picture's overlay, the scene in 3-D, errors and residuals, from the document that
// document.py describes. `showViews(root, doc)` fills the elements of `root` with a `data-view`, and may be called again
// with a newer document; the viewpoint and the slider are kept. No dependencies, no eval, no inline styles.
const SVG = "http://www.w3.org/2000/svg";

export function make(name, attributes = {}, text = "") {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text) node.textContent = text;
  return node;
}

export function html(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  node.append(...children);
  return node;
}

export function showViews(root, doc) {
  const view = (name) => root.querySelector(`[data-view=${name}]`);
  showOverlay(view("picture"), doc);
  showScene(view("scene"), doc);
  showErrors(view("errors"), doc);
  showResiduals(view("residuals"), doc);
  if (doc.camera && view("camera")) showCameraHistory(view("camera"), doc.camera, doc.id);
}

// The regions' outlines, and where each scan's beams ended, numbered in their order.
function showOverlay(place, doc) {
  const [left, top, width, height] = doc.picture.window;
  place.querySelector("svg")?.remove();
  const svg = make("svg", { viewBox: `${left - 0.5} ${top - 0.5} ${width} ${height}`, "aria-hidden": "true" });
  const size = width / 36, thin = width / 400;
  for (const region of doc.regions) {
    const points = region.corners.map((c) => c.join(",")).join(" ");
    svg.append(make("polygon", { points, fill: "none", stroke: "#fff", "stroke-width": thin, opacity: region.scans.length ? 1 : 0.45 }));
  }
  doc.scans.forEach((scan) => {
    for (let i = 0; i < scan.pixels.length; i += 2)
      svg.append(make("circle", { cx: scan.pixels[i], cy: scan.pixels[i + 1], r: 1.6 * thin, fill: "#ff8c42", stroke: "#000", "stroke-width": thin / 3 }));
  });
  doc.scans.forEach((scan, k) => {
    if (!scan.pixels.length) return;
    const [x, y] = scan.pixels;
    svg.append(make("circle", { cx: x, cy: y, r: size / 1.4, fill: "#fff", stroke: "#000", "stroke-width": thin }));
    const label = make("text", { x, y: y + size / 2.8, "text-anchor": "middle" }, String(k + 1));
    label.style.fontSize = `${size}px`;
    label.style.fill = "#000";
    svg.append(label);
  });
  place.append(svg);
}

matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  for (const each of document.querySelectorAll("[data-view=scene]")) each.scene?.draw();
});

function unpack(flat, unit) {
  return Float32Array.from(flat, (x) => x * unit);
}

function correct(points, { turn: r, shift: t }) {
  const out = new Float32Array(points.length);
  for (let i = 0; i < points.length; i += 3) {
    const x = points[i], y = points[i + 1], z = points[i + 2];
    for (let k = 0; k < 3; k++) out[i + k] = r[3 * k] * x + r[3 * k + 1] * y + r[3 * k + 2] * z + t[k];
  }
  return out;
}

const LAYERS = [["before", "camera's points as given", true], ["after", "as corrected", true], ["hit", "finger's returns", true],
  ["miss", "finger's misses", false], ["path", "fingertip's path, dashed where planned", true], ["believed", "where the centre may be (95 %), and weakest directions", true],
  ["truth", "true object", true]];

function showScene(place, doc) {
  const earlier = place.scene;
  const state = earlier?.state ?? { yaw: -2.2, pitch: 0.5, zoom: 1, shown: {} };
  const followed = !earlier || earlier.slider.value === earlier.slider.max;
  const last = doc.estimates.length - 1;
  const canvas = html("canvas", { tabindex: "0", role: "img",
    "aria-label": "The object in 3-D before and after the correction. Arrow keys turn it, plus and minus zoom. The tables hold the numbers." });
  const slider = html("input", { type: "range", min: "0", max: String(last), step: "1" });
  slider.value = followed ? String(last) : earlier.slider.value;
  const says = html("output");
  const controls = html("div", { class: "controls" }, html("label", {}, "After scan ", slider), says);
  const toggles = html("div", { class: "controls" });
  for (const [name, text, on] of LAYERS) {
    if (name === "truth" && !doc.truth?.points) continue;
    state.shown[name] ??= on;
    const box = html("input", { type: "checkbox" });
    box.checked = state.shown[name];
    box.addEventListener("change", () => { state.shown[name] = box.checked; draw(); });
    toggles.append(html("label", {}, box, html("span", { class: `swatch ${name}` }), text));
  }
  const reset = html("button", { type: "button" }, "Reset the view");
  reset.addEventListener("click", () => { Object.assign(state, { yaw: -2.2, pitch: 0.5, zoom: 1 }); draw(); });
  toggles.append(reset);
  place.replaceChildren(controls, canvas, toggles);
  place.scene = { state, slider };

  const cloud = unpack(doc.cloud, doc.unit);
  const corrected = doc.estimates.map(() => null);
  const scans = doc.scans.map((scan) => ({ hits: unpack(scan.hits, doc.unit), misses: unpack(scan.misses, doc.unit), tip: unpack(scan.tip, doc.unit) }));
  const truth = doc.truth?.points ? unpack(doc.truth.points, doc.unit) : null;
  const distances = [];
  for (let i = 0; i < cloud.length; i += 3) distances.push(Math.hypot(cloud[i], cloud[i + 1], cloud[i + 2]));
  const radius = Math.max(0.02, distances.sort((a, b) => a - b)[Math.floor(0.95 * distances.length)] ?? 0); // no stray points

  function draw() {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const style = getComputedStyle(place), colour = (name) => style.getPropertyValue(`--${name}`) || style.color;
    const cy = Math.cos(state.yaw), sy = Math.sin(state.yaw), cp = Math.cos(state.pitch), sp = Math.sin(state.pitch);
    const scale = (0.42 * Math.min(width, height) * state.zoom) / radius;
    const project = (x, y, z) => {
      const a = -sy * x + cy * y, b = cy * x + sy * y;
      return [width / 2 + scale * a, height / 2 - scale * (z * cp - b * sp)];
    };
    const dots = (points, name, size, alpha = 1, hollow = false) => {
      pen.globalAlpha = alpha;
      pen.fillStyle = pen.strokeStyle = colour(name);
      pen.lineWidth = 1;
      for (let i = 0; i < points.length; i += 3) {
        const [u, v] = project(points[i], points[i + 1], points[i + 2]);
        if (hollow) pen.strokeRect(u - size / 2, v - size / 2, size, size);
        else pen.fillRect(u - size / 2, v - size / 2, size, size);
      }
      pen.globalAlpha = 1;
    };
    const line = (points, name, width = 1.5) => {
      pen.strokeStyle = colour(name);
      pen.lineWidth = width;
      pen.beginPath();
      for (let i = 0; i < points.length; i += 3) pen[i ? "lineTo" : "moveTo"](...project(points[i], points[i + 1], points[i + 2]));
      pen.stroke();
    };
    const k = Number(slider.value), estimate = doc.estimates[k];
    if (truth && state.shown.truth) dots(truth, "soft", 2, 0.5);
    if (state.shown.before) dots(cloud, "before", 2, 0.6);
    if (state.shown.after && k) dots((corrected[k] ??= correct(cloud, estimate)), "after", 2, 0.7);
    for (let j = 0; j < k; j++) {
      if (state.shown.path) line(scans[j].tip, "path", j === k - 1 ? 2 : 1);
      if (state.shown.miss) dots(scans[j].misses, "miss", 5, 0.8, true);
      if (state.shown.hit) dots(scans[j].hits, "hit", j === k - 1 ? 4 : 3);
    }
    if (state.shown.path && k === last && doc.next_path.length) {
      pen.setLineDash([5, 4]);
      line(unpack(doc.next_path, doc.unit), "path", 2);
      pen.setLineDash([]);
    }
    if (state.shown.believed) drawBelief(line, estimate);
    drawScale(pen, scale, height, colour("text"));
    drawAxes(pen, (x, y, z) => project(x / scale, y / scale, z / scale), width, height, colour("text"));
    const mm = (x) => `${(1000 * x).toFixed(1)} mm`;
    const scan = k ? doc.scans[k - 1] : null;
    says.textContent = (scan ? `${k} of ${last}: ${scan.path}, ${scan.returns} of ${scan.samples} samples returned` : `0 of ${last}: before the first scan`)
      + `; error expected ${mm(estimate.expected_error)}, at most ${mm(estimate.error_quantile)} (95 %)`
      + (doc.truth ? `, truly ${mm(doc.truth.errors[k])}` : "");
  }

  slider.addEventListener("input", draw);
  canvas.addEventListener("keydown", (event) => {
    const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
    if (turns[event.key]) turn(...turns[event.key]);
    else if (event.key === "+" || event.key === "=") zoom(1.15);
    else if (event.key === "-") zoom(1 / 1.15);
    else return;
    event.preventDefault();
  });
  function turn(yaw, pitch) {
    state.yaw -= yaw;
    state.pitch = Math.min(1.57, Math.max(-1.57, state.pitch + pitch));
    draw();
  }
  function zoom(factor) {
    state.zoom = Math.min(30, Math.max(0.2, state.zoom * factor));
    draw();
  }
  const fingers = new Map();
  canvas.addEventListener("pointerdown", (event) => { canvas.setPointerCapture(event.pointerId); fingers.set(event.pointerId, event); });
  for (const type of ["pointerup", "pointercancel"]) canvas.addEventListener(type, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const other = [...fingers.values()].find((each) => each.pointerId !== event.pointerId);
    fingers.set(event.pointerId, event);
    if (other) {
      const span = (each) => Math.hypot(each.clientX - other.clientX, each.clientY - other.clientY) + 1;
      zoom(span(event) / span(before));
    } else turn((event.clientX - before.clientX) / 150, (event.clientY - before.clientY) / 150);
  });
  canvas.addEventListener("wheel", (event) => {  // with Ctrl, so that the page scrolls as ever
    if (!event.ctrlKey && document.activeElement !== canvas) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400));
  }, { passive: false });
  earlier?.observer?.disconnect();
  place.scene.observer = new ResizeObserver(draw);
  place.scene.observer.observe(canvas);
  place.scene.draw = draw;
  draw();
}

// The ellipsoid's three principal ellipses about the centre, and arrows of two standard deviations along the translations of
// the weakest directions.
function drawBelief(line, estimate) {
  const c = estimate.centre;
  for (const [i, j] of [[0, 1], [0, 2], [1, 2]]) {
    const [p, q] = [estimate.axes[i], estimate.axes[j]], ring = [];
    for (let n = 0; n <= 48; n++) {
      const a = Math.cos((n * Math.PI) / 24), b = Math.sin((n * Math.PI) / 24);
      for (let k = 0; k < 3; k++) ring.push(c[k] + a * p[k] + b * q[k]);
    }
    line(ring, "believed");
  }
  for (const { direction, std } of estimate.weak) {
    const way = direction.slice(3);
    line([-2, 2].flatMap((s) => way.map((x, k) => c[k] + s * std * x)), "believed", 3);
  }
}

function drawScale(pen, scale, height, colour) {
  const length = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1].findLast((x) => x * scale < 140) ?? 0.001;
  pen.fillStyle = colour;
  pen.fillRect(12, height - 14, length * scale, 3);
  pen.font = "12px system-ui, sans-serif";
  pen.fillText(`${1000 * length} mm`, 12, height - 20);
}

// The base frame's directions, in a corner.
function drawAxes(pen, project, width, height, colour) {
  const [u0, v0] = [width - 55 - width / 2, height - 45 - height / 2];
  pen.strokeStyle = pen.fillStyle = colour;
  pen.lineWidth = 1.5;
  for (const [name, axis] of [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]]) {
    const at = (length) => project(...axis.map((c) => c * length)).map((c, k) => c + [u0, v0][k]);
    pen.beginPath();
    pen.moveTo(...at(0));
    pen.lineTo(...at(28));
    pen.stroke();
    const [u, v] = at(38);
    pen.fillText(name, u - 3, v + 4);
  }
}

// A chart's frame with a y axis in mm from low to high; returns the svg and the two scales.
export function frame(place, low, high, xs, label, description) {
  const W = Math.min(560, Math.max(280, place.clientWidth)), H = 300, L = 48, R = 12, T = 12, B = 44;
  const svg = make("svg", { class: "chart", viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": description });
  const x0 = xs[0].at, x1 = Math.max(xs.at(-1).at, x0 + 1e-9);
  const x = (v) => L + ((v - x0) / (x1 - x0)) * (W - L - R);
  const y = (v) => T + ((high - v) / (high - low)) * (H - T - B);
  const step = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500].find((s) => (high - low) / s <= 7) ?? 1000;
  for (let v = Math.ceil(low / step) * step; v <= high + 1e-9; v += step) {
    svg.append(make("line", { class: "grid", x1: L, x2: W - R, y1: y(v), y2: y(v) }));
    svg.append(make("text", { x: L - 6, y: y(v) + 4, "text-anchor": "end" }, String(+v.toFixed(2))));
  }
  let free = -Infinity;
  for (const { at, text } of xs) {
    if (x(at) < free) continue;
    svg.append(make("text", { x: x(at), y: H - B + 18, "text-anchor": "middle" }, text));
    free = x(at) + 9 + 7 * text.length;
  }
  svg.append(make("text", { x: (L + W - R) / 2, y: H - 6, "text-anchor": "middle" }, label));
  svg.append(make("text", { x: 12, y: (T + H - B) / 2, transform: `rotate(-90 12 ${(T + H - B) / 2})`, "text-anchor": "middle" }, "mm"));
  return { svg, x, y };
}

function showErrors(place, doc) {
  const axis = place.axis ?? "scans";
  const choose = html("div", { class: "controls", role: "group", "aria-label": "Horizontal axis" });
  for (const [name, text] of [["scans", "over scans"], ["seconds", "over robot seconds"]]) {
    const button = html("button", { type: "button", "aria-pressed": String(axis === name) }, text);
    button.addEventListener("click", () => { place.axis = name; showErrors(place, doc); });
    choose.append(button);
  }
  let seconds = 0;
  const times = [0, ...doc.scans.map((scan) => (seconds += scan.seconds))];
  const xs = doc.estimates.map((_, k) => (axis === "scans" ? { at: k, text: String(k) } : { at: times[k], text: times[k].toFixed(0) }));
  const expected = doc.estimates.map((e) => 1000 * e.expected_error), most = doc.estimates.map((e) => 1000 * e.error_quantile);
  const truth = doc.truth?.errors.map((e) => 1000 * e), asked = 1000 * doc.tolerance.error;
  const high = 1.08 * Math.max(asked, ...most, ...(truth ?? []));
  const label = axis === "scans" ? "scans made" : "robot seconds";
  const { svg, x, y } = frame(place, 0, high, xs, label, `Error over ${label}: expected ${expected.map((e) => e.toFixed(1)).join(", ")} mm; the table holds the numbers.`);
  const path = (values) => values.map((v, k) => `${x(xs[k].at)},${y(v)}`).join(" ");
  svg.append(make("polygon", { class: "band", points: `${path(most)} ${x(xs.at(-1).at)},${y(0)} ${x(xs[0].at)},${y(0)}` }));
  if (xs.length === 1) svg.append(make("line", { class: "expected", x1: x(xs[0].at), x2: x(xs[0].at), y1: y(0), y2: y(most[0]), opacity: 0.4 }));
  svg.append(make("line", { class: "asked", x1: x(xs[0].at), x2: x(Math.max(xs.at(-1).at, xs[0].at + 1e-9)), y1: y(asked), y2: y(asked) }));
  const series = [[expected, "expected", "dot"], ...(truth ? [[truth, "true", "truedot"]] : [])];
  for (const [values, line, dot] of series) {
    svg.append(make("polyline", { class: line, points: path(values) }));
    values.forEach((v, k) => svg.append(make("circle", { class: dot, cx: x(xs[k].at), cy: y(v), r: 3.5 })));
  }
  const note = `Solid: expected mean error where it counts. Shaded: it is in here with 95 % probability. Dashed: ${asked.toFixed(1)} mm were asked for.`
    + (truth ? " Dotted: the true error, which only a simulation knows." : "");
  place.replaceChildren(choose, svg, html("p", { class: "note" }, note));
}

function showResiduals(place, doc) {
  const known = doc.scans.map((scan, k) => [k + 1, scan.residuals.map((r) => 1000 * r)]).filter(([, r]) => r.length);
  if (!known.length) {
    place.replaceChildren(html("p", {}, doc.scans.length ? "No sample of a scan met anything that the camera saw." : "There is no scan yet."));
    return;
  }
  const std = 1000 * doc.range_std, reach = 1.1 * Math.max(2 * std, ...known.flatMap(([, r]) => r.map(Math.abs)));
  const xs = [{ at: 0.4, text: "" }, ...doc.scans.map((_, k) => ({ at: k + 1, text: String(k + 1) })), { at: doc.scans.length + 0.6, text: "" }];
  const { svg, x, y } = frame(place, -reach, reach, xs, "scan", `Residuals by scan, median: ${known.map(([k, r]) => `${k}: ${r[2].toFixed(1)} mm`).join(", ")}`);
  const half = Math.min(14, (0.3 * 500) / doc.scans.length);
  svg.append(make("rect", { class: "band", x: x(0.4), width: x(doc.scans.length + 0.6) - x(0.4), y: y(2 * std), height: y(-2 * std) - y(2 * std) }));
  for (const [k, [p5, p25, p50, p75, p95]] of known) {
    svg.append(make("line", { class: "whisker", x1: x(k), x2: x(k), y1: y(p5), y2: y(p95) }));
    svg.append(make("rect", { class: "box", x: x(k) - half, width: 2 * half, y: y(p75), height: Math.max(1, y(p25) - y(p75)) }));
    svg.append(make("line", { class: "whisker", x1: x(k) - half, x2: x(k) + half, y1: y(p50), y2: y(p50) }));
  }
  place.replaceChildren(svg, html("p", { class: "note" },
    "How much farther the finger measured than the camera's points lie after the last correction: median, middle half, and 5 to 95 %. "
    + `Shaded: two standard deviations of one range. Boxes far outside it, or on one side, mean that the samples fit badly.`));
}

// A camera's errors over its sessions, and a line where it was found to have moved; the session `own` has a ring.
export function showCameraHistory(place, { history, drift }, own) {
  if (!history.length) {
    place.replaceChildren(html("p", {}, "There is no session yet."));
    return;
  }
  const errors = history.map((each) => 1000 * each.error), predicted = history.map((each) => 1000 * each.expected_error);
  const xs = history.map((_, k) => ({ at: k + 1, text: String(k + 1) }));
  const { svg, x, y } = frame(place, 0, 1.1 * Math.max(...errors, ...predicted), xs, "session", `Error before each session: ${errors.map((each) => each.toFixed(1)).join(", ")} mm.`);
  svg.append(make("polyline", { class: "asked line", points: predicted.map((value, k) => `${x(k + 1)},${y(value)}`).join(" ") }));
  svg.append(make("polyline", { class: "expected", points: errors.map((value, k) => `${x(k + 1)},${y(value)}`).join(" ") }));
  errors.forEach((value, k) => svg.append(make("circle", { class: "dot", cx: x(k + 1), cy: y(value), r: 3.5 })));
  const knocked = history.findIndex((each) => each.session === drift.since);
  if (knocked >= 0) {
    svg.append(make("line", { class: "alarm", x1: x(knocked + 1), x2: x(knocked + 1), y1: y(0), y2: 12 }));
    svg.append(make("text", { x: x(knocked + 1) + 5, y: 24 }, `▲ ${drift.state}`));
  }
  const mine = history.findIndex((each) => each.session === own);
  if (mine >= 0) svg.append(make("circle", { class: "own", cx: x(mine + 1), cy: y(errors[mine]), r: 7 }));
  place.replaceChildren(svg, html("p", { class: "note" }, "Solid: how far the camera misplaced the object's points, as each session found. Dashed: how much of that was expected to be left by what had been learned before it. Where the solid line jumps by far more than the dashed one allows, the camera was moved."
    + (mine >= 0 ? " Ringed: this session." : "")));
}
