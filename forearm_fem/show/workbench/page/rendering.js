/** Rendering: zero points, and drives by each method. */
import { svd, zeros } from "./numeric.js";

/**
 * Rectangles of ports and the zero points that follow from them. As Python's ports.py and rendering/renderers.py.
 *
 * @typedef {import("./device.js").Port} Port
 * @typedef {{angle: number, rows: number[], columns: number[], place: number[][], slack: number}} Lattice
 */
const SLACK = 0.05;

/** The N x M array (N, M >= 2) that ports form seen from above, or null. @param {Port[]} ports @returns {Lattice | null} */
function latticeOf(ports) {
  if (ports.length < 4) return null;
  const step = ports.map((p) => [p.position[0] - ports[0].position[0], p.position[1] - ports[0].position[1]]);
  let nearest = 1;
  step.forEach((s, i) => { if (i && Math.hypot(...s) < Math.hypot(...step[nearest])) nearest = i; });
  const reach = Math.hypot(...step[nearest]);
  let angle = Math.atan2(step[nearest][1], step[nearest][0]);
  angle -= (Math.PI / 2) * Math.round(angle / (Math.PI / 2));
  const turned = ports.map((p) => turn(p.position, -angle));
  const [rows, r] = lines(turned.map((t) => t[0]), SLACK * reach), [columns, c] = lines(turned.map((t) => t[1]), SLACK * reach);
  const place = ports.map((_, i) => [r[i], c[i]]);
  const distinct = new Set(place.map(String)).size;
  const filled = rows.length >= 2 && columns.length >= 2 && rows.length * columns.length === ports.length && distinct === ports.length;
  return filled ? { angle, rows, columns, place, slack: SLACK * reach } : null;
}

/** @param {number[]} at @param {number} angle @returns {[number, number]} */
function turn(at, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return [c * at[0] - s * at[1], s * at[0] + c * at[1]];
}

/** @param {number[]} coordinate @param {number} slack @returns {[number[], number[]]} */
function lines(coordinate, slack) {
  const order = coordinate.map((_, i) => i).sort((a, b) => coordinate[a] - coordinate[b]);
  /** @type {number[]} */
  const line = new Array(coordinate.length).fill(0);
  order.forEach((i, k) => { line[i] = k ? line[order[k - 1]] + (coordinate[i] - coordinate[order[k - 1]] > 2 * slack ? 1 : 0) : 0; });
  const count = Math.max(...line) + 1;
  const means = Array.from({ length: count }, (_, l) => {
    const own = coordinate.filter((_, i) => line[i] === l);
    return own.reduce((a, b) => a + b, 0) / own.length;
  });
  return [means, line];
}

/** (1 - d_x / D_x)(1 - d_y / D_y) of each actuator, or why there is none. 
 *
 * Actuators on a line or in triangles have the weights that Python found for each point (`known`).
 * @param {Port[]} inputs @param {Port} target @param {number[] | null} known @returns {number[] | string} */
function funnelingWeights(inputs, target, known) {
  const grid = latticeOf(inputs);
  if (!grid) return known ?? triangleWeights(inputs.map((p) => p.position), target.position) ?? `funneling does not reach this place: these ${inputs.length} actuators form no rectangle around it`;
  const at = turn(target.position, -grid.angle);
  const shares = [grid.rows, grid.columns].map((found, axis) => sharesOf(at[axis], found, grid.slack));
  if (shares.some((s) => s === null)) return "funneling reaches only places inside the actuators' rectangle";
  return inputs.map((_, i) => /** @type {number[]} */ (shares[0])[grid.place[i][0]] * /** @type {number[]} */ (shares[1])[grid.place[i][1]]);
}

/** Shares (n,) of a point in the triangle of nearest places around it: no other lies in the triangle's circle. Where several
 * triangles are as good, their mean; null outside all. As Python's rendering/triangles.py, but for points beside an edge.
 * @param {number[][]} places @param {number[]} at @returns {number[] | null} */
function triangleWeights(places, at) {
  const out = places.map(() => 0), cross = (/** @type {number[]} */ a, /** @type {number[]} */ b, /** @type {number[]} */ c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  let count = 0;
  places.forEach((a, i) => places.slice(0, i).forEach((b, j) => places.slice(0, j).forEach((c, k) => {
    const area = cross(a, b, c), share = [cross(b, c, at), cross(c, a, at), cross(a, b, at)].map((v) => v / area);
    if (!(Math.abs(area) > 1e-9 * ((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2)) || share.some((v) => v < -1e-9)) return;
    const [x, y, u, v] = [b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]], p = x * x + y * y, q = u * u + v * v;
    const centre = [a[0] + (v * p - y * q) / (2 * area), a[1] + (x * q - u * p) / (2 * area)], radius = Math.hypot(centre[0] - a[0], centre[1] - a[1]);
    if (places.some((d) => Math.hypot(d[0] - centre[0], d[1] - centre[1]) < radius * (1 - 1e-6))) return;
    const clipped = share.map((w) => Math.max(w, 0)), sum = clipped.reduce((s, w) => s + w, 0);
    [i, j, k].forEach((corner, n) => { out[corner] += clipped[n] / sum; });
    count++;
  })));
  return count ? out.map((w) => w / count) : null;
}

/** @param {number} at @param {number[]} found @param {number} slack @returns {number[] | null} */
function sharesOf(at, found, slack) {
  const last = found.length - 1;
  if (at < found[0] - slack || at > found[last] + slack) return null;
  const inside = Math.min(Math.max(at, found[0]), found[last]), out = found.map(() => 0);
  let k = 0;
  while (k < last - 1 && inside > found[k + 1]) k++;
  const share = (inside - found[k]) / (found[k + 1] - found[k]);
  out[k] = 1 - share;
  out[k + 1] = share;
  return out;
}

/** Corners of the grid; for a corner the other three and the middle; null without a rectangle. @param {Port[]} outputs
 * @param {number} target @returns {number[] | null} */
export function thesisZeros(outputs, target) {
  const grid = latticeOf(outputs);
  if (!grid) return null;
  const last = [grid.rows.length - 1, grid.columns.length - 1];
  const corner = (/** @type {number} */ i) => grid.place[i].every((v, axis) => v === 0 || v === last[axis]);
  const chosen = outputs.map((_, i) => i).filter((i) => i !== target && corner(i));
  if (chosen.length === 3) {
    const off = outputs.map((_, i) => Math.abs(grid.place[i][0] - last[0] / 2) + Math.abs(grid.place[i][1] - last[1] / 2));
    const middle = off.indexOf(Math.min(...off));
    if (middle !== target && !chosen.includes(middle)) chosen.push(middle);
  }
  return chosen;
}

/** The thesis' corners for up to four actuators on a grid, else all others. @param {Port[]} outputs @param {number} target
 * @param {number} actuators that are known at all @returns {number[]} */
export function autoZeros(outputs, target, actuators) {
  const corners = actuators <= 4 ? thesisZeros(outputs, target) : null;
  return corners ?? outputs.map((_, i) => i).filter((i) => i !== target);
}

/**
 * Inverse filter, funneling and combination: from G and a target to drives. As Python's rendering/.
 *
 * @typedef {import("./numeric.js").Complex} Complex
 * @typedef {import("./device.js").Port} Port
 * @typedef {import("./numeric.js").Svd} Svd
 * @typedef {"rcond" | "tikhonov" | "discrepancy" | "lcurve" | "noise"} RuleKind
 * @typedef {{kind: RuleKind, value: number}} Rule
 * @typedef {"inverse filter" | "funneling" | "combination"} Method
 * @typedef {object} Placed  G on the bins of a record
 * @property {Complex} values (bins x outputs x inputs)
 * @property {Uint8Array | null} valid of the same size; null: all
 * @property {Float64Array} error e(f) that a measurement states, NaN where unknown and for a simulated G
 * @property {number} least e(f) that more than four inputs are damped for at least
 * @property {Port[]} outputs
 * @property {Port[]} inputs
 * @property {number} bins
 * @property {(number[] | null)[]} [weights] of funneling towards each output, for actuators that form no rectangle
 * @typedef {{spectrum: Complex, used: Uint8Array, zeros: number[], inversion: Inversion | null}} Aim
 * @typedef {{condition: Float64Array, misfit: Float64Array, rank: Float64Array}} Inversion
 */

const ROUNDING = 4e-15, TINY = 2.2250738585072014e-308;
const MOST_KNOWN = 4;

/** Actuators known on any bin. @param {Placed} g */
export function knownInputs(g) {
  return absentInputs(g, g.outputs.map((_, i) => i)).filter((absent) => !absent).length;
}

/** @param {Placed} g @param {number[]} rows @returns {boolean[]} inputs never known in these rows */
function absentInputs(g, rows) {
  const { valid } = g, n = g.inputs.length;
  if (!valid) return g.inputs.map(() => false);
  return g.inputs.map((_, i) => {
    for (let b = 0; b < g.bins; b++) for (const row of rows) if (valid[(b * g.outputs.length + row) * n + i]) return false;
    return true;
  });
}

/** Bins on which G is known between `rows` and every input that is known there at all. @param {Placed} g
 * @param {number[]} rows @returns {Uint8Array} */
function knownBins(g, rows) {
  const absent = absentInputs(g, rows), used = new Uint8Array(g.bins).fill(absent.every(Boolean) ? 0 : 1);
  if (g.valid) for (let b = 0; b < g.bins; b++) for (const row of rows) g.inputs.forEach((_, i) => {
    if (!absent[i] && !(/** @type {Uint8Array} */ (g.valid)[(b * g.outputs.length + row) * g.inputs.length + i])) used[b] = 0;
  });
  if (!used.some(Boolean)) throw new Error(`G is unknown on every bin for ${rows.map((r) => g.outputs[r].name).join(", ")}; choose other points`);
  return used;
}

/**
 * Drives (bins x inputs) [unit/Hz] with which `method` aims at output `target`.
 * @param {Method} method @param {Placed} g @param {number} target @param {Complex} wavelet (bins,) [1/Hz]
 * @param {{zeros: number[], rule: Rule | null, amplitude: number}} options amplitude [V, or 1e-6 m]
 * @param {Map<string, Svd[]>} [known] decompositions of earlier calls on the same G
 * @returns {Aim}
 */
export function aim(method, g, target, wavelet, options, known) {
  if (method === "funneling") return funneling(g, target, wavelet, options.amplitude);
  if (method === "inverse filter") {
    const wanted = { re: wavelet.re.map((v) => v * options.amplitude * 1e-6), im: wavelet.im.map((v) => v * options.amplitude * 1e-6) };
    return inverse(g, target, wanted, options, known);
  }
  const sent = funneling(g, target, wavelet, options.amplitude), n = g.inputs.length, wanted = zeros(g.bins);
  for (let b = 0; b < g.bins; b++) for (let i = 0; i < n; i++) {
    const x = (b * g.outputs.length + target) * n + i, y = b * n + i;
    wanted.re[b] += g.values.re[x] * sent.spectrum.re[y] - g.values.im[x] * sent.spectrum.im[y];
    wanted.im[b] += g.values.re[x] * sent.spectrum.im[y] + g.values.im[x] * sent.spectrum.re[y];
  }
  const found = inverse(g, target, wanted, options, known);
  return { ...found, used: found.used.map((u, b) => u & sent.used[b]) };
}

/** @param {Placed} g @param {number} target @param {Complex} wavelet @param {number} amplitude @returns {Aim} */
function funneling(g, target, wavelet, amplitude) {
  const weights = funnelingWeights(g.inputs, g.outputs[target], g.weights?.[target] ?? null);
  if (typeof weights === "string") throw new Error(weights);
  const used = knownBins(g, [target]), absent = absentInputs(g, [target]), n = g.inputs.length, spectrum = zeros(g.bins * n);
  for (let b = 0; b < g.bins; b++) if (used[b]) for (let i = 0; i < n; i++) {
    const w = absent[i] ? 0 : amplitude * weights[i];
    spectrum.re[b * n + i] = w * wavelet.re[b];
    spectrum.im[b * n + i] = w * wavelet.im[b];
  }
  return { spectrum, used, zeros: [], inversion: null };
}

/**
 * Least squares at every bin: `wanted` (bins,) [m/Hz] at the target, nothing at the zero points.
 * @param {Placed} g @param {number} target @param {Complex} wanted @param {{zeros: number[], rule: Rule | null}} options
 * @param {Map<string, Svd[]>} [known] @returns {Aim}
 */
function inverse(g, target, wanted, options, known) {
  const rows = [target, ...options.zeros], n = g.inputs.length, used = knownBins(g, rows), absent = absentInputs(g, rows);
  const rule = options.rule ?? (knownInputs(g) <= MOST_KNOWN ? { kind: "rcond", value: 1e-12 } : { kind: "noise", value: g.least });
  const spectrum = zeros(g.bins * n), nan = () => new Float64Array(g.bins).fill(NaN);
  const inversion = { condition: nan(), misfit: nan(), rank: nan() };
  const key = rows.join(), parts = known?.get(key) ?? new Array(g.bins);
  const matrix = zeros(rows.length * n);
  for (let b = 0; b < g.bins; b++) {
    if (!used[b]) continue;
    let most = 0;
    rows.forEach((row, c) => {
      for (let i = 0; i < n; i++) {
        const from = (b * g.outputs.length + row) * n + i, to = c * n + i;
        matrix.re[to] = absent[i] ? 0 : g.values.re[from];
        matrix.im[to] = absent[i] ? 0 : g.values.im[from];
        most = Math.max(most, Math.hypot(matrix.re[to], matrix.im[to]));
      }
    });
    parts[b] ??= svd(matrix, rows.length, n);
    const noise = Math.max(Number.isNaN(g.error[b]) ? 0 : g.error[b], rule.value) * most * Math.sqrt(rows.length);
    invertBin(parts[b], matrix, wanted, b, rule, noise, spectrum, inversion);
  }
  known?.set(key, parts);
  return { spectrum, used, zeros: options.zeros, inversion };
}

/**
 * @param {Svd} found @param {Complex} matrix @param {Complex} wanted @param {number} b @param {Rule} rule
 * @param {number} noise lambda of the rule "noise" @param {Complex} spectrum @param {Inversion} inversion
 */
function invertBin(found, matrix, wanted, b, rule, noise, spectrum, inversion) {
  const { left, s, right, rows, columns, rank } = found, ur = wanted.re[b], ui = wanted.im[b];
  // only the target's row of U is not zero: beta = conj(first row of the left vectors) times it
  const br = new Float64Array(rank), bi = new Float64Array(rank), size = new Float64Array(rank);
  for (let k = 0; k < rank; k++) {
    br[k] = left.re[k] * ur + left.im[k] * ui;
    bi[k] = left.re[k] * ui - left.im[k] * ur;
    size[k] = Math.hypot(br[k], bi[k]);
  }
  const lambda = rule.kind === "noise" ? noise : parameterOf(s.subarray(0, rank), size, Math.hypot(ur, ui), rule);
  let effective = 0;
  for (let k = 0; k < rank; k++) {
    const w = weightOf(s[k], s[0], lambda, rule.kind);
    effective += w * s[k];
    for (let i = 0; i < columns; i++) {
      const vr = right.re[i * columns + k] * w, vi = right.im[i * columns + k] * w;
      spectrum.re[b * columns + i] += vr * br[k] - vi * bi[k];
      spectrum.im[b * columns + i] += vr * bi[k] + vi * br[k];
    }
  }
  let rest = 0;
  for (let i = 0; i < columns; i++) {
    let any = false;
    for (let c = 0; c < rows; c++) any ||= matrix.re[c * columns + i] !== 0 || matrix.im[c * columns + i] !== 0;
    if (!any) { spectrum.re[b * columns + i] = 0; spectrum.im[b * columns + i] = 0; }
  }
  for (let c = 0; c < rows; c++) {
    let re = c ? 0 : -ur, im = c ? 0 : -ui;
    for (let i = 0; i < columns; i++) {
      const x = c * columns + i, y = b * columns + i;
      re += matrix.re[x] * spectrum.re[y] - matrix.im[x] * spectrum.im[y];
      im += matrix.re[x] * spectrum.im[y] + matrix.im[x] * spectrum.re[y];
    }
    rest += re * re + im * im;
  }
  inversion.condition[b] = s[rank - 1] <= ROUNDING * s[0] ? Infinity : s[0] / s[rank - 1];
  inversion.rank[b] = effective;
  inversion.misfit[b] = Math.sqrt(rest) / Math.max(Math.hypot(ur, ui), TINY);
}

/** What multiplies U^H u in place of 1 / s. @param {number} s @param {number} most @param {number} lambda @param {RuleKind} kind */
function weightOf(s, most, lambda, kind) {
  if (!(s > 0) || s <= ROUNDING * most) return 0;
  if (kind === "rcond") return s > lambda ? 1 / s : 0;
  return 1 / (s + (lambda * lambda) / s);
}

/** @param {Float64Array} s @param {Float64Array} beta sizes @param {number} wanted |U| @param {Rule} rule */
function parameterOf(s, beta, wanted, rule) {
  if (rule.kind === "discrepancy") return discrepancy(s, beta, rule.value * wanted);
  if (rule.kind === "lcurve") return lcurve(s, beta, wanted, Math.max(rule.value, 1e-12));
  return rule.value * s[0];
}

/** lambda^2 / (s^2 + lambda^2). @param {number} s @param {number} lambda */
function open(s, lambda) {
  const total = Math.hypot(s, lambda);
  return total > 0 ? (lambda / total) ** 2 : 0;
}

/** lambda whose misfit exceeds the least by `misfit`, by bisection of its logarithm. @param {Float64Array} s
 * @param {Float64Array} beta @param {number} misfit */
function discrepancy(s, beta, misfit) {
  let low = Math.log(1e-15), high = Math.log(1e6);
  for (let k = 0; k < 60; k++) {
    const middle = (low + high) / 2, lambda = Math.exp(middle) * s[0];
    const reached = Math.sqrt(beta.reduce((sum, b, i) => sum + (open(s[i], lambda) * b) ** 2, 0));
    if (reached < misfit) low = middle;
    else high = middle;
  }
  return Math.exp(low) * s[0];
}

/** lambda at the corner of the L-curve. @param {Float64Array} s @param {Float64Array} beta @param {number} wanted
 * @param {number} smallest */
function lcurve(s, beta, wanted, smallest) {
  const count = 80, t = Array.from({ length: count }, (_, i) => Math.log(smallest) * (1 - i / (count - 1)));
  const rest = Math.max(wanted * wanted - beta.reduce((sum, b) => sum + b * b, 0), 0);
  /** @type {number[]} */
  const x = [], y = [];
  for (const log of t) {
    const lambda = Math.exp(log) * s[0];
    let misfit = rest, norm = 0;
    s.forEach((v, k) => {
      const o = open(v, lambda), inverse = v > ROUNDING * s[0] ? 1 / v : 0;
      misfit += (o * beta[k]) ** 2;
      norm += ((1 - o) * inverse * beta[k]) ** 2;
    });
    x.push(Math.log(Math.max(misfit, TINY)) / 2);
    y.push(Math.log(Math.max(norm, TINY)) / 2);
  }
  const dx = gradient(x, t), dy = gradient(y, t), ddx = gradient(dx, t), ddy = gradient(dy, t);
  let best = 0, most = -Infinity;
  for (let i = 0; i < count; i++) {
    const speed = Math.hypot(dx[i], dy[i]), bend = speed < 1e-3 ? -Infinity : (dx[i] * ddy[i] - ddx[i] * dy[i]) / speed ** 3;
    if (bend > most) { most = bend; best = i; }
  }
  return Math.exp(t[best]) * s[0];
}

/** As numpy.gradient on an even axis. @param {number[]} y @param {number[]} t */
function gradient(y, t) {
  const last = y.length - 1;
  return y.map((_, i) => {
    const a = Math.max(i - 1, 0), b = Math.min(i + 1, last);
    return (y[b] - y[a]) / (t[b] - t[a]);
  });
}

/**
 * Spectra (bins x outputs) [m/Hz] of all outputs, and the share of the drive's energy on bins where each is unknown.
 * @param {Placed} g @param {Complex} spectrum @returns {{spectra: Complex, lost: number[]}}
 */
export function respond(g, spectrum) {
  const m = g.outputs.length, n = g.inputs.length, spectra = zeros(g.bins * m), missing = new Float64Array(m);
  let total = 0;
  for (let b = 0; b < g.bins; b++) {
    const energy = Float64Array.from({ length: n }, (_, i) => spectrum.re[b * n + i] ** 2 + spectrum.im[b * n + i] ** 2);
    const sum = energy.reduce((a, e) => a + e, 0);
    total += sum;
    for (let p = 0; p < m; p++) {
      let re = 0, im = 0, hole = false;
      for (let i = 0; i < n; i++) {
        const x = (b * m + p) * n + i, y = b * n + i;
        if (g.valid && !g.valid[x]) { hole ||= energy[i] > 0; continue; }
        re += g.values.re[x] * spectrum.re[y] - g.values.im[x] * spectrum.im[y];
        im += g.values.re[x] * spectrum.im[y] + g.values.im[x] * spectrum.re[y];
      }
      spectra.re[b * m + p] = re;
      spectra.im[b * m + p] = im;
      if (hole) missing[p] += sum;
    }
  }
  return { spectra, lost: Array.from(missing, (v) => (total ? v / total : 0)) };
}
