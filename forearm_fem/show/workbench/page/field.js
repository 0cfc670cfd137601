/**
 * The skin's motion between the ports: shapes times amplitudes that follow the drives.
 *
 * @typedef {import("./numeric.js").Complex} Complex
 * @typedef {{name: string, rest: Float32Array, normals: Float32Array, faces: Uint16Array | Uint32Array, shapes: Float32Array,
 *   components: number, tissue: Uint8Array | null, tissues: string[]}} Surface  lengths in mm
 * @typedef {import("./moves.js").Net} Net
 * @typedef {{steps: Float32Array, count: number, first: number, rate: number, k: number, net: Net | null}} Track  amplitudes
 *   (count x k) [m], from `first` [s]: of the surfaces' shapes, or of the signals that a net joins at each vertex
 */
import { toTime, unpack, unpackAmplitudes, unpackShapes, zeros } from "./numeric.js";

const PER_CYCLE = 8;
const INSTANTS = 96; // of a passage: two to a cycle of the highest frequency that carries any energy to speak of

export class Field {
  /** @param {any} content packed @param {number} inputs */
  constructor(content, inputs) {
    /** @type {Surface[]} */
    this.surfaces = content.surfaces.map((/** @type {any} */ s) => ({
      name: s.name, rest: unpack(s.rest), normals: unpack(s.normals), faces: unpack(s.faces), shapes: unpackShapes(s.shapes),
      components: s.shapes.values.shape[1], tissue: s.tissue && unpack(s.tissue), tissues: s.tissues,
    }));
    /** @type {Complex | null} */
    this.amplitudes = content.amplitudes && unpackAmplitudes(content.amplitudes);
    this.k = content.surfaces[0].shapes.values.shape[2];
    this.inputs = inputs;
    /** Tables for discs anywhere, if the skin is flat. @type {import("./moves.js").Anywhere | null} */
    this.anywhere = null;
    this.words = content.words;
    this.error = content.error;
  }

  get skin() {
    return this.surfaces[0];
  }

  /** Whether motion is known between the points. */
  get everywhere() {
    return Boolean(this.amplitudes || this.anywhere);
  }

  /** The vertex of the skin nearest to a place seen from above [mm], and how far it is. @param {number} x @param {number} y */
  below(x, y) {
    const { rest, normals } = this.skin;
    let vertex = -1, away = Infinity;
    for (let v = 0; v < rest.length / 3; v++) {
      const d = Math.hypot(rest[3 * v] - x, rest[3 * v + 1] - y);
      if (normals[3 * v + 2] > 0 && d < away) { vertex = v; away = d; }
    }
    return { vertex, away };
  }

  /** Normal motion at a vertex of the skin per newton on each contact (bins x contacts), or null. @param {number} vertex
   * @returns {Complex | null} */
  reach(vertex) {
    const { amplitudes, k, inputs } = this;
    if (!amplitudes) return null;
    const row = this.normalShapes(vertex), bins = amplitudes.re.length / k / inputs, out = zeros(bins * inputs);
    for (let f = 0; f < bins; f++) for (let j = 0; j < k; j++) for (let a = 0; a < inputs; a++) {
      out.re[f * inputs + a] += row[j] * amplitudes.re[(f * k + j) * inputs + a];
      out.im[f * inputs + a] += row[j] * amplitudes.im[(f * k + j) * inputs + a];
    }
    return out;
  }

  /** @param {number} vertex @returns {Float64Array} the shapes' part along the normal (k,) */
  normalShapes(vertex) {
    const { shapes, normals, components } = this.skin, { k } = this, out = new Float64Array(k);
    for (let c = 0; c < components; c++) {
      const weight = components === 1 ? 1 : normals[3 * vertex + c], at = (vertex * components + c) * k;
      for (let j = 0; j < k; j++) out[j] += weight * shapes[at + j];
    }
    return out;
  }

  /**
   * Amplitudes over time for forces per drive (bins x contacts x inputs) and drives (bins x inputs).
   * @param {Complex | null} force @param {Complex} sent @param {Complex} spectra of the points, where nothing else is known
   * @param {Int32Array} index @param {number} duration [s] of the record @param {[number, number]} span [s] to keep
   * @param {number[][] | null} [contacts] where the actuators stand, on flat skin @returns {Track}
   */
  track(force, sent, spectra, index, duration, span, contacts) {
    const net = this.anywhere && contacts ? this.anywhere.net(contacts, this.skin.rest) : null, k = net ? net.k : this.k;
    const driven = net && force ? this.radiated(force, sent, index.length) : this.amplitudes && force ? this.driven(force, sent, index.length) : this.followed(spectra, index.length);
    const n = fast(PER_CYCLE * (index[index.length - 1] + 1)), rate = n / duration;
    const rows = toTime(driven, k, index, n, rate), centre = Math.floor(n / 2);
    const first = Math.max(0, Math.floor(span[0] * rate) + centre - 1), last = Math.min(n - 1, Math.ceil(span[1] * rate) + centre + 2);
    const count = last - first + 1, steps = new Float32Array(count * k);
    rows.forEach((row, j) => { for (let t = 0; t < count; t++) steps[t * k + j] = row[first + t]; });
    return { steps, count, first: (first - centre) / rate, rate, k, net };
  }

  /** What each disc alone sends out (bins x (contacts x radii)). @param {Complex} force @param {Complex} sent @param {number} bins @returns {Complex} */
  radiated(force, sent, bins) {
    const inputs = sent.re.length / bins, table = /** @type {import("./moves.js").Anywhere} */ (this.anywhere), field = table.radial(), width = table.radii + 1, k = inputs * width, out = zeros(bins * k);
    for (let f = 0; f < bins; f++) for (let c = 0; c < inputs; c++) {
      let re = 0, im = 0;
      for (let i = 0; i < inputs; i++) {
        const x = (f * inputs + c) * inputs + i, y = f * inputs + i;
        re += force.re[x] * sent.re[y] - force.im[x] * sent.im[y];
        im += force.re[x] * sent.im[y] + force.im[x] * sent.re[y];
      }
      for (let j = 0, from = f * width, to = f * k + c * width; j < width; j++, from++, to++) {
        out.re[to] = field.re[from] * re - field.im[from] * im;
        out.im[to] = field.re[from] * im + field.im[from] * re;
      }
    }
    return out;
  }

  /** @param {Complex} force @param {Complex} sent @param {number} bins @returns {Complex} */
  driven(force, sent, bins) {
    const { k, inputs } = this, a = /** @type {Complex} */ (this.amplitudes), out = zeros(bins * k);
    for (let f = 0; f < bins; f++) for (let c = 0; c < inputs; c++) {
      let re = 0, im = 0;
      for (let i = 0; i < inputs; i++) {
        const x = (f * inputs + c) * inputs + i, y = f * inputs + i;
        re += force.re[x] * sent.re[y] - force.im[x] * sent.im[y];
        im += force.re[x] * sent.im[y] + force.im[x] * sent.re[y];
      }
      for (let j = 0; j < k; j++) {
        const x = (f * k + j) * inputs + c;
        out.re[f * k + j] += a.re[x] * re - a.im[x] * im;
        out.im[f * k + j] += a.re[x] * im + a.im[x] * re;
      }
    }
    return out;
  }

  /** @param {Complex} spectra (bins x outputs), the first k of which are the points @param {number} bins @returns {Complex} */
  followed(spectra, bins) {
    const { k } = this, rows = spectra.re.length / bins, out = zeros(bins * k);
    for (let f = 0; f < bins; f++) for (let j = 0; j < k; j++) {
      out.re[f * k + j] = spectra.re[f * rows + j];
      out.im[f * k + j] = spectra.im[f * rows + j];
    }
    return out;
  }
}

/** The smallest product of 2s, 3s and 5s from n on. @param {number} n */
function fast(n) {
  for (let m = Math.ceil(n); ; m++) {
    let rest = m;
    for (const p of [2, 3, 5]) while (rest % p === 0) rest /= p;
    if (rest === 1) return m;
  }
}

/** Amplitudes (k,) at an instant, a cubic through four neighbours (Catmull and Rom). @param {Track} track @param {number} t [s]
 * @param {Float64Array} out */
export function amplitudesAt(track, t, out) {
  const { k } = track, at = (t - track.first) * track.rate, i = Math.min(Math.max(Math.floor(at), 1), track.count - 3), x = at - i;
  if (at < 0 || at > track.count - 1) return out.fill(0);
  const w = [((-x + 2) * x - 1) * x / 2, ((3 * x - 5) * x * x + 2) / 2, ((-3 * x + 4) * x + 1) * x / 2, ((x - 1) * x * x) / 2];
  for (let j = 0; j < k; j++) {
    let sum = 0;
    for (let s = 0; s < 4; s++) sum += w[s] * track.steps[(i - 1 + s) * k + j];
    out[j] = sum;
  }
  return out;
}

/**
 * Displacement (n x 3) and its part along the normal (n,) of some vertices of a surface [m], at three states at once: reading
 * the shapes costs more time than the sums.
 * @param {Surface} surface @param {Float64Array[]} states three rows of amplitudes (k,)
 * @param {{moved: Float32Array, u: Float32Array}[]} into one for each @param {ArrayLike<number>} vertices
 * @param {(Net | null | undefined)[]} [nets] of each state, on flat skin
 */
export function displace(surface, [a, b, c], into, vertices, nets) {
  if (nets?.some(Boolean)) return nets.forEach((net, s) => joined(surface, [a, b, c][s], into[s], vertices, net));
  const { shapes, normals, components } = surface, k = a.length;
  for (let i = 0; i < vertices.length; i++) {
    const v = vertices[i];
    let along = 0, bAlong = 0, cAlong = 0;
    for (let part = 0; part < components; part++) {
      const from = (v * components + part) * k, weight = components === 1 ? 1 : normals[3 * v + part];
      let p = 0, q = 0, r = 0;
      for (let j = 0; j < k; j++) {
        const s = shapes[from + j];
        p += s * a[j];
        q += s * b[j];
        r += s * c[j];
      }
      along += weight * p; bAlong += weight * q; cAlong += weight * r;
      if (components > 1) { const at = 3 * v + part; into[0].moved[at] = p; into[1].moved[at] = q; into[2].moved[at] = r; }
    }
    into[0].u[v] = along; into[1].u[v] = bAlong; into[2].u[v] = cAlong;
    if (components === 1) for (const { moved, u } of into) for (let part = 0; part < 3; part++) moved[3 * v + part] = u[v] * normals[3 * v + part];
  }
}

/** The same of one state whose signals a net joins. @param {Surface} surface @param {Float64Array} signals @param {{moved: Float32Array, u: Float32Array}} into
 * @param {ArrayLike<number>} vertices @param {Net | null | undefined} net */
function joined({ normals }, signals, into, vertices, net) {
  for (let i = 0; i < vertices.length; i++) {
    const v = vertices[i];
    let along = 0;
    if (net) for (let s = v * net.slots, end = s + net.slots; s < end; s++) along += net.weight[s] * signals[net.at[s]];
    into.u[v] = along;
    for (let part = 0; part < 3; part++) into.moved[3 * v + part] = along * normals[3 * v + part];
  }
}

/** Root mean square of the motion along the normal over a track (n,) [m], from some of its instants. @param {Surface} surface
 * @param {Track} track @returns {Float32Array} */
export function rmsOf(surface, track) {
  const n = surface.rest.length / 3, vertices = Uint32Array.from({ length: n }, (_, v) => v), sum = new Float32Array(n), rows = [0, 1, 2].map(() => new Float64Array(track.k));
  const states = rows.map(() => ({ moved: new Float32Array(3 * n), u: new Float32Array(n) }));
  for (let k = 0; k < INSTANTS; k += 3) {
    rows.forEach((row, i) => amplitudesAt(track, track.first + ((k + i + 0.5) / INSTANTS) * (track.count / track.rate), row));
    displace(surface, rows, states, vertices, rows.map(() => track.net));
    for (const { u } of states) for (let v = 0; v < n; v++) sum[v] += u[v] * u[v] / INSTANTS;
  }
  return sum.map(Math.sqrt);
}
