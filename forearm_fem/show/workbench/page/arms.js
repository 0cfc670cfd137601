/**
 * The three arms: their motion at an instant, drawn, labelled, turned and clicked.
 *
 * @typedef {import("./experiment.js").Experiment} Experiment
 * @typedef {import("./experiment.js").Method} Method
 * @typedef {import("./field.js").Field} Field
 * @typedef {import("./field.js").Track} Track
 * @typedef {import("./view.js").View} View
 * @typedef {import("./view.js").Box} Box
 * @typedef {{track: Track, limit: number, gain: number, rms: Float32Array | null}} Shown  colours end at `limit` [m], motion drawn
 *   `gain` [mm per m]; with `rms` [m] colours are that, and nothing moves
 * @typedef {{key: string, method: Method, experiment: Experiment, title: string}} Slot  what a panel shows
 */
import { say } from "./dom.js";
import { amplitudesAt, displace, rmsOf } from "./field.js";
import { actuatorBody, deform, outlines } from "./bodies.js";
import { Raster, tableOf } from "./raster.js";
import { all, openEdges, seen } from "./seen.js";
import { eyeOf, matrixOf, project } from "./view.js";
import { METHODS } from "./experiment.js";

const BULGE = 5, FILM = [-0.01225, 0.01775], GLANCES = 60, NEAR = 15, FREE = 14;
const STOPS = {
  light: [0.10, 0.27, 0.58, 0.45, 0.66, 0.87, 0.93, 0.915, 0.885, 0.95, 0.65, 0.42, 0.70, 0.22, 0.10],
  dark: [0.45, 0.72, 0.98, 0.22, 0.42, 0.66, 0.25, 0.255, 0.27, 0.68, 0.36, 0.20, 0.99, 0.62, 0.34],
};

export class Arms {
  /** @param {Field} field @param {any} content @param {{body: HTMLCanvasElement, over: HTMLCanvasElement, panels: HTMLElement[]}} parts */
  constructor(field, content, parts) {
    this.field = field;
    this.parts = parts;
    this.raster = new Raster();
    const ports = [...content.inputs, ...content.outputs], places = ports.map((/** @type {any} */ p) => p.position.map((/** @type {number} */ v) => 1e3 * v));
    const low = [0, 1, 2].map((c) => Math.min(...places.map((p) => p[c]))), high = [0, 1, 2].map((c) => Math.max(...places.map((p) => p[c])));
    this.inputs = content.inputs;
    /** @type {Slot[]} */
    this.slots = METHODS.map((method) => ({ key: method, method, experiment: /** @type {any} */ (null), title: "" }));
    /** Of a device kept beside. @type {import("./device.js").Port[]} */
    this.keptInputs = [];
    this.home = { turn: -1.92, tilt: 1.0, far: 2.95 * Math.max(high[0] - low[0], high[1] - low[1], 30), centre: low.map((v, c) => (v + high[c]) / 2 + (c === 2 ? 7 : 0)) };
    /** @type {View} */
    this.view = { ...this.home };
    this.low = low;
    this.bodies = content.inputs.map(actuatorBody);
    this.theme = "light";
    /** Actuators that do nothing, drawn faintly. @type {boolean[]} */
    this.lifted = [];
    /** Whether points carry the colours, as of a drawn arm nothing else is known. */
    this.live = false;
    /** @type {"" | "along" | "across"} */
    this.section = "";
    /** @type {Map<string, Shown>} */
    this.shown = new Map();
    this.time = 0;
    this.frames = 0;
    /** Pixels per css pixel: of labels, and of what costs time. */
    this.sharp = Math.min(globalThis.devicePixelRatio || 1, 2);
    this.scale = this.sharp;
    this.work = field.surfaces.map((s) => ({
      positions: Float32Array.from(s.rest), normals: Float32Array.from(s.normals), lines: s.tissue ? outlines(s) : null, open: openEdges(s), whole: all(s), seen: all(s),
      states: METHODS.map(() => ({ moved: new Float32Array(s.rest.length), u: new Float32Array(s.rest.length / 3) })),
    }));
    this.tables = { light: tableOf(STOPS.light), dark: tableOf(STOPS.dark) };
    /** Of which view the triangles seen are. */
    this.seenFrom = "";
    /** Where the panels are, and how large all of them. @type {Box[]} */
    this.places = [];
    this.size = { w: 0, h: 0 };
    this.drawnAt = NaN;
    this.amplitudes = METHODS.map(() => new Float64Array(field.k));
    /** @type {WeakMap<Track, number>} */
    this.reaches = new WeakMap();
    /** @type {WeakMap<object, number>} */
    this.most = new WeakMap();
    /** @type {WeakMap<Track, Float32Array>} */
    this.squares = new WeakMap();
  }

  /** Actuators somewhere else. @param {import("./device.js").Port[]} inputs */
  stand(inputs) {
    this.inputs = inputs;
    this.bodies = inputs.map(actuatorBody);
  }

  /** @returns {Box[]} */
  boxes() {
    const outer = this.parts.over.getBoundingClientRect();
    return this.parts.panels.map((p) => { const b = p.getBoundingClientRect(); return { x: b.left - outer.left, y: b.top - outer.top, w: b.width, h: b.height }; });
  }

  /** What moves and at which scales: as pictures and films are drawn. @param {Slot} slot @param {Track} track @param {number} factor
   * @param {number | null} limit a common one @param {boolean} map whether rms is shown @param {number} common the largest displacement of all panels; 0: each by its own */
  show({ key, method, experiment }, track, factor, limit, map, common) {
    const most = limit ?? this.largest(experiment, method), reach = common || this.highest(track);
    const rms = map ? this.squares.get(track) ?? rmsOf(this.field.skin, track) : null;
    if (rms) this.squares.set(track, rms);
    this.shown.set(key, { track, limit: rms ? nice(most / 2) : most, gain: most > 0 && !rms ? nice((factor * BULGE) / Math.max(reach, 1e-30)) : 0, rms });
  }

  /** Largest displacement of the skin [m], at a film's instants: both are drawn alike. @param {Track} track */
  highest(track) {
    const known = this.reaches.get(track);
    if (known !== undefined) return known;
    const { states, whole } = this.work[0];
    const end = track.first + track.count / track.rate, from = Math.max(track.first, FILM[0]), to = Math.min(end, FILM[1]);
    const [low, high] = from < to ? [from, to] : [track.first, end];
    let most = 0;
    for (let k = 0; k < GLANCES; k += 3) {
      const rows = states.map((_, i) => amplitudesAt(track, low + ((k + i + 0.5) / GLANCES) * (high - low), new Float64Array(track.k)));
      displace(this.field.skin, rows, states, whole.vertices, states.map(() => track.net));
      for (const { moved } of states) for (let v = 0; v < moved.length; v += 3) most = Math.max(most, Math.hypot(moved[v], moved[v + 1], moved[v + 2]));
    }
    this.reaches.set(track, most);
    return most;
  }

  /** Largest displacement of the points while it is shown [m]. @param {Experiment} experiment @param {Method} method */
  largest(experiment, method) {
    const outcome = experiment.outcome(method), known = this.most.get(outcome) ?? outcome.moves.reduce((a, u) => u.reduce((b, v) => Math.max(b, Math.abs(v) || 0), a), 0);
    this.most.set(outcome, known);
    return known;
  }

  /** Everything anew: after a change of view, size, colours or settings. @param {Experiment | null} experiment */
  draw(experiment) {
    const { over } = this.parts, g = /** @type {CanvasRenderingContext2D} */ (over.getContext("2d"));
    this.places = this.boxes();
    this.size = { w: over.clientWidth, h: over.clientHeight };
    const w = Math.round(this.size.w * this.sharp), h = Math.round(this.size.h * this.sharp);
    if (over.width !== w || over.height !== h) { over.width = w; over.height = h; }
    g.setTransform(this.sharp, 0, 0, this.sharp, 0, 0);
    g.clearRect(0, 0, w, h);
    this.move();
    this.places.forEach((box, i) => {
      const slot = this.slots[i];
      if (slot && box.w >= 2 && box.h >= 2) this.label(g, this.matrix(box), box, slot);
    });
  }

  /** Another instant: of the bodies, or of the points where no more is known. @param {Experiment} experiment */
  turn(experiment) {
    if (this.live) this.draw(experiment);
    else this.move();
  }

  /** The bodies alone, at another instant. */
  move() {
    const { places, raster, field, scale, work } = this, { body } = this.parts, w = Math.round(this.size.w * scale), h = Math.round(this.size.h * scale);
    this.frames++;
    this.drawnAt = this.time;
    if (w < 2 || h < 2) return;
    if (body.width !== w || body.height !== h) { body.width = w; body.height = h; }
    raster.begin(w, h);
    const shown = METHODS.map((_, i) => this.shown.get(this.slots[i]?.key));
    this.amplitudes = this.amplitudes.map((row, i) => { const k = shown[i]?.track.k ?? this.field.k; return row.length === k ? row : new Float64Array(k); });
    shown.forEach((s, i) => { if (s && !s.rms) amplitudesAt(s.track, this.time, this.amplitudes[i]); else this.amplitudes[i].fill(0); });
    const open = places.find((b) => b.w >= 2 && b.h >= 2);
    if (!open) return;
    this.look(matrixOf(this.view, open.w, open.h));
    for (const s of this.drawn) displace(field.surfaces[s], this.amplitudes, work[s].states, work[s].seen.vertices, shown.map((p) => p?.track.net));
    shown.forEach((p, i) => { if (p?.rms) work[0].states[i].u.set(p.rms); });
    this.slots.forEach((_, i) => { if (places[i].w >= 2 && places[i].h >= 2) this.drawBody(i, places[i]); });
    /** @type {CanvasRenderingContext2D} */ (body.getContext("2d", { willReadFrequently: true })).putImageData(raster.image(), 0, 0);
  }

  /** From mm to a panel. @param {Box} box @returns {Float32Array} */
  matrix(box) {
    return matrixOf(this.view, box.w, box.h);
  }

  /** Names the view: changes when it does. */
  get lookedAt() {
    const { turn, tilt, far } = this.view;
    return `${turn} ${tilt} ${far}`;
  }

  /** Numbers of the surfaces that are drawn: the skin, and the section if there is one. @returns {number[]} */
  get drawn() {
    return [0, this.field.surfaces.findIndex((s) => s.name === this.section)].filter((s, i) => i === 0 || s > 0);
  }

  /** What the view shows of each surface, found again when the view changes; panels are alike. @param {Float32Array} matrix */
  look(matrix) {
    const key = `${matrix.join()} ${this.section}`, { view } = this, eye = eyeOf(view).map((e, c) => view.centre[c] + view.far * e);
    if (key === this.seenFrom) return;
    this.seenFrom = key;
    this.field.surfaces.forEach((surface, s) => { this.work[s].seen = seen(surface, this.work[s].open, matrix, eye, s > 0 || this.section !== ""); });
  }

  /** @param {number} number of the panel @param {Box} box */
  drawBody(number, box) {
    const { field, view, raster, drawn } = this, slot = this.slots[number], shown = this.shown.get(slot.key), dark = this.theme === "dark";
    const camera = { matrix: matrixOf(view, box.w, box.h), eye: eyeOf(view), panel: raster.panel(box, this.scale) };
    const side = this.section === "along" ? [0, -1, 0] : [-1, 0, 0], at = drawn.length > 1 ? field.surfaces[drawn[1]].rest : null;
    for (const s of drawn) {
      const { positions, normals, states, seen: part, lines } = this.work[s], { moved, u } = states[number];
      deform(field.surfaces[s], part, moved, shown?.gain ?? 0, positions, normals);
      const cut = s === 0 && at ? [...side, side[0] * at[0] + side[1] * at[1]] : null;
      raster.surface(part, positions, normals, u, camera, { limit: shown?.limit || 1, table: this.tables[dark ? "dark" : "light"], cut, flat: s > 0 });
      if (lines) raster.lines(lines, positions, dark ? [0.9, 0.9, 0.9, 0.8] : [0.15, 0.15, 0.18, 0.75], camera);
    }
    const tone = dark ? [0.72, 0.76, 0.82, 0.26] : [0.30, 0.34, 0.40, 0.26];
    const kept = slot.key.startsWith("kept"), bodies = kept ? this.keptInputs.map(actuatorBody) : this.bodies;
    bodies.forEach((/** @type {any} */ b, /** @type {number} */ k) => raster.glass(b.triangles, b.normals, !kept && this.lifted[k] ? [...tone.slice(0, 3), 0.08] : tone, camera));
  }

  /** Points, target, zeros, cones and a scale bar over one panel. @param {CanvasRenderingContext2D} g @param {Float32Array} matrix @param {Box} box
   * @param {Slot} slot */
  label(g, matrix, box, { experiment, method, key }) {
    const dark = this.theme === "dark", ink = dark ? "#f2f0ec" : "#1f2226", soft = dark ? "#a9afb8" : "#5a6068", warm = dark ? "#ffb066" : "#a04a00";
    g.save();
    g.beginPath(); g.rect(box.x, box.y, box.w, box.h); g.clip();
    g.textAlign = "center"; g.textBaseline = "middle";
    const outputs = experiment?.outputs ?? [], few = outputs.length <= 36;
    const outcome = experiment?.outcome(method), held = outcome?.aim?.zeros ?? [];
    outputs.forEach((p, i) => {
      const [x, y] = project(matrix, p.position.map((v, c) => 1e3 * v + 0.6 * p.axis[c]), box), aimed = i === experiment?.settings.target;
      g.lineWidth = 1.4;
      if (this.live && outcome?.moves.length) this.spot(g, x, y, outcome.moves[i], experiment, method);
      g.strokeStyle = g.fillStyle = aimed ? ink : held.includes(i) ? warm : soft;
      g.beginPath();
      if (aimed) { g.arc(x, y, 6.5, 0, 7); g.stroke(); g.beginPath(); g.arc(x, y, 2, 0, 7); g.fill(); }
      else if (held.includes(i)) { g.moveTo(x - 3.5, y - 3.5); g.lineTo(x + 3.5, y + 3.5); g.moveTo(x + 3.5, y - 3.5); g.lineTo(x - 3.5, y + 3.5); g.stroke(); }
      else { g.arc(x, y, 1.6, 0, 7); g.fill(); }
      if (few || aimed) { g.font = aimed ? "600 12px system-ui, sans-serif" : "10.5px system-ui, sans-serif"; g.fillText(p.name, x + (aimed ? 12 : 8), y - (aimed ? 9 : 7)); }
    });
    g.fillStyle = soft; g.font = "600 11px system-ui, sans-serif";
    const inputs = key.startsWith("kept") ? this.keptInputs : this.inputs;
    inputs.forEach((/** @type {any} */ p, /** @type {number} */ k) => { const [x, y] = project(matrix, actuatorBody(p).top, box); g.fillText(p.name, x, y - 8); });
    this.bar(g, matrix, box, soft);
    g.restore();
  }

  /** A point's displacement as a coloured spot. @param {CanvasRenderingContext2D} g @param {number} x @param {number} y @param {Float64Array} u
   * @param {any} experiment @param {Method} method */
  spot(g, x, y, u, experiment, method) {
    const { record } = experiment, j = Math.round(this.time * record.rate) + Math.floor(record.n / 2), limit = this.largest(experiment, method);
    const level = Math.round(127.5 * (1 + Math.min(Math.max((u[j] || 0) / (limit || 1), -1), 1))), c = this.tables[this.theme === "dark" ? "dark" : "light"][256 * 53 + level];
    g.fillStyle = `rgb(${c & 255},${(c >> 8) & 255},${(c >> 16) & 255})`;
    g.beginPath(); g.arc(x, y, 11, 0, 7); g.fill();
  }

  /** 10 mm in the plane of the picture at the middle of the grid, drawn in the panel's lower right corner.
   * @param {CanvasRenderingContext2D} g @param {Float32Array} matrix @param {Box} box @param {string} ink */
  bar(g, matrix, box, ink) {
    const { centre, turn } = this.view, a = project(matrix, centre, box), b = project(matrix, [centre[0] - 10 * Math.sin(turn), centre[1] + 10 * Math.cos(turn), centre[2]], box);
    const length = Math.hypot(b[0] - a[0], b[1] - a[1]), x = box.x + box.w - 14, y = box.y + box.h - (box.w < 300 ? 50 : 30);
    g.strokeStyle = g.fillStyle = ink; g.lineWidth = 2;
    g.beginPath(); g.moveTo(x, y); g.lineTo(x - length, y); g.stroke();
    g.font = "10.5px system-ui, sans-serif"; g.fillText("10 mm", x - length / 2, y - 8);
  }

  /** The point or vertex under a place of the canvas [css px]. @param {number} x @param {number} y @param {Experiment} experiment
   * @returns {{row: number} | {vertex: number} | null} */
  pick(x, y, experiment) {
    const box = this.boxes().find((b) => x >= b.x && x < b.x + b.w && y >= b.y && y < b.y + b.h);
    if (!box) return null;
    const matrix = this.matrix(box);
    let best = -1, gap = NEAR;
    experiment.outputs.forEach((p, i) => { const q = project(matrix, p.position.map((v) => 1e3 * v), box), d = Math.hypot(q[0] - x, q[1] - y); if (d < gap) { gap = d; best = i; } });
    if (best >= 0) return { row: best };
    const { rest } = this.field.skin, near = [];
    for (let v = 0; v < rest.length / 3; v++) { const q = project(matrix, rest.subarray(3 * v, 3 * v + 3), box), d = Math.hypot(q[0] - x, q[1] - y); if (d < FREE) near.push({ v, d, depth: q[2] }); }
    if (!near.length) return null;
    const front = Math.min(...near.map((c) => c.depth));
    return { vertex: near.filter((c) => c.depth < front + 8).sort((p, q) => p.d - q.d)[0].v };
  }

  /** What the panel's scales are. @param {Method} method @param {Experiment} experiment @param {string} [key] @returns {string} */
  words(method, experiment, key = method) {
    if (this.live) return `points only · colours to ±${say(1e6 * this.largest(experiment, method), 2)} µm`;
    const shown = this.shown.get(key);
    if (!shown || !shown.limit) return "";
    if (shown.rms) return `rms of the skin over the passage · colours to ${say(1e6 * shown.limit, 2)} µm`;
    return `colours to ±${say(1e6 * shown.limit, 2)} µm · motion drawn ${say(shown.gain / 1e3, 3)}×`;
  }
}

/** The largest of 1, 2, 5 times a power of ten up to `value`. @param {number} value */
function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * (value / power >= 5 ? 5 : value / power >= 2 ? 2 : 1);
}

/** The colour scale as css. @param {string} theme */
export function stopsOf(theme) {
  const s = STOPS[theme === "dark" ? "dark" : "light"];
  return [0, 1, 2, 3, 4].map((k) => `rgb(${s.slice(3 * k, 3 * k + 3).map((v) => Math.round(255 * v)).join(",")})`);
}
