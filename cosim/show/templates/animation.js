"use strict";
// Plays every <div class="player" data-...> on the page: the group from above in road coordinates, with charts of gaps and TTC below.
const NS = "http://www.w3.org/2000/svg", W = 560, TOP = 130, CHART = 92, LEFT = 44;
function make(parent, name, attributes, text) {
  const node = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  parent.appendChild(node);
  return node;
}
function chart(svg, y, episode, name, unit, limit) {
  const t = episode.time, x = k => LEFT + (W - LEFT - 8) * (t[k] - t[0]) / (t[t.length - 1] - t[0]);
  const values = episode.vehicles.flatMap(v => v[name]).filter(v => v !== null && v <= limit);
  const low = Math.min(0, ...values), high = Math.max(low + 1, ...values) * 1.08;
  const h = CHART - 30, at = v => y + h - h * (Math.min(v, high) - low) / (high - low);
  make(svg, "rect", {x: x(t.findIndex(v => v >= 0)), y: y, height: h,
    width: (W - LEFT - 8) * episode.drive_duration / (t[t.length - 1] - t[0]), fill: "var(--v0)", opacity: 0.09});
  for (const v of [low, high / 2, high]) {
    make(svg, "line", {x1: LEFT, x2: W - 8, y1: at(v), y2: at(v), class: "axis"});
    make(svg, "text", {x: LEFT - 4, y: at(v) + 4, "text-anchor": "end"}, v.toFixed(v < 10 ? 1 : 0));
  }
  make(svg, "text", {x: LEFT, y: y - 4}, unit);
  for (const v of episode.vehicles) {
    let path = "", pen = false;
    v[name].forEach((value, k) => {
      if (value === null || value > limit) { pen = false; return; }
      path += (pen ? "L" : "M") + x(k).toFixed(1) + " " + at(value).toFixed(1); pen = true;
    });
    if (path) make(svg, "path", {d: path, fill: "none", stroke: `var(--v${v.role})`, "stroke-width": 1.8});
  }
  for (let s = Math.ceil(t[0]); s <= t[t.length - 1]; s += 2)
    make(svg, "text", {x: LEFT + (W - LEFT - 8) * (s - t[0]) / (t[t.length - 1] - t[0]), y: y + h + 13, "text-anchor": "middle"}, s);
  return {x, y, h};
}
function play(box) {
  const episode = JSON.parse(box.querySelector("script").textContent), n = episode.time.length;
  const svg = make(box, "svg", {viewBox: `0 0 ${W} ${TOP + 2 * CHART + 26}`, role: "img"});
  const known = episode.vehicles.flatMap(v => v.s.map((s, k) => [s, v.d[k], v.length])).filter(p => p[0] !== null);
  const spans = episode.time.map((_, k) => { const s = episode.vehicles.flatMap(v => v.s[k] === null ? [] : [v.s[k], v.s[k] - v.length]);
    return Math.max(...s) - Math.min(...s); });
  const span = Math.max(30, ...spans.filter(Number.isFinite)) + 12, scale = (W - 16) / span;
  const lateral = known.map(p => p[1]), middle = (Math.min(...lateral) + Math.max(...lateral)) / 2;
  const wide = Math.max(scale, Math.min(9, 90 / (Math.max(...lateral) - Math.min(...lateral) + 3.5)));
  const road = make(svg, "g", {}), cars = make(svg, "g", {}), edges = make(svg, "g", {});
  make(svg, "text", {x: 8, y: TOP - 6}, `road seen from above, driving to the right; ${span.toFixed(0)} m are shown`);
  const charts = [chart(svg, TOP + 22, episode, "gap", "net gap to the vehicle ahead [m]", 1e9),
                  chart(svg, TOP + CHART + 22, episode, "ttc", "time to collision [s], up to 60", 60)];
  make(svg, "text", {x: W - 8, y: TOP + 2 * CHART + 18, "text-anchor": "end"}, "time since take-over [s]");
  const now = charts.map(c => make(svg, "line", {y1: c.y, y2: c.y + c.h, class: "now"}));
  const row = box.appendChild(document.createElement("div")); row.className = "row";
  const button = row.appendChild(document.createElement("button")), slider = row.appendChild(document.createElement("input"));
  const status = row.appendChild(document.createElement("output"));
  button.textContent = "play"; slider.type = "range"; slider.min = 0; slider.max = n - 1;
  slider.setAttribute("aria-label", "time"); slider.value = Math.max(0, episode.time.findIndex(t => t >= 0));
  function draw() {
    const k = +slider.value, t = episode.time[k];
    const front = Math.max(...episode.vehicles.filter(v => v.s[k] !== null).map(v => v.s[k]));
    const X = s => W - 12 - (front + 4 - s) * scale, Y = d => TOP / 2 - (d - middle) * wide;
    road.replaceChildren(); cars.replaceChildren(); edges.replaceChildren();
    for (let s = Math.floor((front - span) / 10) * 10; s < front + 10; s += 10)
      if (X(s) > 0) { make(road, "line", {x1: X(s), x2: X(s), y1: 8, y2: TOP - 22, class: "axis"});
        if (s % 50 === 0) make(road, "text", {x: X(s) + 2, y: 12}, s + " m"); }
    for (const v of episode.vehicles) {
      if (v.s[k] === null) continue;
      const x = X(v.s[k]), y = Y(v.d[k]), h = Math.max(9, v.width * wide);
      const g = make(cars, "g", {transform: `rotate(${(-v.angle[k] * 180 / Math.PI).toFixed(2)} ${x} ${y})`});
      make(g, "rect", {x: x - v.length * scale, y: y - h / 2, width: v.length * scale, height: h, rx: 2, fill: `var(--v${v.role})`,
        stroke: v.driven[k] ? "var(--ink)" : "none", "stroke-width": 1.6});
      make(cars, "text", {x: x - v.length * scale / 2, y: y + h / 2 + 12, "text-anchor": "middle"},
        `${v.role}: ${v.v[k].toFixed(1)} m/s`);
    }
    const times = episode.edges.map(e => e.time).filter(s => s <= t + 1e-6), last = Math.max(...times);
    for (const e of episode.edges.filter(e => e.time === last)) {
      const a = episode.vehicles[e.from], b = episode.vehicles[e.to];
      if (a.s[k] === null || b.s[k] === null) continue;
      const x1 = X(a.s[k]) - a.length * scale / 2, x2 = X(b.s[k]) - b.length * scale / 2, y1 = Y(a.d[k]) - 6, y2 = Y(b.d[k]) - 6;
      const up = Math.min(y1, y2) - 14 - 10 * Math.abs(e.from - e.to), colour = `var(--${e.type})`;
      make(edges, "path", {d: `M${x1} ${y1} Q${(x1 + x2) / 2} ${up} ${x2} ${y2}`, fill: "none", stroke: colour, "stroke-width": 2});
      make(edges, "circle", {cx: x2, cy: y2, r: 3.5, fill: colour});
      const label = make(edges, "text", {x: (x1 + x2) / 2, y: up + 4, "text-anchor": "middle"},
        `${e.to} ${e.type.replace("_", " ")} ${e.from}, p ${e.p.toFixed(2)}`);
      label.style.fill = colour;
    }
    now.forEach((line, c) => { line.setAttribute("x1", charts[c].x(k)); line.setAttribute("x2", charts[c].x(k)); });
    status.textContent = `${t.toFixed(1)} s, ` + (t < -1e-6 ? "history" : t < episode.drive_duration + 1e-6 ? "driven" : "handed back");
  }
  let running = false, began = 0, from = 0;
  function frame(stamp) {
    if (!running) return;
    if (!began) { began = stamp; from = episode.time[+slider.value]; }
    const t = from + (stamp - began) / 1000;
    let k = episode.time.findIndex(v => v >= t);
    if (k < 0) { k = n - 1; stop(); }
    slider.value = k; draw();
    if (running) requestAnimationFrame(frame);
  }
  function stop() { running = false; button.textContent = "play"; }
  button.onclick = () => {
    if (running) return stop();
    if (+slider.value >= n - 1) slider.value = 0;
    running = true; began = 0; button.textContent = "stop"; requestAnimationFrame(frame);
  };
  slider.oninput = () => { began = 0; draw(); };
  draw();
}
document.querySelectorAll(".player").forEach(play);
