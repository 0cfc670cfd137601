/**
 * Everything that can be changed, and the keys.
 *
 * @typedef {import("./app.js").App} App
 * @typedef {import("./device.js").Device} Device
 */
import { $, h, say, sayUnit } from "./dom.js";
import { Anywhere } from "./anywhere.js";
import { fitted, METHODS } from "./experiment.js";
import { exportsPanel } from "./exports.js";
import { checkSize, FileProblem, fitting, inOneLine, readSamplesCsv, readTransfer, readWav } from "./files.js";

const SPEEDS = /** @type {[string, number][]} */ ([["real time", 1], ["10 times slower", 1 / 10], ["40 times slower", 1 / 40], ["200 times slower", 1 / 200]]);
const OFF = 10; // [mm] from the skin's vertices: elements are smaller
const STIFFNESS = /** @type {[string, number][]} */ ([["full contact", Infinity], ["partial: 5 N/mm", 5000], ["partial: 1 N/mm", 1000], ["partial: 0.2 N/mm", 200], ["lifted off", 0]]);
const KEYS = /** @type {[string, string][]} */ ([["space", "play, pause"], ["← →", "a step in time"], ["1 … 9", "aim at this point"], ["shift 1 … 9", "make it a zero point, or not"], ["[ ]", "slower, faster"], ["m", "next method"], ["a A", "next, last drawn arm"], ["+ −", "nearer, farther"], ["shift arrows", "turn the arms"], ["r", "view as at first"], ["s", "section: none, along, across"], ["t", "light, dark"], ["?", "this list"]]);

/** @param {App} app @param {number} row */
export function aimAt(app, row) {
  const place = row < app.experiment.points.length ? null : app.experiment.settings.place;
  app.set({ target: row, place });
}

/** Aim at a vertex of the skin. @param {App} app @param {number} vertex */
function aimBetween(app, vertex) {
  const { experiment } = app, { rest, normals } = app.field.skin, at = (/** @type {Float32Array} */ a) => Array.from(a.subarray(3 * vertex, 3 * vertex + 3));
  const place = { vertex, position: at(rest).map((v) => v / 1e3), normal: at(normals) };
  app.set({ place, target: experiment.points.length, zeros: Array.isArray(experiment.settings.zeros) ? experiment.settings.zeros : "auto" });
  if (experiment.settings.place === place) app.say(`aiming at ${place.position.map((v) => say(1e3 * v)).join(", ")} mm, a place P between the points; S there is over the mean of the points`);
}

/** Where the target is, as numbers that can be changed: any place of the skin, without a pointer. @param {App} app */
function placeFields(app) {
  const { experiment, field: { skin } } = app, now = (/** @type {number} */ c) => 1e3 * experiment.outputs[experiment.settings.target].position[c];
  const move = (/** @type {number} */ x, /** @type {number} */ y) => {
    const { vertex, away } = app.field.below(x, y);
    if (away > OFF) app.say(`no skin was kept at ${say(x)}, ${say(y)} mm; the nearest is ${say(away)} mm away`, true);
    else aimBetween(app, vertex);
  };
  const side = (/** @type {number} */ c) => { let low = Infinity, high = -Infinity; for (let v = c; v < skin.rest.length; v += 3) { low = Math.min(low, skin.rest[v]); high = Math.max(high, skin.rest[v]); } return /** @type {[number, number]} */ ([low, high]); };
  return h("div", { class: "row" }, field(app, "placex", "at x", "mm", side(0), () => now(0), (x) => move(x, now(1))), field(app, "placey", "y", "mm", side(1), () => now(1), (y) => move(now(0), y)));
}

/** Make a point a zero point, or none. @param {App} app @param {number} row */
function toggleZero(app, row) {
  const { experiment } = app, now = experiment.zerosOf(app.focus === "funneling" ? "inverse filter" : app.focus, experiment.settings.target);
  if (row === experiment.settings.target) return app.say(`${experiment.outputs[row].name} is the target; choose another point as zero`, true);
  app.set({ zeros: now.includes(row) ? now.filter((i) => i !== row) : [...now, row].sort((a, b) => a - b) });
}

/** @param {App} app */
export function transport(app) {
  const play = h("button", { type: "button", id: "play", title: "space", onclick: () => { app.playing = !app.playing; said(); } });
  const scrub = h("input", { type: "range", id: "scrub", min: 0, max: 1000, step: 1, "aria-label": "instant", oninput: () => { app.playing = false; app.arms.time = app.span[0] + (scrub.value / 1000) * (app.span[1] - app.span[0]); said(); } });
  const speed = h("select", { id: "speed", "aria-label": "speed", onchange: () => { app.speed = SPEEDS[speed.selectedIndex][1]; } }, ...SPEEDS.map(([text]) => h("option", { text })));
  speed.selectedIndex = 2;
  const factor = h("input", { type: "range", id: "factor", min: -1.5, max: 1.5, step: 0.05, value: 0, style: "width:90px", "aria-label": "magnification of the motion drawn", oninput: () => { app.factor = Number(factor.value) <= -1.5 ? 1e-9 : 10 ** Number(factor.value); app.rescale(); } });
  const same = h("input", { type: "checkbox", id: "same", onchange: () => { app.same = same.checked; app.rescale(); } });
  const section = h("select", { id: "section", "aria-label": "section", onchange: () => { app.arms.section = section.value; app.rescale(); } },
    h("option", { value: "", text: "whole skin" }), ...app.field.surfaces.slice(1).map((s) => h("option", { value: s.name, text: `cut ${s.name}` })));
  section.disabled = app.field.surfaces.length < 2;
  section.title = section.disabled ? "this run kept no motion inside the limb" : "cut the limb open";
  const map = h("select", { id: "map", "aria-label": "colours", onchange: () => { app.map = map.value === "rms"; app.rescale(); } }, h("option", { value: "", text: "motion now" }), h("option", { value: "rms", text: "map of rms" }));
  const said = () => { play.textContent = app.playing ? "pause" : "play"; play.setAttribute("aria-pressed", String(app.playing)); };
  said();
  $("transport").replaceChildren(play, h("span", { class: "grow" }, scrub), h("span", { id: "now" }), speed, map, section, h("label", {}, "motion", factor), h("label", {}, same, "one scale for all"));
  return { said, speed, section, scrub };
}

/** @param {App} app */
export function controls(app) {
  const parts = [targetPart(app), placesPart(app), stimulusPart(app), filterPart(app), devicePart(app), ...armsPart(app), measuredPart(app), exportsPanel(app)];
  $("controls").replaceChildren(...parts);
  app.listeners.push(() => pad(app));
  pad(app);
}

/** @param {string} title @param {boolean} open @param {...(Node | null)} children */
function part(title, open, ...children) {
  return h("details", { open }, h("summary", { text: title }), ...children);
}

/** @param {App} app */
function targetPart(app) {
  const zeros = h("select", { id: "zeros", "aria-label": "zero points", class: "grow", onchange: () => { if (zeros.value !== "own") app.set({ zeros: zeros.value }); } },
    ...[["run", "as in the run"], ["auto", "automatic"], ["thesis", "corners (thesis)"], ["others", "all other points"], ["own", "own choice"]].map(([value, text]) => h("option", { value, text })));
  app.listeners.push(() => { const z = app.experiment.settings.zeros; zeros.value = Array.isArray(z) ? "own" : z; });
  return part("Target and zero points", true,
    h("svg", { id: "pad", role: "group", "aria-label": "points: Enter aims, Z makes a zero point" }),
    h("p", { class: "soft", style: "margin:2px 0 6px;font-size:12px", text: app.field.everywhere ? `Click a point here or on an arm, or any other place of the skin. Shift-click: zero point.${app.experiment.places ? " Drag an actuator, or move it with the arrow keys." : ""}` : "Click a point here or on an arm. Shift-click: zero point. Between the points nothing is known to aim at." }),
    h("details", { class: "more" }, h("summary", { text: "any place, zero points" }), app.field.everywhere ? placeFields(app) : null,
      h("div", { class: "row" }, h("label", { class: "grow" }, "zeros", zeros))));
}

/** Actuators moved, added and removed, and two devices beside each other. @param {App} app */
function placesPart(app) {
  const { experiment } = app, { places } = experiment, flat = places instanceof Anywhere, now = () => /** @type {number[][]} */ (experiment.settings.contacts);
  const keep = h("button", { type: "button", id: "keep", onclick: () => app.keep(!app.kept) });
  const beside = h("input", { type: "checkbox", id: "beside", onchange: () => { app.beside = beside.checked; app.refresh(); } }), wrap = h("label", {}, beside, "side by side");
  const name = h("select", { id: "which", "aria-label": "actuator to remove" });
  app.listeners.push(() => {
    keep.textContent = app.kept ? "forget the kept device" : "keep this device to compare";
    wrap.hidden = !app.kept; beside.checked = app.beside;
    if (name.options.length !== experiment.inputs.length) name.replaceChildren(...experiment.inputs.map((p) => h("option", { text: p.name })));
  });
  const without = (/** @type {number} */ k) => {
    const d = experiment.settings.device, rest = (/** @type {any[]} */ list) => list.filter((_, i) => i !== k);
    if (now().length < 2) return app.say("one actuator must stay", true);
    app.set({ contacts: rest(now()), device: { ...d, touching: rest(d.touching), gain: rest(d.gain), spring: rest(d.spring) } });
  };
  return part("Actuators", true,
    places ? h("div", { class: "row" }, field(app, "pitch", "pitch", "mm", [1, 200], () => 1e3 * experiment.pitch, (v) => app.set({ contacts: experiment.spread(v / 1e3) })), h("small", { text: "nearest two" })) : h("p", { class: "soft", style: "margin:0 0 6px;font-size:12px", text: experiment.kind === "transfer" ? "A measured G: its actuators stand where they stood." : "They can be moved on the page of a layered run or of a library." }),
    flat ? h("div", { class: "row" }, h("button", { type: "button", id: "more", text: "add one", onclick: () => app.set({ contacts: experiment.withOneMore() }) }), h("button", { type: "button", id: "fewer", text: "remove", onclick: () => without(name.selectedIndex) }), name) : null,
    places ? h("div", { class: "row" }, h("button", { type: "button", id: "home", text: "places as in the run", onclick: () => { const o = experiment.original(); app.set({ contacts: o.contacts, device: fitted(experiment.settings.device, o.contacts?.length ?? experiment.inputs.length) }); } })) : null,
    experiment.changeable ? h("div", { class: "row" }, keep, wrap) : null);
}

/** The points seen from above. @param {App} app */
function pad(app) {
  const { experiment } = app, { outputs, inputs, settings } = experiment, svg = $("pad"), { places } = experiment, all = [...outputs, ...inputs, ...(places instanceof Anywhere ? [-1, 1].map((s) => ({ position: places.middle.map((m, c) => m + s * places.half[c]) })) : places ? Array.from({ length: places.n }, (_, i) => ({ position: Array.from(places.position.subarray(3 * i, 3 * i + 3)) })) : [])];
  const x = all.map((p) => 1e3 * p.position[0]), y = all.map((p) => -1e3 * p.position[1]), room = 7;
  const box = [Math.min(...x) - room, Math.min(...y) - room, Math.max(...x) - Math.min(...x) + 2 * room, Math.max(...y) - Math.min(...y) + 2 * room];
  const held = experiment.zerosOf(app.focus === "funneling" ? "inverse filter" : app.focus, settings.target), focused = document.activeElement, active = ["data-row", "data-actuator"].map((n) => [n, focused?.getAttribute(n)]).find(([, v]) => v);
  svg.setAttribute("viewBox", box.join(" "));
  const small = Math.min(4.2, 0.32 * nearest(outputs));
  svg.replaceChildren(
    ...patch(app),
    ...(app.kept ? app.kept.inputs.map((p) => h("circle", { class: "cone ghost", cx: 1e3 * p.position[0], cy: -1e3 * p.position[1], r: Math.max(1e3 * p.radius, 1.5) })) : []),
    ...inputs.map((p, k) => h("g", experiment.places ? mover(app, k) : {}, h("circle", { class: "cone", cx: 1e3 * p.position[0], cy: -1e3 * p.position[1], r: Math.max(1e3 * p.radius, 1.5) }), h("text", { x: 1e3 * p.position[0], y: -1e3 * p.position[1] + 0.36 * Math.min(3, 0.8 * Math.max(1e3 * p.radius, 1.5)), text: p.name, style: `font-size:${Math.min(3, 0.8 * Math.max(1e3 * p.radius, 1.5))}px;fill:var(--soft)` }))),
    ...outputs.map((p, row) => {
      const cx = 1e3 * p.position[0], cy = -1e3 * p.position[1], aimed = row === settings.target, zero = held.includes(row);
      return h("g", { class: `${aimed ? "aimed" : ""} ${zero ? "held" : ""}`, role: "button", tabindex: 0, "data-row": row, "aria-label": `point ${p.name}${aimed ? ", target" : zero ? ", zero point" : ""}`,
        onclick: (/** @type {MouseEvent} */ e) => (e.shiftKey ? toggleZero(app, row) : aimAt(app, row)),
        onkeydown: (/** @type {KeyboardEvent} */ e) => { if (e.key === "Enter") { e.preventDefault(); aimAt(app, row); } else if (e.key.toLowerCase() === "z") toggleZero(app, row); } },
        h("circle", { class: "dot", cx, cy, r: small }), h("text", { x: cx, y: cy + small * 0.34, style: `font-size:${small * 0.95}px`, text: p.name }),
        zero ? h("path", { class: "cross", d: `M${cx + small * 0.55} ${cy - small * 1.15}l${small * 0.6} ${small * 0.6}m0 ${-small * 0.6}l${-small * 0.6} ${small * 0.6}`, fill: "none" }) : null);
    }));
  svg.querySelectorAll(".dot, .cone, .cross, .patch").forEach((/** @type {Element} */ c) => c.setAttribute("vector-effect", "non-scaling-stroke"));
  if (active) svg.querySelector(`[${active[0]}="${active[1]}"]`)?.focus();
}

/** Outline of a library's patch, seen from above; nothing without one. @param {App} app @returns {Element[]} */
function patch(app) {
  const { places } = app.experiment;
  if (!places) return [];
  if (places instanceof Anywhere) { const [[x, y], [a, b]] = [places.middle, places.half].map((p) => p.map((v) => 1e3 * v)); return [h("rect", { class: "patch", x: x - a, y: -y - b, width: 2 * a, height: 2 * b, rx: 1 })]; }
  const at = Array.from({ length: places.n }, (_, i) => [1e3 * places.xy[2 * i], -1e3 * places.xy[2 * i + 1]]), r = 1e3 * places.radius;
  const [x, y] = [0, 1].map((c) => at.map((p) => p[c])), low = [Math.min(...x) - r, Math.min(...y) - r];
  return [h("rect", { class: "patch", x: low[0], y: low[1], width: Math.max(...x) + r - low[0], height: Math.max(...y) + r - low[1], rx: 1 })];
}

/** What lets an actuator be dragged, or moved by the arrow keys. @param {App} app @param {number} k @returns {Record<string, any>} */
function mover(app, k) {
  const { experiment } = app, now = () => /** @type {number[][]} */ (experiment.settings.contacts), name = experiment.inputs[k].name;
  const move = (/** @type {number} */ x, /** @type {number} */ y) => {
    const rounded = [x, y].map((v) => Number(v.toFixed(6))); // [m]
    app.set({ contacts: now().map((old, i) => (i === k ? rounded : old)) });
  };
  const place = (/** @type {PointerEvent} */ e) => { const m = $("pad").getScreenCTM().inverse(); return [m.a * e.clientX + m.e, m.d * e.clientY + m.f]; };
  return {
    class: "mover", role: "button", tabindex: 0, "data-actuator": k, "aria-label": `actuator ${name} at ${now()[k].map((v) => say(1e3 * v)).join(", ")} mm; arrow keys move it by 1 mm, with shift by 5 mm`,
    onkeydown: (/** @type {KeyboardEvent} */ e) => {
      const step = /** @type {Record<string, number[]>} */ ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] })[e.key];
      if (!step) return;
      e.preventDefault(); e.stopPropagation();
      const [x, y] = now()[k], d = e.shiftKey ? 5e-3 : 1e-3;
      move(x + d * step[0], y + d * step[1]);
    },
    onpointerdown: (/** @type {PointerEvent} */ e) => {
      const g = /** @type {SVGGElement} */ (e.currentTarget), [x, y] = now()[k], from = place(e);
      let to = from;
      g.setPointerCapture(e.pointerId);
      g.onpointermove = (next) => { to = place(next); g.setAttribute("transform", `translate(${to[0] - from[0]} ${to[1] - from[1]})`); };
      const end = () => { g.onpointermove = g.onpointerup = g.onpointercancel = null; g.removeAttribute("transform"); };
      g.onpointercancel = end;
      g.onpointerup = () => { end(); if (to !== from) move(x + (to[0] - from[0]) / 1e3, y - (to[1] - from[1]) / 1e3); };
    },
  };
}

/** @param {{position: number[]}[]} ports [mm] */
function nearest(ports) {
  let least = 13;
  ports.forEach((p, i) => ports.slice(0, i).forEach((q) => { least = Math.min(least, 1e3 * Math.hypot(p.position[0] - q.position[0], p.position[1] - q.position[1])); }));
  return Math.max(least, 1.5);
}

/** A number with its unit; what is out of range is said and put back. @param {App} app @param {string} id @param {string} text @param {string} unit
 * @param {[number, number]} range @param {() => number} get @param {(value: number) => void} put */
function field(app, id, text, unit, range, get, put) {
  const input = h("input", { type: "number", id, step: "any", value: Number(get().toPrecision(5)), onchange: () => {
    const v = Number(input.value);
    if (input.value.trim() === "" || !(v >= range[0] && v <= range[1])) app.say(`${text}: expected ${say(range[0])} to ${say(range[1])} ${unit}, got ${input.value.slice(0, 12) || "nothing"}`, true);
    else put(v);
    input.value = String(Number(get().toPrecision(5)));
  } });
  app.listeners.push(() => { if (document.activeElement !== input) input.value = String(Number(get().toPrecision(5))); });
  return h("label", {}, text, input, h("small", { text: unit }));
}

/** @param {App} app */
function stimulusPart(app) {
  const { experiment } = app, { record } = experiment;
  let peak = experiment.content.rendering.wavelet.peak, tone = Math.min(150, record.rate / 8), cycles = 5;
  const tell = (/** @type {any} */ asked) => { try { experiment.stimulate(asked); app.refresh(); } catch (problem) { app.say(String(/** @type {Error} */ (problem).message), true); } };
  const name = h("small", { id: "stimulus" });
  app.listeners.push(() => { name.textContent = experiment.settings.wavelet.name; });
  const own = h("input", { type: "file", id: "own", accept: ".wav,.csv,.txt", onchange: () => { take(app, own.files); own.value = ""; }, hidden: true });
  return part("Stimulus", true, h("div", { class: "row" }, name),
    h("div", { class: "row" }, field(app, "peak", "Ricker", "Hz", [6 * record.rate / record.n, record.rate / 6], () => peak, (v) => { peak = v; tell({ kind: "ricker", peak }); })),
    h("details", { class: "more" }, h("summary", { text: "burst, own file, amplitude" }), h("div", { class: "row" }, field(app, "tone", "burst", "Hz", [1, record.rate / 4], () => tone, (v) => { tone = v; tell({ kind: "burst", frequency: tone, cycles }); }), field(app, "cycles", "of", "cycles", [1, 1000], () => cycles, (v) => { cycles = v; tell({ kind: "burst", frequency: tone, cycles }); })),
    h("div", { class: "row" }, h("button", { type: "button", onclick: () => own.click(), text: "own WAV or CSV …" }), own, h("small", { text: `at ${say(record.rate)} Hz` })),
    h("div", { class: "row" }, field(app, "amplitude", "amplitude", "V, or µm (inverse filter)", [1e-6, 1e6], () => experiment.settings.amplitude, (v) => app.set({ amplitude: v })))));
}

/** @param {App} app */
function filterPart(app) {
  const { experiment } = app;
  const usual = { rcond: 1e-12, tikhonov: 0.05, discrepancy: 0.05, lcurve: 1e-3, noise: 0.02 };
  const kind = h("select", { id: "rule", "aria-label": "regularisation", onchange: () => app.set({ rule: kind.value === "auto" ? null : { kind: kind.value, value: /** @type {any} */ (usual)[kind.value] } }) },
    ...[["auto", "automatic"], ["rcond", "pseudo-inverse"], ["tikhonov", "Tikhonov"], ["discrepancy", "discrepancy"], ["lcurve", "L-curve"], ["noise", "by measured error"]].map(([value, text]) => h("option", { value, text })));
  const value = field(app, "value", "value", "of the largest", [0, 0.999], () => experiment.settings.rule?.value ?? 0, (v) => { const { rule } = experiment.settings; if (rule) app.set({ rule: { ...rule, value: v } }); });
  app.listeners.push(() => { const { rule } = experiment.settings; kind.value = rule?.kind ?? "auto"; value.style.display = rule ? "" : "none"; });
  const window = h("select", { id: "window", "aria-label": "window of S", onchange: () => app.set({ window: window.value === "run" ? experiment.content.rendering.window : window.value }) },
    ...[["run", "as in the run"], ["wavelet", "around the wavelet"], ["record", "whole record"]].map(([v, text]) => h("option", { value: v, text })));
  return part("Inverse filter and S", false, h("div", { class: "row" }, h("label", {}, "regularisation", kind)), h("div", { class: "row" }, value), h("div", { class: "row" }, h("label", {}, "S over", window)));
}

/** @param {App} app */
function devicePart(app) {
  const { experiment } = app;
  if (!experiment.changeable) return part("Device", false, h("p", { class: "soft", style: "margin:0", text: "G was given as it is, without the skin's compliance: gains, contact and coil cannot be changed here." }));
  const change = (/** @type {Partial<Device>} */ part) => app.set({ device: { ...experiment.settings.device, ...part } });
  const put = (/** @type {any[]} */ list, /** @type {number} */ k, /** @type {any} */ v) => list.map((old, i) => (i === k ? v : old));
  const own = experiment.original().device;
  const row = (/** @type {import("./device.js").Port} */ p, /** @type {number} */ k) => {
    const kept = STIFFNESS.some(([, s]) => s === (own.spring[k] ?? Infinity)) ? [] : /** @type {[string, number][]} */ ([[`as in the run: ${say(own.spring[k] / 1e3)} N/mm`, own.spring[k]]]);
    const choices = [...STIFFNESS, ...kept];
    const gain = h("input", { type: "range", min: 0, max: 2, step: 0.05, "aria-label": `gain of ${p.name}`, onchange: () => change({ gain: put(experiment.settings.device.gain, k, Number(gain.value)) }), oninput: () => { text.textContent = Number(gain.value) ? `${gain.value}×` : "off"; } });
    const text = h("small", {}), touch = h("select", { "aria-label": `contact of ${p.name}`, onchange: () => { const s = choices[touch.selectedIndex][1], d = experiment.settings.device; change({ touching: put(d.touching, k, s > 0), spring: put(d.spring, k, s || Infinity) }); } }, ...choices.map(([t]) => h("option", { text: t })));
    const show = () => {
      const d = experiment.settings.device;
      gain.value = String(d.gain[k]); text.textContent = d.gain[k] ? `${d.gain[k]}×` : "off";
      touch.selectedIndex = Math.max(0, d.touching[k] ? choices.findIndex(([, s]) => s === d.spring[k]) : STIFFNESS.length - 1);
    };
    return { element: h("tr", {}, h("td", { text: p.name }), h("td", {}, gain), h("td", {}, text), h("td", {}, touch)), show };
  };
  const body = h("tbody", {});
  let rows = experiment.inputs.map(row);
  body.replaceChildren(...rows.map((r) => r.element));
  app.listeners.push(() => {
    if (rows.length !== experiment.inputs.length) { rows = experiment.inputs.map(row); body.replaceChildren(...rows.map((r) => r.element)); }
    for (const r of rows) r.show();
  });
  const coil = (/** @type {"moving_mass" | "resonance" | "force_factor" | "resistance"} */ key, /** @type {string} */ text, /** @type {string} */ unit, /** @type {number} */ factor, /** @type {[number, number]} */ range) =>
    h("div", { class: "row" }, field(app, key, text, unit, range, () => experiment.settings.device.coil[key] * factor, (v) => change({ coil: { ...experiment.settings.device.coil, [key]: v / factor } })));
  const fixed = h("input", { type: "checkbox", id: "fixed", onchange: () => change({ housing: { ...experiment.settings.device.housing, fixed: fixed.checked } }) });
  const again = h("input", { type: "checkbox", id: "again", onchange: () => app.set({ calibrated: again.checked }) });
  app.listeners.push(() => { fixed.checked = experiment.settings.device.housing.fixed; again.checked = experiment.settings.calibrated; });
  const voltage = experiment.settings.device.drive === "voltage";
  return part("Device", false,
    h("table", { class: "actuators" }, h("thead", {}, h("tr", {}, h("th", {}), h("th", { text: "gain" }), h("th", {}), h("th", { text: "contact" }))), body),
    ...(voltage ? [coil("moving_mass", "coil mass", "g", 1e3, [1e-3, 1e3]), h("div", { class: "row" }, field(app, "cone", "cone mass", "g", [0, 1e3], () => 1e3 * experiment.settings.device.cone.mass, (v) => change({ cone: { mass: v / 1e3 } }))), coil("resonance", "coil's own resonance", "Hz", 1, [0.01, 1e5]), coil("force_factor", "force factor Bl", "T m", 1, [1e-6, 1e4]), coil("resistance", "resistance", "ohm", 1, [1e-4, 1e6]), h("div", { class: "row" }, h("label", {}, fixed, "housing held still"))] : [h("p", { class: "soft", text: `drive: ${experiment.settings.device.drive}; coils play no part` })]),
    h("div", { class: "row" }, h("label", {}, again, "G measured again after changes: renderers know them")),
    h("div", { class: "row" }, h("button", { type: "button", onclick: () => { const o = experiment.original(); app.set({ device: fitted(o.device, experiment.inputs.length), calibrated: true }); }, text: "device as in the run" })));
}

/** The next or the last drawn arm, the run's own among them. @param {App} app @param {number} step */
function stepArm(app, step) {
  const { experiment } = app, count = experiment.drawnArms.length + 1, arm = (experiment.settings.arm + step + count) % count;
  if (count === 1) return app.say("this page holds no drawn arms: forearm-fem predict draws some, then make the page again", true);
  app.set(experiment.settings.place ? { arm, place: null, target: 0 } : { arm });
}

/** Arms that a prediction drew, one at a time and S of all of them. @param {App} app @returns {Element[]} */
function armsPart(app) {
  const { experiment } = app, { draws } = experiment.content;
  if (!draws?.length) return [];
  const name = h("strong", { id: "arm" }), facts = h("p", { class: "soft", id: "armfacts", style: "margin:2px 0 6px;font-size:12px" }), rows = h("tbody", {});
  const box = part("Drawn arms", false,
    h("div", { class: "row" }, h("button", { type: "button", id: "armback", "aria-label": "arm before", text: "‹", onclick: () => stepArm(app, -1) }), name, h("button", { type: "button", id: "armnext", "aria-label": "next arm", text: "›", onclick: () => stepArm(app, 1) })), facts,
    h("table", { id: "armtable" }, h("thead", {}, h("tr", {}, h("th", { text: "S, arm" }), ...METHODS.map((m) => h("th", { text: m })))), rows));
  const fill = (/** @type {number} */ version, /** @type {number} */ arm) => {
    if (version !== app.version || !box.open || arm > draws.length) return;
    const target = experiment.settings.target;
    rows.append(h("tr", { class: arm === experiment.settings.arm ? "now" : "" }, h("td", {}, h("button", { type: "button", text: arm ? draws[arm - 1].number : "run", onclick: () => stepArm(app, arm - experiment.settings.arm) })),
      ...METHODS.map((m) => h("td", { text: say(experiment.strengthOn(arm, m, target)) }))));
    setTimeout(() => fill(version, arm + 1), 0);
  };
  const show = () => {
    const { arm } = experiment.settings, draw = arm ? draws[arm - 1] : null;
    name.textContent = draw ? `draw ${draw.number}, ${draw.law}` : "the run's own arm";
    facts.textContent = draw ? `${Object.entries(draw.drivers).map(([k, v]) => `${k} ${k.endsWith("stiffness") ? sayUnit(/** @type {number} */ (v), "Pa") : `${say(1e3 * /** @type {number} */ (v))} mm`}`).join(", ")}. Its device was drawn, too: changes of the device play no part. Known at the points only.` : `${draws.length} of the arms drawn by forearm-fem predict: keys a and A step through them.`;
    rows.replaceChildren();
    if (box.open && !experiment.settings.place) fill(app.version, 0);
  };
  box.addEventListener("toggle", show);
  app.listeners.push(show);
  return [box];
}

/** @param {App} app */
function measuredPart(app) {
  const pick = h("input", { type: "file", id: "measured", accept: ".csv,.json,.txt", hidden: true, onchange: () => { take(app, pick.files, true); pick.value = ""; } });
  const name = h("small", {}), away = h("button", { type: "button", text: "take away", onclick: () => { app.overlay = null; app.version++; app.rescale(); } });
  app.listeners.push(() => { name.textContent = app.overlay ? app.overlay.name : "none loaded"; away.hidden = !app.overlay; });
  return part("Measured G", false, h("div", { class: "row" }, h("button", { type: "button", onclick: () => pick.click(), text: "lay over CSV or JSON …" }), pick, away), h("div", { class: "row" }, name));
}

/** Files brought or dropped: a G, or samples. What cannot be read is said; nothing else changes.
 * @param {App} app @param {FileList | File[] | null} files @param {boolean} [onlyG] */
async function take(app, files, onlyG = false) {
  for (const file of Array.from(files ?? [])) {
    try {
      checkSize(file.name, file.size);
      if (/\.wav$/i.test(file.name) && !onlyG) use(app, file.name, readWav(file.name, await file.arrayBuffer()));
      else {
        const text = await file.text();
        if (text.includes("\u0000")) throw new FileProblem(`${file.name}: is no text; expected a CSV or JSON`);
        if (onlyG || /\.json$/i.test(file.name) || text.includes("frequency_Hz")) lay(app, file.name, text);
        else use(app, file.name, readSamplesCsv(file.name, text));
      }
    } catch (problem) {
      app.say(inOneLine(problem instanceof FileProblem ? problem.message : `${file.name}: could not be read (${/** @type {Error} */ (problem).message}); nothing was changed`), true);
    }
  }
}

/** @param {App} app @param {string} name @param {{samples: Float64Array, rate: number | null}} found */
function use(app, name, found) {
  const samples = fitting(name, found, app.experiment.record);
  app.experiment.stimulate({ kind: "own", name, samples });
  app.refresh();
  app.say(`${name}: ${samples.length} samples are the stimulus now`);
}

/** @param {App} app @param {string} name @param {string} text */
function lay(app, name, text) {
  const { points, inputs, content } = app.experiment;
  app.overlay = readTransfer(name, text, points.map((p) => p.name), inputs.map((p) => p.name), content.unit);
  app.version++;
  app.rescale();
  const taken = app.overlay.told ? "" : `; it does not say what it is, and is taken for displacement in ${content.unit} with e^{+iωt}`;
  app.say(inOneLine(`${name}: ${app.overlay.frequency.length} frequencies laid over, dashed${taken}`), !app.overlay.told);
}

/** @param {App} app @param {ReturnType<typeof transport>} bar @param {() => void} theme */
export function keys(app, bar, theme) {
  const { arms, experiment } = app, dialog = $("keys");
  dialog.replaceChildren(h("h2", { text: "Keys" }), h("dl", {}, ...KEYS.flatMap(([k, t]) => [h("dt", {}, h("kbd", { text: k })), h("dd", { text: t })])), h("button", { type: "button", onclick: () => dialog.close(), text: "close" }));
  $("help").addEventListener("click", () => dialog.showModal());
  const turn = (/** @type {number} */ a, /** @type {number} */ b) => { arms.view.turn += a; arms.view.tilt = Math.max(-1.5, Math.min(1.55, arms.view.tilt + b)); arms.draw(experiment); };
  const step = (/** @type {number} */ d) => { app.playing = false; arms.time = Math.min(Math.max(arms.time + d * 5e-4, app.span[0]), app.span[1]); bar.said(); arms.draw(experiment); };
  document.addEventListener("keydown", (e) => {
    const on = /** @type {HTMLElement} */ (e.target);
    if (e.ctrlKey || e.metaKey || e.altKey || ["INPUT", "SELECT", "TEXTAREA"].includes(on.tagName) || dialog.open) return;
    if ((e.key === " " || e.key === "Enter") && (on.tagName === "BUTTON" || on.tagName === "SUMMARY")) return;
    const digit = /^Digit([1-9])$|^Numpad([1-9])$/.exec(e.code), held = e.shiftKey, name = digit ? digit[1] ?? digit[2] : "";
    const row = experiment.points.findIndex((p) => p.name === name);
    /** @type {Record<string, () => void>} */
    const act = {
      " ": () => { app.playing = !app.playing; bar.said(); }, ArrowLeft: () => (held ? turn(0.08, 0) : step(-1)), ArrowRight: () => (held ? turn(-0.08, 0) : step(1)),
      ArrowUp: () => turn(0, 0.06), ArrowDown: () => turn(0, -0.06), "+": () => nearer(0.9), "=": () => nearer(0.9), "-": () => nearer(1.1),
      "[": () => faster(1), "]": () => faster(-1), r: () => { arms.view = { ...arms.home }; arms.draw(experiment); }, t: theme, "?": () => dialog.showModal(),
      m: () => app.attend(METHODS[(METHODS.indexOf(app.focus) + 1) % METHODS.length]),
      a: () => stepArm(app, 1), A: () => stepArm(app, -1),
      s: () => { if (bar.section.disabled) return app.say(bar.section.title); bar.section.selectedIndex = (bar.section.selectedIndex + 1) % bar.section.options.length; arms.section = bar.section.value; app.rescale(); },
    };
    const vertical = e.key === "ArrowUp" || e.key === "ArrowDown";
    if (vertical && !held && on.id !== "over") return;
    const chosen = row >= 0 ? () => (held ? toggleZero(app, row) : aimAt(app, row)) : act[e.key];
    if (!chosen) return;
    e.preventDefault();
    chosen();
  });
  const nearer = (/** @type {number} */ f) => { arms.view.far = Math.min(Math.max(arms.view.far * f, 25), 1500); arms.draw(experiment); };
  const faster = (/** @type {number} */ d) => { bar.speed.selectedIndex = Math.min(Math.max(bar.speed.selectedIndex + d, 0), SPEEDS.length - 1); app.speed = SPEEDS[bar.speed.selectedIndex][1]; };
}

/** Turning and clicking with a pointer. @param {App} app */
export function pointer(app) {
  const { arms, experiment } = app, over = $("over");
  /** @type {{x: number, y: number, moved: boolean} | null} */
  let down = null;
  over.addEventListener("pointerdown", (/** @type {PointerEvent} */ e) => { down = { x: e.clientX, y: e.clientY, moved: false }; over.setPointerCapture(e.pointerId); });
  over.addEventListener("pointermove", (/** @type {PointerEvent} */ e) => {
    if (!down) return;
    const dx = e.clientX - down.x, dy = e.clientY - down.y;
    if (!down.moved && Math.hypot(dx, dy) < 4) return;
    down = { x: e.clientX, y: e.clientY, moved: true };
    arms.view.turn -= dx * 0.007;
    arms.view.tilt = Math.max(-1.5, Math.min(1.55, arms.view.tilt + dy * 0.007));
    arms.draw(experiment);
  });
  over.addEventListener("pointerup", (/** @type {PointerEvent} */ e) => {
    const click = down && !down.moved;
    down = null;
    if (!click) return;
    const box = over.getBoundingClientRect(), hit = arms.pick(e.clientX - box.left, e.clientY - box.top, experiment);
    if (!hit) return;
    if ("row" in hit) return e.shiftKey ? toggleZero(app, hit.row) : aimAt(app, hit.row);
    if (!app.field.everywhere) return app.say("between the points nothing is known to aim at; click a point");
    aimBetween(app, hit.vertex);
  });
  over.addEventListener("pointercancel", () => { down = null; }); // a finger scrolls the page
  over.addEventListener("wheel", (/** @type {WheelEvent} */ e) => { if (!e.ctrlKey && document.activeElement !== over) return; e.preventDefault(); arms.view.far = Math.min(Math.max(arms.view.far * Math.exp(e.deltaY * 0.001), 25), 1500); arms.draw(experiment); }, { passive: false });
  document.addEventListener("dragover", (e) => { e.preventDefault(); document.body.classList.add("dropping"); });
  document.addEventListener("dragleave", (e) => { if (!e.relatedTarget) document.body.classList.remove("dropping"); });
  document.addEventListener("drop", (e) => { e.preventDefault(); document.body.classList.remove("dropping"); take(app, e.dataTransfer?.files ?? null); });
}
