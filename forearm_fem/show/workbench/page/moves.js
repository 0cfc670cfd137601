/** Actuators at other places: of a library or tables, and of flat layers. */
import { solveInPlace, unpack, unpackComplex, zeros } from "./numeric.js";

/**
 * The skin's compliance for discs anywhere on flat layers, from channels tabulated over distance. As Python's
 * workbench/anywhere.py.
 *
 * @typedef {import("./numeric.js").Complex} Complex
 * @typedef {import("./device.js").Port} Port
 * @typedef {{at: Uint16Array, weight: Float32Array, slots: number, k: number}} Net  a few radial signals for each vertex
 */

const SIX = [0, 1, 2, 3, 4, 5], FOUR = [0, 1, 2, 3];

export class Anywhere {
  /** @param {any} model packed @param {Float64Array} frequency of the page's bins [Hz] @param {Port[]} points */
  constructor(model, frequency, points) {
    /** Azimuthal order of each channel; the first is the disc's force. @type {number[]} */
    this.order = model.order;
    this.nodes = model.nodes;
    this.radius = model.radius;
    this.pressed = model.pressed;
    this.closest = model.closest * model.radius;
    this.clear = model.clear;
    /** @type {number[]} */
    this.middle = model.middle;
    /** Of the rectangle around the middle in which actuators can stand [m]. @type {number[]} */
    this.half = model.half;
    /** Where the run had its actuators. @type {number[][]} */
    this.home = model.home;
    /** Of G after a move, over the band. */
    this.error = model.error;
    this.radii = model.radii;
    this.apart = model.apart;
    this.away = model.away;
    this.own = unpackComplex(model.own);
    this.discs = unpackComplex(model.discs);
    this.points = unpackComplex(model.points);
    this.places = points.map((p) => [p.position[0], p.position[1]]);
    this.onBins = between(frequency, model.ends, model.nodes);
    this.bins = frequency.length;
    /** @type {{key: string, answer: Complex[]} | null} */
    this.known = null;
    /** @type {Complex | null} */
    this.fields = null;
  }

  /** Why discs cannot stand there; empty if they can. @param {number[][]} contacts @param {string[]} names @returns {string} */
  refusal(contacts, names) {
    const { half, middle, radius, closest, pressed, places } = this;
    for (const [k, at] of contacts.entries()) {
      if (at.some((v, c) => Math.abs(v - middle[c]) + radius > half[c] + 1e-9)) return `${names[k]} would leave the ${(2e3 * half[0]).toFixed(0)} x ${(2e3 * half[1]).toFixed(0)} mm of skin for which this page has tables`;
      for (let j = 0; j < k; j++) {
        const apart = Math.hypot(at[0] - contacts[j][0], at[1] - contacts[j][1]);
        if (apart < closest - 1e-9) return `${names[k]} and ${names[j]} would stand ${(1e3 * apart).toFixed(1)} mm apart; this page's tables need ${(1e3 * closest).toFixed(1)} mm, forearm-fem run can do closer`;
      }
      for (const [p, place] of places.entries()) if (pressed && Math.hypot(at[0] - place[0], at[1] - place[1]) < radius + this.clear) return `${names[k]} would press on point ${p + 1}, for which this page has no tables`;
    }
    return "";
  }

  /** @param {number[]} at [m] @param {Port} port @returns {Port} */
  port(at, port) {
    return { ...port, position: [at[0], at[1], 0], axis: [0, 0, 1] };
  }

  /** Channels' coefficients and the motion of the discs, at each node: a unit force on each disc in turn.
   * @param {number[][]} contacts @returns {Complex[]} two: (nodes x m c x m) coefficients, (nodes x m x m) motion */
  solved(contacts) {
    const key = JSON.stringify(contacts);
    if (this.known?.key === key) return this.known.answer;
    const { order, nodes, own } = this, c = order.length, m = contacts.length, inner = m * (c - 1), size = m * c;
    const coefficients = zeros(nodes * size * m), motion = zeros(nodes * m * m), pairs = contacts.map((a, i) => contacts.slice(0, i).map((b) => this.pair(b[0] - a[0], b[1] - a[1])));
    const whole = zeros(size * size), a = zeros(inner * inner), b = zeros(inner * m);
    const seat = Array.from({ length: inner }, (_, k) => Math.floor(k / (c - 1)) * c + 1 + (k % (c - 1))); // of the k-th inner channel
    for (let n = 0; n < nodes; n++) {
      for (let i = 0; i < m; i++) for (let p = 0; p < c; p++) for (let q = 0; q < c; q++) {
        const at = (i * c + p) * size + i * c + q, from = (n * c + p) * c + q;
        whole.re[at] = own.re[from]; whole.im[at] = own.im[from];
        for (let j = 0; j < i; j++) {
          const block = pairs[i][j], to = (i * c + p) * size + j * c + q, back = (j * c + q) * size + i * c + p;
          whole.re[to] = whole.re[back] = block.re[from]; whole.im[to] = whole.im[back] = block.im[from];
        }
      }
      for (let k = 0; k < inner; k++) {
        for (let l = 0; l < inner; l++) { a.re[k * inner + l] = whole.re[seat[k] * size + seat[l]]; a.im[k * inner + l] = whole.im[seat[k] * size + seat[l]]; }
        for (let i = 0; i < m; i++) { b.re[k * m + i] = -whole.re[seat[k] * size + i * c]; b.im[k * m + i] = -whole.im[seat[k] * size + i * c]; }
      }
      solveInPlace(a, b, inner, m);
      const start = n * size * m;
      for (let i = 0; i < m; i++) coefficients.re[start + i * c * m + i] = 1;
      for (let k = 0; k < inner; k++) for (let i = 0; i < m; i++) { coefficients.re[start + seat[k] * m + i] = b.re[k * m + i]; coefficients.im[start + seat[k] * m + i] = b.im[k * m + i]; }
      for (let j = 0; j < m; j++) this.row(whole, j * c * size, size, coefficients, start, m, motion, (n * m + j) * m);
    }
    this.known = { key, answer: [coefficients, motion] };
    return this.known.answer;
  }

  /** One row (size,) times coefficients (size x m) into `out` (m,). @param {Complex} values @param {number} from @param {number} size
   * @param {Complex} by @param {number} start @param {number} m @param {Complex} out @param {number} to */
  row(values, from, size, by, start, m, out, to) {
    for (let s = 0; s < size; s++) for (let i = 0; i < m; i++) {
      const x = values.re[from + s], y = values.im[from + s], u = by.re[start + s * m + i], v = by.im[start + s * m + i];
      out.re[to + i] += x * u - y * v;
      out.im[to + i] += x * v + y * u;
    }
  }

  /** Compliance (bins x (contacts + points) x contacts) [m/N] of discs at `contacts`. @param {number[][]} contacts @returns {Complex} */
  skin(contacts) {
    const m = contacts.length, { nodes, places } = this, ports = m + places.length, motion = this.solved(contacts)[1], out = zeros(nodes * ports * m);
    const rows = places.map((at) => this.seenAt(contacts, at));
    for (let n = 0; n < nodes; n++) for (const part of /** @type {("re" | "im")[]} */ (["re", "im"])) {
      out[part].set(motion[part].subarray(n * m * m, (n + 1) * m * m), n * ports * m);
      rows.forEach((row, p) => out[part].set(row[part].subarray(n * m, (n + 1) * m), (n * ports + m + p) * m));
    }
    return this.spread(out, ports * m);
  }

  /** Motion (bins x contacts) [m/N] at any place. @param {number[][]} contacts @param {number[]} at @returns {Complex} */
  at(contacts, at) {
    return this.spread(this.seenAt(contacts, at), contacts.length);
  }

  /** The same at the nodes; a point under a rigid disc moves with it. @param {number[][]} contacts @param {number[]} at @returns {Complex} */
  seenAt(contacts, at) {
    const { order, nodes, radius } = this, c = order.length, m = contacts.length, size = m * c, [coefficients, motion] = this.solved(contacts), out = zeros(nodes * m);
    const under = this.pressed ? -1 : contacts.findIndex((p) => Math.hypot(at[0] - p[0], at[1] - p[1]) <= radius);
    if (under >= 0) {
      for (let n = 0; n < nodes; n++) for (let i = 0; i < m; i++) { out.re[n * m + i] = motion.re[(n * m + under) * m + i]; out.im[n * m + i] = motion.im[(n * m + under) * m + i]; }
      return out;
    }
    const whole = zeros(nodes * size);
    contacts.forEach((p, i) => {
      const x = at[0] - p[0], y = at[1] - p[1], far = Math.max(Math.hypot(x, y), radius + this.clear), angle = Math.atan2(y, x), { first, weight } = this.weights(far, this.away, radius, SIX);
      for (let q = 0; q < c; q++) {
        const [u, v] = [Math.cos(order[q] * angle), Math.sin(order[q] * angle)];
        for (let n = 0; n < nodes; n++) {
          let re = 0, im = 0;
          for (const k of SIX) { const from = ((first + k) * nodes + n) * c + q; re += weight[k] * this.points.re[from]; im += weight[k] * this.points.im[from]; }
          whole.re[n * size + i * c + q] = re * u - im * v; whole.im[n * size + i * c + q] = re * v + im * u;
        }
      }
    });
    for (let n = 0; n < nodes; n++) this.row(whole, n * size, size, coefficients, n * size * m, m, out, n * m);
    return out;
  }

  /** Channels of one disc with those of another (nodes x c x c), which lies (x, y) [m] from it. @param {number} x @param {number} y @returns {Complex} */
  pair(x, y) {
    const { order, nodes, discs, radius } = this, c = order.length, upper = (c * (c + 1)) / 2, out = zeros(nodes * c * c), angle = Math.atan2(y, x);
    const { first, weight } = this.weights(Math.hypot(x, y), this.apart, 2 * radius, SIX);
    for (let p = 0, u = 0; p < c; p++) for (let q = p; q < c; q++, u++) {
      const turn = order[p] + order[q], [s, t] = [Math.cos(turn * angle), Math.sin(turn * angle)], sign = turn % 2 ? -1 : 1; // seen from the other one
      for (let n = 0; n < nodes; n++) {
        let re = 0, im = 0;
        for (const k of SIX) { const from = ((first + k) * nodes + n) * upper + u; re += weight[k] * discs.re[from]; im += weight[k] * discs.im[from]; }
        const a = re * s - im * t, b = re * t + im * s, one = (n * c + p) * c + q, other = (n * c + q) * c + p;
        out.re[one] = a; out.im[one] = b;
        if (p !== q) { out.re[other] = sign * a; out.im[other] = sign * b; }
      }
    }
    return out;
  }

  /** Weights of a polynomial through the table's radii around a distance [m]. @param {number} far @param {number[]} ends @param {number} edge
   * @param {number[]} taken as many radii @returns {{first: number, weight: number[]}} */
  weights(far, ends, edge, taken) {
    const [low, high] = ends.map((d) => Math.sqrt(d - edge)), step = ((Math.sqrt(Math.max(far - edge, 0)) - low) / (high - low)) * (this.radii - 1), n = taken.length;
    const first = Math.min(Math.max(Math.floor(step) - (n / 2 - 1), 0), this.radii - n), x = step - first;
    return { first, weight: taken.map((j) => taken.reduce((p, k) => (k === j ? p : (p * (x - k)) / (j - k)), 1)) };
  }

  /** From the nodes to the bins. @param {Complex} values (nodes x width) @param {number} width @returns {Complex} (bins x width) */
  spread(values, width) {
    const { bins, nodes, onBins } = this, out = zeros(bins * width);
    for (let b = 0; b < bins; b++) for (let n = 0; n < nodes; n++) {
      const w = onBins[b * nodes + n], to = b * width, from = n * width;
      if (w) for (let i = 0; i < width; i++) { out.re[to + i] += w * values.re[from + i]; out.im[to + i] += w * values.im[from + i]; }
    }
    return out;
  }

  /** Motion per newton (bins x (radii + 1)) under a disc and at the table's radii from one alone, for the picture. @returns {Complex} */
  radial() {
    if (this.fields) return this.fields;
    const { nodes, radii, order } = this, c = order.length, width = radii + 1, all = zeros(nodes * width);
    for (let n = 0; n < nodes; n++) {
      all.re[n * width] = this.own.re[n * c * c]; all.im[n * width] = this.own.im[n * c * c];
      for (let r = 0; r < radii; r++) { all.re[n * width + r + 1] = this.points.re[(r * nodes + n) * c]; all.im[n * width + r + 1] = this.points.im[(r * nodes + n) * c]; }
    }
    this.fields = this.spread(all, width);
    return this.fields;
  }

  /** Which radial signals make the motion of each vertex. @param {number[][]} contacts @param {Float32Array} rest [mm] @returns {Net} */
  net(contacts, rest) {
    const n = rest.length / 3, slots = FOUR.length * contacts.length, at = new Uint16Array(n * slots), weight = new Float32Array(n * slots), width = this.radii + 1;
    for (let v = 0; v < n; v++) contacts.forEach((p, i) => {
      const far = Math.hypot(rest[3 * v] / 1e3 - p[0], rest[3 * v + 1] / 1e3 - p[1]), to = v * slots + FOUR.length * i;
      if (far <= this.radius) { at[to] = i * width; weight[to] = 1; return; }
      if (far > this.away[1]) return;
      const found = this.weights(Math.max(far, this.away[0]), this.away, this.radius, FOUR);
      FOUR.forEach((k) => { at[to + k] = i * width + 1 + found.first + k; weight[to + k] = found.weight[k]; });
    });
    return { at, weight, slots, k: contacts.length * width };
  }
}

/** Values at a Chebyshev rule's nodes, falling, in the root of the frequency: weights (bins x nodes) of each at the bins.
 * @param {Float64Array} frequency [Hz] @param {number[]} ends [rad/s] @param {number} nodes */
function between(frequency, ends, nodes) {
  const [low, high] = ends.map(Math.sqrt), out = new Float64Array(frequency.length * nodes), last = nodes - 1;
  frequency.forEach((f, b) => {
    const x = (2 * (Math.sqrt(2 * Math.PI * f) - low)) / (high - low) - 1, part = Array.from({ length: nodes }, (_, j) => ((j % 2 ? -1 : 1) * (j === 0 || j === last ? 0.5 : 1)) / (x - Math.cos((Math.PI * j) / last)));
    const hit = part.findIndex((v) => !Number.isFinite(v)), sum = part.reduce((s, v) => s + v, 0);
    part.forEach((v, j) => { out[b * nodes + j] = hit >= 0 ? Number(j === hit) : v / sum; });
  });
  return out;
}

/**
 * The skin's compliance for discs anywhere on a library's patch. As Python's workbench/places.py.
 *
 * @typedef {import("./numeric.js").Complex} Complex
 * @typedef {import("./device.js").Port} Port
 */

const CLOSEST = 2.1; // radii between the middles of two discs

/** Matern's of 7/2 between places and one more. @param {number} scale [1/m] @param {Float64Array} xy @param {number[]} at [m] */
function kernel(scale, xy, at) {
  return Float64Array.from({ length: xy.length / 2 }, (_, i) => {
    const s = scale * Math.hypot(xy[2 * i] - at[0], xy[2 * i + 1] - at[1]);
    return (1 + s + 0.4 * s * s + (s * s * s) / 15) * Math.exp(-s);
  });
}

export class Places {
  /** @param {any} model packed */
  constructor(model) {
    const [xy, flat, position, axis, points, inverse] = ["xy", "flat", "position", "axis", "points", "inverse"].map((k) => /** @type {Float64Array} */ (unpack(model[k])));
    this.xy = xy; this.flat = flat; this.position = position; this.axis = axis; this.points = points; this.inverse = inverse;
    this.n = xy.length / 2;
    this.m = points.length / 2;
    /** Of the patch, along and across [m]. @type {[number, number]} */
    this.half = model.half;
    this.radius = model.radius;
    this.reach = model.reach;
    this.scale = model.scale;
    this.pressed = model.pressed;
    this.layered = unpackComplex(model.layered);
    this.radii = model.layered.shape[1];
    this.bins = model.layered.shape[0];
    this.left = unpackComplex(model.left);
    this.rank = model.left.shape[1];
    this.right = unpackComplex(model.right);
    const { near } = model;
    this.near = { xy: /** @type {Float64Array} */ (unpack(near.xy)), left: unpackComplex(near.left), alpha: unpackComplex(near.alpha), scale: near.scale, rank: near.left.shape[1] };
  }

  /** Weights (n,) of the places at another one. @param {number[]} at [m] */
  weights(at) {
    const { n, inverse } = this, k = kernel(this.scale, this.xy, at), out = new Float64Array(n);
    for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) out[i] += inverse[i * n + j] * k[j];
    return out;
  }

  /** Along the skin (u, v) [m] of a place seen from above. @param {number[]} at @param {Float64Array} weights @returns {number[]} */
  along(at, weights) {
    return this.between(this.flat, weights, true).map((v, c) => v + at[c]);
  }

  /** Values (n x c) of the places at another, or of what they differ from its coordinates. @param {Float64Array} values @param {Float64Array} weights @param {boolean} [less] @returns {number[]} */
  between(values, weights, less = false) {
    const c = values.length / this.n, mean = new Array(c).fill(0), { xy } = this;
    const value = (/** @type {number} */ i, /** @type {number} */ j) => values[i * c + j] - (less && j < 2 ? xy[2 * i + j] : 0);
    for (let i = 0; i < this.n; i++) for (let j = 0; j < c; j++) mean[j] += value(i, j) / this.n;
    return mean.map((middle, j) => { let sum = middle; for (let i = 0; i < this.n; i++) sum += weights[i] * (value(i, j) - middle); return sum; });
  }

  /** Where a disc at (x, y), seen from above, stands on the limb. @param {number[]} at [m] @param {Port} port @returns {Port} */
  port(at, port) {
    const w = this.weights(at), axis = this.between(this.axis, w), size = Math.hypot(...axis);
    const position = this.between(this.position, w, true).map((v, c) => v + (at[c] ?? 0));
    return { ...port, position, axis: axis.map((v) => v / size) };
  }

  /** Why discs cannot stand there; empty if they can. @param {number[][]} contacts @param {string[]} names @returns {string} */
  refusal(contacts, names) {
    const { half, radius, pressed, m, points } = this, flat = contacts.map((at) => this.along(at, this.weights(at)));
    for (const [k, [u, v]] of flat.entries()) {
      if (Math.abs(u) + radius > half[0] + 1e-9 || Math.abs(v) + radius > half[1] + 1e-9) return `${names[k]} would leave the library's patch of ${(2e3 * half[0]).toFixed(0)} x ${(2e3 * half[1]).toFixed(0)} mm: nothing is known there`;
      for (let j = 0; j < k; j++) {
        const apart = Math.hypot(contacts[k][0] - contacts[j][0], contacts[k][1] - contacts[j][1]);
        if (apart < CLOSEST * radius) return `${names[k]} and ${names[j]} would stand ${(1e3 * apart).toFixed(1)} mm apart; discs of this size need ${(1e3 * CLOSEST * radius).toFixed(1)} mm`;
      }
      for (let p = 0; pressed && p < m; p++) if (Math.hypot(u - points[2 * p], v - points[2 * p + 1]) < radius) return `${names[k]} would press on point ${p + 1}, of which the library knows nothing then`;
    }
    return "";
  }

  /** Compliance (bins x (contacts + points) x contacts) [m/N] of discs at `contacts`. @param {number[][]} contacts @returns {Complex} */
  skin(contacts) {
    const c = contacts.length, { m, bins } = this, ports = c + m, out = zeros(bins * ports * c);
    const weights = contacts.map((at) => this.weights(at)), flat = weights.map((w, k) => this.along(contacts[k], w));
    const put = (/** @type {number} */ row, /** @type {number} */ column, /** @type {Complex} */ values) => {
      for (let f = 0; f < bins; f++) { out.re[(f * ports + row) * c + column] += values.re[f]; out.im[(f * ports + row) * c + column] += values.im[f]; }
    };
    for (let k = 0; k < c; k++) {
      const share = this.shares(weights[k]);
      for (let j = 0; j < c; j++) {
        // what one sends to the other and back is the same: half of each
        const one = this.seen(share, weights[j], Math.hypot(flat[j][0] - flat[k][0], flat[j][1] - flat[k][1])), half = { re: one.re.map((v) => v / 2), im: one.im.map((v) => v / 2) };
        put(j, k, half); put(k, j, half);
      }
      const felt = this.felt(contacts[k]), { rank, left } = this.near;
      for (let p = 0; p < m; p++) put(c + p, k, this.sum(left, rank, felt, m, p, this.layeredAt(Math.hypot(this.points[2 * p] - flat[k][0], this.points[2 * p + 1] - flat[k][1]))));
    }
    return out;
  }

  /** Normal motion per newton (bins x places x contacts) at the places themselves, for the picture. @param {number[][]} contacts
   * @returns {Complex} */
  picture(contacts) {
    const c = contacts.length, { n, bins } = this, out = zeros(bins * n * c);
    contacts.forEach((at, k) => {
      const w = this.weights(at), flat = this.along(at, w), share = this.shares(w);
      for (let i = 0; i < n; i++) {
        const one = this.seen(share, i, Math.hypot(this.flat[2 * i] - flat[0], this.flat[2 * i + 1] - flat[1]));
        for (let f = 0; f < bins; f++) { out.re[(f * n + i) * c + k] = one.re[f]; out.im[(f * n + i) * c + k] = one.im[f]; }
      }
    });
    return out;
  }

  /** The difference's parts (rank x points) that the grid's points feel of a disc. @param {number[]} at @returns {Complex} */
  felt(at) {
    const { near: { xy, alpha, scale, rank }, m } = this, k = kernel(scale, xy, at), out = zeros(rank * m);
    for (let r = 0; r < rank; r++) for (let i = 0; i < k.length; i++) for (let p = 0, from = (r * k.length + i) * m; p < m; p++, from++) {
      out.re[r * m + p] += k[i] * alpha.re[from];
      out.im[r * m + p] += k[i] * alpha.im[from];
    }
    return out;
  }

  /** The difference's parts (rank x places) for a disc of these weights. @param {Float64Array} weights @returns {Complex} */
  shares(weights) {
    const { n, rank, right } = this, columns = n, out = zeros(rank * columns);
    for (let r = 0; r < rank; r++) for (let i = 0; i < n; i++) {
      const from = (r * n + i) * columns, to = r * columns, w = weights[i];
      for (let q = 0; q < columns; q++) { out.re[to + q] += w * right.re[from + q]; out.im[to + q] += w * right.im[from + q]; }
    }
    return out;
  }

  /** Motion (bins,) at a place, or at a mixture of the places, `away` [m] from a disc of these shares.
   * @param {Complex} share @param {number | Float64Array} where @param {number} away @returns {Complex} */
  seen(share, where, away) {
    const { n, rank, left } = this, out = this.layeredAt(away);
    if (typeof where === "number") return this.sum(left, rank, share, n, where, out);
    const parts = zeros(rank);
    for (let r = 0; r < rank; r++) for (let i = 0; i < n; i++) { parts.re[r] += where[i] * share.re[r * n + i]; parts.im[r] += where[i] * share.im[r * n + i]; }
    return this.sum(left, rank, parts, 1, 0, out);
  }

  /** Add left (bins x rank) times a column of parts (rank x columns) to `out`. @param {Complex} left @param {number} rank
   * @param {Complex} parts @param {number} columns @param {number} column @param {Complex} out @returns {Complex} */
  sum(left, rank, parts, columns, column, out) {
    for (let f = 0; f < this.bins; f++) for (let r = 0; r < rank; r++) {
      const a = left.re[f * rank + r], b = left.im[f * rank + r], x = parts.re[r * columns + column], y = parts.im[r * columns + column];
      out.re[f] += a * x - b * y;
      out.im[f] += a * y + b * x;
    }
    return out;
  }

  /** The layered model of one disc, a cubic through four radii. @param {number} away [m] @returns {Complex} (bins,) */
  layeredAt(away) {
    const { bins, radii, radius, reach, layered } = this, out = zeros(bins), inside = away < radius;
    const step = Math.sqrt(reach - radius) / (radii - 2), at = Math.min(Math.sqrt(Math.max(away - radius, 0)) / step, radii - 2), first = Math.min(Math.max(Math.floor(at) - 1, 0), radii - 5), x = at - first;
    const weight = [0, 1, 2, 3].map((j) => [0, 1, 2, 3].reduce((p, k) => (k === j ? p : (p * (x - k)) / (j - k)), 1));
    for (let f = 0; f < bins; f++) {
      if (inside) { out.re[f] = layered.re[f * radii]; out.im[f] = layered.im[f * radii]; continue; }
      for (let j = 0; j < 4; j++) { out.re[f] += weight[j] * layered.re[f * radii + 1 + first + j]; out.im[f] += weight[j] * layered.im[f * radii + 1 + first + j]; }
    }
    return out;
  }
}
