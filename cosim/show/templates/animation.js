"use strict";
// Plays every <div class="player"> on the page. Each <script> in it is one drive: the road from above in road
// coordinates, with charts of gaps and times to collision below. Several drives in one player run side by side.
const NS = "http://www.w3.org/2000/svg", TOP = 150, CHART = 96, LEFT = 40, DASH = ["none", "7 3", "2 3"];
function make(parent, name, attributes, text) {
  const node = document.createElementNS(NS, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  parent.appendChild(node);
  return node;
}
function marker(svg, role, x, y, colour) {
  const shape = [`M${x - 3} ${y}a3 3 0 1 0 6 0a3 3 0 1 0 -6 0`, `M${x - 3} ${y - 3}h6v6h-6z`, `M${x} ${y - 4}l4 7h-8z`][role % 3];
  make(svg, "path", {d: shape, fill: colour});
}
function chart(svg, W, y, episode, name, unit, limit) {
  const t = episode.time, x = k => LEFT + (W - LEFT - 8) * (t[k] - t[0]) / (t[t.length - 1] - t[0]);
  const values = episode.vehicles.flatMap(v => v[name]).filter(v => v !== null && v <= limit);
  const low = Math.min(0, ...values), high = Math.max(low + 1, ...values) * 1.08;
  const h = CHART - 34, at = v => y + h - h * (Math.min(v, high) - low) / (high - low);
  make(svg, "rect", {x: x(t.findIndex(v => v >= 0)), y: y, height: h,
    width: (W - LEFT - 8) * episode.drive_duration / (t[t.length - 1] - t[0]), fill: "var(--v0)", opacity: 0.09});
  for (const v of [low, (low + high) / 2, high]) {
    make(svg, "line", {x1: LEFT, x2: W - 8, y1: at(v), y2: at(v), class: "axis"});
    make(svg, "text", {x: LEFT - 4, y: at(v) + 4, "text-anchor": "end"}, v.toFixed(v < 10 ? 1 : 0));
  }
  make(svg, "text", {x: LEFT, y: y - 5}, unit);
  for (const v of episode.vehicles) {
    let path = "", pen = false;
    v[name].forEach((value, k) => {
      if (value === null || value > limit) { pen = false; return; }
      path += (pen ? "L" : "M") + x(k).toFixed(1) + " " + at(value).toFixed(1); pen = true;
      if (k % 20 === 7 * v.role) marker(svg, v.role, x(k), at(value), `var(--v${v.role})`);
    });
    if (path) make(svg, "path", {d: path, fill: "none", stroke: `var(--v${v.role})`, "stroke-width": 1.8, "stroke-dasharray": DASH[v.role % 3]});
  }
  const every = W < 420 ? 5 : 2;
  for (let s = Math.ceil(t[0] / every) * every; s <= t[t.length - 1]; s += every)
    make(svg, "text", {x: LEFT + (W - LEFT - 8) * (s - t[0]) / (t[t.length - 1] - t[0]), y: y + h + 14, "text-anchor": "middle"}, s);
  return {x, y, h};
}
function scene(figure, episode) {
  const n = episode.time.length;
  if (episode.title) figure.appendChild(document.createElement("figcaption")).textContent = episode.title;
  const W = Math.round(Math.min(Math.max(figure.clientWidth || 560, 280), 900));
  const svg = make(figure, "svg", {viewBox: `0 0 ${W} ${TOP + 2 * CHART + 30}`, role: "img"});
  make(svg, "title", {}, episode.title || "Animation of the episode");
  make(svg, "desc", {}, episode.text);
  svg.setAttribute("aria-label", episode.text);
  const spans = episode.time.map((_, k) => { const s = episode.vehicles.flatMap(v => v.s[k] === null ? [] : [v.s[k], v.s[k] - v.length]);
    return Math.max(...s) - Math.min(...s); });
  const span = Math.max(W < 420 ? 70 : 110, Math.max(0, ...spans.filter(Number.isFinite)) + 24), scale = W / span;
  const lateral = [...episode.vehicles, ...episode.ghosts].flatMap(v => v.d.filter((d, k) => v.s[k] !== null));
  const low = Math.min(...lateral), high = Math.max(...lateral), middle = (low + high) / 2;
  const wide = Math.min(9, (TOP - 34) / (high - low + 7.5)), mid = (TOP - 12) / 2;
  const clip = `road${Math.random().toString(36).slice(2)}`;
  make(make(svg, "clipPath", {id: clip}), "rect", {x: 0, y: 14, width: W, height: TOP - 34});
  const all = make(svg, "g", {"clip-path": `url(#${clip})`}), road = make(all, "g", {}), cars = make(all, "g", {}), edges = make(svg, "g", {});
  make(svg, "text", {x: 0, y: TOP - 6}, `${span.toFixed(0)} m of road, driving to the right`);
  const charts = [chart(svg, W, TOP + 22, episode, "gap", "net gap to the vehicle ahead [m]", 1e9),
                  chart(svg, W, TOP + CHART + 22, episode, "ttc", "time to collision [s], up to 60", 60)];
  make(svg, "text", {x: W - 8, y: TOP + 2 * CHART + 22, "text-anchor": "end"}, "time since take-over [s]");
  const now = charts.map(c => make(svg, "line", {y1: c.y, y2: c.y + c.h, class: "now"}));
  function vehicle(parent, X, Y, v, i, style) {
    const s = v.s[i], x = X(s), y = Y(v.d[i]), h = v.width * wide, angle = Math.atan2(Math.tan(v.angle ? v.angle[i] : 0) * wide, scale);
    const g = make(parent, "g", {transform: `rotate(${(-angle * 180 / Math.PI).toFixed(2)} ${x} ${y})`});
    make(g, "rect", {x: x - v.length * scale, y: y - h / 2, width: v.length * scale, height: h, rx: 2, ...style});
    return [x - v.length * scale / 2, y, h];
  }
  function draw(time) {
    let k = episode.time.findIndex(t => t >= time - 1e-6);
    if (k < 0) k = n - 1;
    const t = episode.time[k], there = episode.vehicles.filter(v => v.s[k] !== null);
    const center = there.length ? (Math.max(...there.map(v => v.s[k])) + Math.min(...there.map(v => v.s[k] - v.length))) / 2 : 0;
    const X = s => W / 2 + (s - center) * scale, Y = d => mid - (d - middle) * wide;
    road.replaceChildren(); cars.replaceChildren(); edges.replaceChildren();
    for (const lane of episode.lanes)
      make(road, "path", {d: "M" + lane.s.map((s, i) => `${X(s).toFixed(1)} ${Y(lane.d[i]).toFixed(1)}`).join("L"), class: "lane",
        "stroke-width": (lane.width * wide).toFixed(1), "stroke-linecap": "butt"});
    for (const lane of episode.lanes) for (const side of [-1, 1])
      make(road, "path", {d: "M" + lane.s.map((s, i) => `${X(s).toFixed(1)} ${Y(lane.d[i] + side * lane.width / 2).toFixed(1)}`).join("L"),
        class: "line", "stroke-dasharray": (side < 0 ? lane.rightmost : lane.leftmost) ? "none" : "9 9"});
    for (let s = Math.floor((center - span / 2) / 50) * 50; s < center + span; s += 50)
      make(edges, "text", {x: Math.max(X(s), 0), y: 10}, X(s) >= 0 && X(s) < W - 30 ? s + " m" : "");
    for (const v of episode.neighbours) {
      const i = k - v.first;
      if (i >= 0 && i < v.s.length && v.s[i] !== null && Math.abs(v.s[i] - center) < span) vehicle(cars, X, Y, v, i, {class: "other"});
    }
    for (const v of episode.ghosts)
      if (v.s[k] !== null) vehicle(cars, X, Y, v, k, {fill: "none", stroke: `var(--v${v.role})`, "stroke-width": 1.6, "stroke-dasharray": "3 2"});
    for (const v of there) {
      const [x, y, h] = vehicle(cars, X, Y, v, k, {fill: `var(--v${v.role})`, stroke: v.driven[k] ? "var(--ink)" : "none", "stroke-width": 1.8});
      make(cars, "text", {x, y: y + 4, "text-anchor": "middle", class: "role"}, v.role);
    }
    if (t > episode.drive_duration + 1e-6) return show(k, t, there);
    const times = episode.edges.map(e => e.time).filter(s => s <= t + 1e-6), last = Math.max(...times);
    episode.edges.filter(e => e.time === last).forEach((e, row) => {
      const a = episode.vehicles[e.from], b = episode.vehicles[e.to];
      if (a.s[k] === null || b.s[k] === null) return;
      const x1 = X(a.s[k]) - a.length * scale / 2, x2 = X(b.s[k]) - b.length * scale / 2, y1 = Y(a.d[k]) - 8, y2 = Y(b.d[k]) - 8;
      const up = Math.max(Math.min(y1, y2) - 12 - 10 * Math.abs(e.from - e.to), 18), colour = `var(--${e.type})`;
      make(edges, "path", {d: `M${x1} ${y1} Q${(x1 + x2) / 2} ${up} ${x2} ${y2}`, fill: "none", stroke: colour, "stroke-width": 2});
      make(edges, "circle", {cx: x2, cy: y2, r: 3.5, fill: colour});
      const label = make(edges, "text", {x: Math.min(Math.max((x1 + x2) / 2, 60), W - 60), y: 24 + 12 * row, "text-anchor": "middle", class: "edge"},
        `${e.to} ${e.type.replace("_", " ")} ${e.from}, p ${e.p.toFixed(2)}`);
      label.style.fill = colour;
    });
    show(k, t, there);
  }
  function show(k, t, there) {
    now.forEach((line, c) => { line.setAttribute("x1", charts[c].x(k)); line.setAttribute("x2", charts[c].x(k)); });
    const speeds = there.map(v => `${v.role}: ${v.v[k].toFixed(1)}`).join(", ");
    state.textContent = (t < -1e-6 ? "history" : t < episode.drive_duration + 1e-6 ? "driven" : "handed back") + `; speeds [m/s] ${speeds}`;
  }
  const state = figure.appendChild(document.createElement("p"));
  state.className = "soft state";
  return draw;
}
function play(box, at) {
  const episodes = [...box.querySelectorAll("script")].map(s => JSON.parse(s.textContent));
  const grid = box.appendChild(document.createElement("div"));
  grid.className = "drives";
  const figures = episodes.map(() => grid.appendChild(document.createElement("figure")));  // all, before any is measured
  const scenes = episodes.map((episode, k) => scene(figures[k], episode)), longest = episodes.reduce((a, b) => a.time.length >= b.time.length ? a : b);
  const time = longest.time, n = time.length;
  const row = box.appendChild(document.createElement("div")); row.className = "row";
  const button = row.appendChild(document.createElement("button")), slider = row.appendChild(document.createElement("input"));
  const status = row.appendChild(document.createElement("output"));
  const start = Number((location.hash.match(/t=(-?[\d.]+)/) || [0, 0])[1]);  // #t=2.5 begins at 2.5 s
  button.type = "button"; button.textContent = "play"; slider.type = "range"; slider.min = 0; slider.max = n - 1;
  slider.setAttribute("aria-label", "time since take-over"); slider.value = at ?? Math.max(0, time.findIndex(t => t >= start));
  function draw() {
    const t = time[+slider.value];
    scenes.forEach(scene => scene(t));
    status.textContent = `${t.toFixed(1)} s`;
    slider.setAttribute("aria-valuetext", status.textContent);
  }
  let running = false, began = 0, from = 0;
  function frame(stamp) {
    if (!running) return;
    if (!began) { began = stamp; from = time[+slider.value]; }
    let k = time.findIndex(v => v >= from + (stamp - began) / 1000);
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
  const width = box.clientWidth;
  addEventListener("resize", function again() {  // a phone that is turned: drawn anew for the new width
    if (Math.abs(box.clientWidth - width) < 20) return;
    removeEventListener("resize", again);
    stop(); grid.remove(); row.remove();
    play(box, slider.value);
  });
}
document.querySelectorAll(".player").forEach(box => play(box));
