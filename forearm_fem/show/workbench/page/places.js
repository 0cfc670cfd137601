/**
 * The skin's compliance for discs anywhere on a library's patch. As Python's workbench/places.py.
 *
 * @typedef {import("./arrays.js").Complex} Complex
 * @typedef {import("./device.js").Port} Port
 */
import { unpack, unpackComplex, zeros } from "./arrays.js";

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
