"use strict";
// Asks this page's own server for the numbers, four times a second, and draws them. Text goes in as
// text, never as markup.

const EVERY_MS = 250;
const SVG = "http://www.w3.org/2000/svg";
const LBM_KG = 0.45359237;
const EVENTS_SHOWN = 40;
// More toFixed does not take.
const MOST_DIGITS = 100;

function make(name, attributes, text) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  return node;
}

// Steps of 1, 2 or 5 times a power of ten, about so many of them.
function ticks(low, high, wanted) {
  const rough = (high - low) / wanted;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((f) => f * power).find((s) => s >= rough);
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, i) => {
    return { at: (first + i) * step, text: ((first + i) * step).toFixed(Math.min(MOST_DIGITS, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))) };
  });
}

function range(values, margin) {
  let low = Math.min(...values), high = Math.max(...values);
  if (!(high > low)) { low -= 0.5; high += 0.5; }
  const more = margin * (high - low);
  return [low - more, high + more];
}

class Picture {
  constructor(id, left, bottom) {
    this.svg = document.getElementById(id);
    const box = this.svg.viewBox.baseVal;
    this.frame = { left, top: 10, right: box.width - 12, bottom: box.height - bottom };
    this.words = this.svg.querySelector("title");
  }

  begin(xRange, yRange, xTicks, yTicks) {
    const f = this.frame;
    this.x = (v) => f.left + (f.right - f.left) * (v - xRange[0]) / (xRange[1] - xRange[0]);
    this.y = (v) => f.bottom - (f.bottom - f.top) * (v - yRange[0]) / (yRange[1] - yRange[0]);
    this.nodes = [this.words];
    for (const tick of ticks(...xRange, xTicks)) {
      const x = this.x(tick.at);
      this.add("line", { x1: x, x2: x, y1: f.top, y2: f.bottom, class: tick.at === 0 ? "zero" : "grid" });
      this.add("text", { x, y: f.bottom + 15, "text-anchor": "middle" }, tick.text);
    }
    for (const tick of ticks(...yRange, yTicks)) {
      const y = this.y(tick.at);
      this.add("line", { x1: f.left, x2: f.right, y1: y, y2: y, class: tick.at === 0 ? "zero" : "grid" });
      this.add("text", { x: f.left - 6, y: y + 4, "text-anchor": "end" }, tick.text);
    }
  }

  add(name, attributes, text) { this.nodes.push(make(name, attributes, text)); }

  path(points) {
    return points.map((p, i) => `${i ? "L" : "M"}${this.x(p[0]).toFixed(1)} ${this.y(p[1]).toFixed(1)}`).join("");
  }

  line(points, kind) { if (points.length > 1) this.add("path", { d: this.path(points), class: kind }); }

  end(words) {
    this.words.textContent = words;
    this.svg.replaceChildren(...this.nodes);
  }
}

const map = new Picture("map", 46, 38);
const flow = new Picture("flow", 46, 24);
const ratio = new Picture("ratio", 46, 24);

function drawMap(state) {
  const known = state.trail.filter((row) => row[1] !== null && row[2] !== null).map((row) => [row[1], row[2]]);
  if (known.length < 2) return;
  const curve = state.curve.filter((row) => row.every((v) => v !== null));
  const all = [...known, ...curve];
  map.begin(range(all.map((p) => p[0]), 0.06), range(all.map((p) => p[1]), 0.08), 7, 6);
  if (curve.length) {
    const upper = curve.map((p) => [p[0], p[1] + 2 * p[2]]);
    const lower = curve.map((p) => [p[0], p[1] - 2 * p[2]]).reverse();
    map.add("path", { d: map.path([...upper, ...lower]) + "Z", class: "band" });
  }
  const recent = Math.floor(known.length * 0.8);
  map.line(known.slice(0, recent + 1), "trail old");
  map.line(known.slice(recent), "trail");
  map.line(curve, "fit");
  const last = known[known.length - 1];
  map.add("circle", { cx: map.x(last[0]), cy: map.y(last[1]), r: 7, class: "now" });
  const f = map.frame;
  map.add("text", { x: f.right, y: f.bottom + 31, "text-anchor": "end" }, "flow coefficient φ");
  map.add("text", { x: f.left + 6, y: f.top + 14 }, "ψ'");
  const tau = state.tau_ms ? `; fitted time constant ${state.tau_ms[0].toFixed(1)} ms` : "";
  map.end(`Operating point at φ ${last[0].toFixed(3)}, ψ' ${last[1].toFixed(2)}${tau}.`);
}

function drawTrace(picture, state, column, factor, name, unit) {
  const points = state.trail.filter((row) => row[column] !== null).map((row) => [row[0], row[column] * factor]);
  if (points.length < 2) return;
  const values = points.map((p) => p[1]);
  picture.begin([points[0][0], points[points.length - 1][0]], range(values, 0.08), 7, 3);
  picture.line(points, "trace");
  picture.end(`${name} over the last ${(points[points.length - 1][0] - points[0][0]).toFixed(1)} seconds: `
    + `now ${values[values.length - 1].toFixed(2)}${unit}, between ${Math.min(...values).toFixed(2)} and ${Math.max(...values).toFixed(2)}.`);
}

function lampOf(machine) {
  if (machine.startsWith("surge")) return "surge";
  if (machine === "in stall") return "stall";
  return machine === "stable" ? "stable" : "unknown";
}

function setText(node, text) { if (node.textContent !== text) node.textContent = text; }

function drawWords(state) {
  setText(document.getElementById("test"), state.test);
  document.getElementById("lamp").dataset.state = lampOf(state.machine);
  // Which half of a cycle it is changes too fast to be read out.
  setText(document.getElementById("machine"), state.machine.startsWith("surge") ? "surge" : state.machine);
  const fields = document.getElementById("fields");
  state.fields.forEach((field, i) => {
    if (fields.children.length < 2 * i + 2) fields.append(document.createElement("dt"), document.createElement("dd"));
    setText(fields.children[2 * i], field.label);
    setText(fields.children[2 * i + 1], field.value);
  });
  const events = state.events.slice(-EVENTS_SHOWN).reverse();
  const list = document.getElementById("events");
  const mark = events.map((e) => e.clock + e.text).join("\n");
  if (list.dataset.mark === mark) return;
  list.dataset.mark = mark;
  list.replaceChildren(...events.map((event) => {
    const item = document.createElement("li"), clock = document.createElement("time");
    clock.textContent = event.clock;
    item.append(clock, event.text);
    return item;
  }));
}

function notice(text) {
  const node = document.getElementById("notice");
  node.hidden = !text;
  setText(node, text);
}

let ended = false;

async function update() {
  try {
    const answer = await fetch("/state.json", { cache: "no-store" });
    if (!answer.ok) throw new Error(String(answer.status));
    const state = await answer.json();
    if (state.schema) {
      drawWords(state);
      drawMap(state);
      drawTrace(flow, state, 3, 1 / LBM_KG, "Corrected inlet flow", " lbm/s");
      drawTrace(ratio, state, 4, 1, "Pressure ratio", "");
      ended = state.phase === "done" || state.phase === "reducing";
      notice(state.feed_silent && !ended ? "No data are coming in; what is shown is the last that came." : "");
    }
  } catch {
    notice(ended ? "The session has ended; what is shown is its last moment." : "The session does not answer; what is shown is its last moment.");
  }
  setTimeout(update, EVERY_MS);
}

update();
