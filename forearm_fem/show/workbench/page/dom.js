/** Elements and plots of the page. */

/** Elements without a library: text goes in as text, never as markup. */

/**
 * @param {string} tag @param {Record<string, any>} [props] attributes, `on...` handlers, `text` @param {...(Node | string | null)} children
 * @returns {any}
 */
export function h(tag, props = {}, ...children) {
  const svg = ["svg", "path", "line", "rect", "circle", "text", "g", "polyline", "title", "tspan"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "text") element.textContent = String(value);
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.filter((c) => c !== null));
  return element;
}

/** New children in place of the old, with the focus where it was: on the element of the same number. @param {Element} parent
 * @param {...(Node | null)} children */
export function replace(parent, ...children) {
  const all = () => Array.from(parent.querySelectorAll("button, input, select, [tabindex]")), held = all().indexOf(/** @type {Element} */ (document.activeElement));
  parent.replaceChildren(...children.filter((c) => c !== null));
  if (held >= 0) /** @type {HTMLElement | undefined} */ (all()[held])?.focus();
}

/** @param {string} id @returns {any} */
export function $(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no element ${id}`);
  return found;
}

/** A number as people read it: three digits, a sign of its own, no exponent where it can be helped. @param {number} value @param {number} [digits] */
export function say(value, digits = 3) {
  if (!Number.isFinite(value)) return Number.isNaN(value) ? "unknown" : value > 0 ? "∞" : "−∞";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-4) {
    const power = Math.floor(Math.log10(size)), front = Number((value / 10 ** power).toPrecision(digits));
    return `${String(front).replace("-", "−")}·10${String(power).replace(/./g, (c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)])}`;
  }
  const text = size >= 1000 ? Number(value.toPrecision(digits)).toLocaleString("en") : String(Number(value.toPrecision(digits)));
  return text.replace("-", "−");
}

/** With a unit's prefix: 0.00031 W is 0.31 mW. @param {number} value @param {string} unit */
export function sayUnit(value, unit) {
  if (!Number.isFinite(value) || value === 0) return `${say(value)} ${unit}`;
  const [factor, prefix] = /** @type {[number, string][]} */ ([[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]]).find(([f]) => Math.abs(value) >= 0.9999 * f) ?? [1e-9, "n"];
  return `${say(value / factor)} ${prefix}${unit}`;
}

/**
 * Line charts as SVG: few ticks, thin lines, units on every axis.
 *
 * @typedef {{y: ArrayLike<number>, x?: ArrayLike<number>, colour: string, width?: number, dash?: string, label?: string, opacity?: number}} Series
 * @typedef {object} Chart
 * @property {string} title
 * @property {ArrayLike<number>} x
 * @property {[number, number]} span of x
 * @property {string} xLabel
 * @property {string} yLabel
 * @property {Series[]} series
 * @property {boolean} [log]
 * @property {boolean} [symmetric] y about zero
 * @property {{y: number, label: string}[]} [limits]
 * @property {[number, number] | null} [shade] of x
 * @property {number} [least] of the y axis' extent
 */

const W = 340, H = 180, LEFT = 54, RIGHT = 16, TOP = 8, BOTTOM = 34;

/** @param {Chart} chart @returns {SVGSVGElement} */
export function draw(chart) {
  const [x0, x1] = chart.span, range = extent(chart), [y0, y1] = range ?? [0, 1];
  const px = (/** @type {number} */ v) => LEFT + ((v - x0) / (x1 - x0)) * (W - LEFT - RIGHT);
  const to = (/** @type {number} */ v) => (chart.log ? Math.log10(v) : v);
  const py = (/** @type {number} */ v) => H - BOTTOM - ((to(v) - to(y0)) / (to(y1) - to(y0))) * (H - TOP - BOTTOM);
  const svg = h("svg", { viewBox: `0 0 ${W} ${H}`, class: "chart", role: "img", "aria-label": chart.title, preserveAspectRatio: "xMidYMid meet" });
  svg.append(h("title", { text: chart.title }));
  if (chart.shade) svg.append(h("rect", { x: px(Math.max(chart.shade[0], x0)), width: Math.max(px(Math.min(chart.shade[1], x1)) - px(Math.max(chart.shade[0], x0)), 0), y: TOP, height: H - TOP - BOTTOM, class: "shade" }));
  if (!range) svg.append(h("text", { x: (LEFT + W - RIGHT) / 2, y: (TOP + H - BOTTOM) / 2, "text-anchor": "middle", text: "nothing to show" }));
  else for (const v of chart.log ? decades(y0, y1) : ticks(y0, y1, 4)) {
    svg.append(h("line", { x1: LEFT, x2: W - RIGHT, y1: py(v), y2: py(v), class: v === 0 ? "zero" : "grid" }));
    svg.append(h("text", { x: LEFT - 6, y: py(v) + 3.5, "text-anchor": "end", text: say(v) }));
  }
  for (const v of ticks(x0, x1, 5)) svg.append(h("text", { x: px(v), y: H - BOTTOM + 14, "text-anchor": "middle", text: say(v) }));
  for (const l of chart.limits ?? []) if (range && l.y >= y0 && l.y <= y1) {
    svg.append(h("line", { x1: LEFT, x2: W - RIGHT, y1: py(l.y), y2: py(l.y), class: "limit" }));
    svg.append(h("text", { x: W - RIGHT - 2, y: py(l.y) + (l.y > 0 ? -3 : 10), "text-anchor": "end", class: "limit-text", text: l.label }));
  }
  for (const s of chart.series) svg.append(h("path", { d: path(s.x ?? chart.x, s.y, px, py, chart), fill: "none", stroke: s.colour, "stroke-width": s.width ?? 1, "stroke-dasharray": s.dash, opacity: s.opacity, "stroke-linejoin": "round" }));
  svg.append(h("text", { x: (LEFT + W - RIGHT) / 2, y: H - 4, "text-anchor": "middle", class: "label", text: chart.xLabel }));
  svg.append(h("text", { transform: `translate(11 ${(TOP + H - BOTTOM) / 2}) rotate(-90)`, "text-anchor": "middle", class: "label", text: chart.yLabel }));
  return svg;
}

/** Where a value of x stands, in parts of the chart's width. @param {number} at @param {[number, number]} span */
export function across(at, [x0, x1]) {
  return (LEFT + ((Math.min(Math.max(at, x0), x1) - x0) / (x1 - x0)) * (W - LEFT - RIGHT)) / W;
}

/** The line that marks the instant shown, in the chart itself. @param {SVGElement} svg @param {number} at @param {[number, number]} span */
export function mark(svg, at, span) {
  const x = W * across(at, span);
  svg.append(h("line", { class: "cursor", y1: TOP, y2: H - BOTTOM, x1: x, x2: x }));
}

/** Value of x under a pointer. @param {SVGSVGElement} svg @param {number} clientX @param {[number, number]} span */
export function valueAt(svg, clientX, [x0, x1]) {
  const box = svg.getBoundingClientRect(), scale = Math.min(box.width / W, box.height / H), left = box.left + (box.width - W * scale) / 2;
  return x0 + (((clientX - left) / scale - LEFT) / (W - LEFT - RIGHT)) * (x1 - x0);
}

/** Of y; null where no series says anything. @param {Chart} chart @returns {[number, number] | null} */
function extent(chart) {
  let low = Infinity, high = -Infinity;
  for (const s of chart.series) {
    const x = s.x ?? chart.x;
    for (let i = 0; i < s.y.length; i++) {
      const v = s.y[i];
      if (!Number.isFinite(v) || x[i] < chart.span[0] || x[i] > chart.span[1] || (chart.log && v <= 0)) continue;
      low = Math.min(low, v);
      high = Math.max(high, v);
    }
  }
  if (low > high) return null;
  if (chart.log) return [Math.max(low * 0.8, high * 1e-5), high * 1.3];
  if (chart.symmetric) { const most = Math.max(-low, high, chart.least ?? 0) * 1.08 || 1; return [-most, most]; }
  const room = 0.06 * (high - low || Math.abs(high) || 1);
  return [Math.min(low, 0) === 0 ? 0 : low - room, high + room];
}

/** @param {number} a @param {number} b @param {number} about @returns {number[]} */
export function ticks(a, b, about) {
  const raw = (b - a) / about, power = 10 ** Math.floor(Math.log10(raw)), step = power * ([1, 2, 2.5, 5, 10].find((m) => m * power >= raw * 0.999) ?? 10);
  const out = [];
  for (let k = Math.ceil(a / step - 1e-9); k * step <= b * (1 + 1e-12) + 1e-12; k++) out.push(Number((k * step).toPrecision(12)));
  return out;
}

/** @param {number} a @param {number} b @returns {number[]} */
function decades(a, b) {
  const out = [], few = Math.log10(b / a) < 2;
  for (let p = Math.floor(Math.log10(a)); p <= Math.log10(b); p++) for (const m of few ? [1, 2, 5] : [1]) {
    const v = Number((m * 10 ** p).toPrecision(6));
    if (v >= a && v <= b) out.push(v);
  }
  return out;
}

/** @param {ArrayLike<number>} x @param {ArrayLike<number>} y @param {(v: number) => number} px @param {(v: number) => number} py
 * @param {Chart} chart */
function path(x, y, px, py, chart) {
  let d = "", pen = false;
  const inside = [];
  for (let i = 0; i < y.length; i++) if (x[i] >= chart.span[0] && x[i] <= chart.span[1]) inside.push(i);
  const step = Math.max(1, Math.floor(inside.length / 900));
  for (let k = 0; k < inside.length; k += step) {
    const v = y[inside[k]];
    if (!Number.isFinite(v) || (chart.log && v <= 0)) { pen = false; continue; }
    d += `${pen ? "L" : "M"}${px(x[inside[k]]).toFixed(1)} ${Math.min(Math.max(py(v), -50), 300).toFixed(1)}`;
    pen = true;
  }
  return d;
}
