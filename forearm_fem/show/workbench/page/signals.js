/** Signals: the wavelet, S of what moves, and its interval. */
import { toSpectrum, toTime, unpack, zeros } from "./numeric.js";
import { aim, respond } from "./rendering.js";

/**
 * The stimulus and what S is taken over. As Python's rendering/wavelet.py.
 *
 * @typedef {{rate: number, n: number}} Record
 * @typedef {{samples: Float64Array, name: string, kind: "ricker" | "burst" | "file" | "own", peak?: number}} Wavelet  a "file" is the run's
 */
const HEARD = 1e-3, ROOM = 0.05;

/** Time [s] of sample j. @param {Record} record @param {number} j */
export function timeOf(record, j) {
  return (j - Math.floor(record.n / 2)) / record.rate;
}

/** A (1 - s^2) exp(-s^2 / 2), s = t sqrt(2) pi peak. @param {number} peak [Hz] @param {Record} record @returns {Wavelet} */
export function ricker(peak, record) {
  if (!(peak > 0) || 3 * peak > record.rate / 2 || 6 / peak > record.n / record.rate) {
    const [low, high] = [(6 * record.rate) / record.n, record.rate / 6];
    throw new RangeError(`a Ricker wavelet of this record peaks between ${low.toFixed(1)} and ${high.toFixed(0)} Hz, got ${peak}`);
  }
  const samples = Float64Array.from({ length: record.n }, (_, j) => {
    const s = timeOf(record, j) * Math.SQRT2 * Math.PI * peak;
    return (1 - s * s) * Math.exp((-s * s) / 2);
  });
  return { samples, name: `Ricker ${peak} Hz`, kind: "ricker", peak };
}

/** A sine of some cycles under a half cosine squared. @param {number} frequency [Hz] @param {number} cycles
 * @param {Record} record @returns {Wavelet} */
export function burst(frequency, cycles, record) {
  const length = cycles / frequency;
  if (!(frequency > 0) || frequency > record.rate / 4 || !(cycles >= 1) || length > record.n / record.rate / 2) {
    throw new RangeError(`a burst needs 1 cycle or more, up to ${(record.rate / 4).toFixed(0)} Hz and half the record of ${record.n / record.rate} s`);
  }
  const samples = Float64Array.from({ length: record.n }, (_, j) => {
    const t = timeOf(record, j);
    return Math.abs(t) < length / 2 ? Math.cos((Math.PI * t) / length) ** 2 * Math.cos(2 * Math.PI * frequency * t) : 0;
  });
  return { samples: placed(samples, record), name: `burst ${frequency} Hz, ${cycles} cycles`, kind: "burst" };
}

/** Samples set into the record, their largest at t = 0 and of size 1. @param {Float64Array} samples @param {Record} record
 * @returns {Float64Array} */
export function placed(samples, record) {
  let peak = 0;
  samples.forEach((v, j) => { if (Math.abs(v) > Math.abs(samples[peak])) peak = j; });
  const out = new Float64Array(record.n), shift = Math.floor(record.n / 2) - peak + record.n;
  samples.forEach((v, j) => { out[(j + shift) % record.n] = v / Math.abs(samples[peak]); });
  return out;
}

/** Start and end [s]: the samples above 1e-3 of the largest and 50 ms on either side. @param {Float64Array} samples
 * @param {Record} record @returns {[number, number]} */
export function windowOf(samples, record) {
  const most = samples.reduce((a, v) => Math.max(a, Math.abs(v)), 0);
  let first = record.n - 1, last = 0;
  samples.forEach((v, j) => { if (Math.abs(v) > HEARD * most) { first = Math.min(first, j); last = j; } });
  const start = Math.floor(1e3 * (timeOf(record, first) - ROOM)) / 1e3, end = Math.ceil(1e3 * (timeOf(record, last) + ROOM)) / 1e3;
  return [Math.max(start, timeOf(record, 0)), Math.min(end, timeOf(record, record.n - 1))];
}

/**
 * Signal strength S and the drives' limits. As Python's metrics/strength.py and rendering/limits.py.
 *
 * @typedef {import("./signals.js").Record} Record
 */

/** Mean |u| over the window [s], or all samples if null. @param {Float64Array} u @param {Record} record
 * @param {[number, number] | null} window */
export function area(u, record, window) {
  let sum = 0, count = 0;
  for (let j = 0; j < u.length; j++) {
    const t = timeOf(record, j);
    if (window && (t < window[0] || t > window[1])) continue;
    sum += Math.abs(u[j]);
    count++;
  }
  return sum / count;
}

/** S (eq. 9 of de Vlam 2022): the target's area over the mean of the others that are known.
 * @param {number[]} areas @param {number} target */
export function strengthOf(areas, target) {
  const others = areas.filter((a, i) => i !== target && Number.isFinite(a));
  if (!Number.isFinite(areas[target]) || !others.length) return NaN;
  const mean = others.reduce((a, b) => a + b, 0) / others.length;
  return mean > 0 ? areas[target] / mean : areas[target] > 0 ? Infinity : NaN;
}

/** Peak [V], rms [V] and mean power [W] in the coil over the record. @param {Float64Array} signal @param {number} resistance */
export function levels(signal, resistance) {
  let peak = 0, square = 0;
  for (const v of signal) { peak = Math.max(peak, Math.abs(v)); square += v * v; }
  square /= signal.length;
  return { peak, rms: Math.sqrt(square), power: square / resistance };
}

/**
 * How far S may be off: S of copies of G that err as G is stated to. As Python's rendering/interval.py, with random numbers
 * of its own.
 *
 * @typedef {import("./numeric.js").Complex} Complex
 * @typedef {import("./experiment.js").Experiment} Experiment
 * @typedef {import("./rendering.js").Placed} Placed
 * @typedef {import("./signals.js").Record} Record
 * @typedef {(frequency: Float64Array, entries: number) => Complex} Noise  (frequency x entries), of unit variance
 * @typedef {{whole: boolean, size: Float64Array}} Source  e(f) of the whole G, or errors of (frequency x entries)
 * @typedef {{rows: number[], index: Int32Array, record: Record, samples: Float64Array}} Short  a shorter record and its bins
 */

const DRAWS = 12, CORRELATION = 50, WAVES = 64; // [Hz] over which errors are smooth
const HALF_WIDTH = 1.5, LEAST_SPAN = 4; // rms changes of log S (decision on the interval of S); windows that the record holds

/** Why no interval can be drawn; empty if one can. @param {any} content of the page @param {any[]} [errors] of G now @returns {string} */
export function whyNone(content, errors = content.errors) {
  if (errors.every((/** @type {any} */ e) => e.source === "bridging")) return "this G states no errors"; // of its own
  const lost = errors.filter((/** @type {any} */ e) => e.band === null).map((/** @type {any} */ e) => e.source);
  if (lost.length) return `the error by ${lost.join(", ")} is unknown`;
  return content.deviates ? "the scatter between a measurement's sweeps is not drawn here" : "";
}

/**
 * Half widths of the interval of log S, a row of outputs for each method; yields in between, so that the page stays awake.
 *
 * Each draw adds independent smooth noise of every source, as large as it states at each pair of ports or e(f) max|G|, and aims anew; no target gets less than the rms of
 * its method over all. A changed device's G is taken to err by the same shares as the run's.
 * @param {Experiment} experiment @param {import("./rendering.js").Method[]} methods @param {Noise} noise
 * @returns {Generator<undefined, number[][], undefined>}
 */
export function* halves(experiment, methods, noise) {
  const { settings } = experiment, short = shorter(experiment), outputs = experiment.outputs.map((_, i) => i);
  const frequency = Float64Array.from(short.rows, (b) => experiment.frequency[b]);
  const playing = thinned(experiment.transfer(), short.rows), believed = settings.calibrated ? playing : thinned(experiment.believed(), short.rows);
  const sources = experiment.errors.map((/** @type {any} */ e) => sourceOf(e, short.rows));
  const square = methods.map(() => outputs.map(() => 0));
  /** @type {number[][]} */
  const base = [];
  for (let draw = -1; draw < DRAWS; draw++) {
    const shares = zeros(draw < 0 ? 0 : playing.values.re.length);
    if (draw >= 0) for (const source of sources) {
      add(shares, source, noise(frequency, shares.re.length / frequency.length), frequency.length);
      yield;
    }
    const played = draw < 0 ? playing : perturbed(playing, shares), aimed = draw < 0 ? believed : played && believed === playing ? played : perturbed(believed, shares);
    const known = new Map();
    for (const [i, method] of methods.entries()) for (const target of outputs) {
      const s = strengthIn(experiment, short, method, target, aimed, played, known);
      if (draw < 0) (base[i] ??= [])[target] = s;
      else square[i][target] += Math.log(s / base[i][target]) ** 2 / DRAWS;
      yield;
    }
  }
  return square.map((row) => {
    const usual = row.filter(Number.isFinite), mean = usual.reduce((a, b) => a + b, 0) / usual.length;
    return row.map((v) => HALF_WIDTH * Math.sqrt(Math.max(v, mean)));
  });
}

/** S of one method at one target on the short record; NaN where the method reaches nothing. @param {Experiment} experiment
 * @param {Short} short @param {import("./rendering.js").Method} method @param {number} target @param {Placed} aimed
 * @param {Placed} played @param {Map<string, any>} known */
function strengthIn(experiment, short, method, target, aimed, played, known) {
  const { rule, amplitude } = experiment.settings, all = toSpectrum(short.samples, short.record.rate);
  const wavelet = { re: Float64Array.from(short.index, (k) => all.re[k]), im: Float64Array.from(short.index, (k) => all.im[k]) };
  try {
    const found = aim(method, aimed, target, wavelet, { zeros: experiment.zerosOf(method, target), rule, amplitude }, known);
    const { spectra, lost } = respond(played, found.spectrum), window = experiment.window();
    const moves = toTime(spectra, played.outputs.length, short.index, short.record.n, short.record.rate);
    return strengthOf(moves.map((u, p) => (lost[p] > 0.5 ? NaN : area(u, short.record, window))), target);
  } catch {
    return NaN;
  }
}

/** The shortest record that holds four windows about t = 0, the wavelet's too, a divisor of the page's: a draw on a quarter of the bins costs a quarter.
 * @param {Experiment} experiment @returns {Short} */
export function shorter(experiment) {
  const { record, index, settings } = experiment, { samples } = settings.wavelet, window = experiment.window(), whole = record.n / record.rate;
  const span = window ? 2 * Math.max(...[...window, ...windowOf(samples, record)].map(Math.abs)) : whole, most = Math.floor(whole / (LEAST_SPAN * span));
  let step = 1;
  for (let m = 2; m <= most; m++) if (record.n % (2 * m) === 0) step = m;
  const rows = Array.from(index.keys()).filter((b) => index[b] % step === 0), n = record.n / step, from = Math.floor(record.n / 2) - Math.floor(n / 2);
  const cut = samples.subarray(from, from + n), largest = (/** @type {Float64Array} */ a) => a.reduce((m, v) => Math.max(m, Math.abs(v)), 0);
  if (step === 1 || rows.length < 2 || largest(cut) < largest(samples)) return { rows: Array.from(index.keys()), index, record, samples };
  return { rows, index: Int32Array.from(rows, (b) => index[b] / step), record: { rate: record.rate, n }, samples: cut };
}

/** G on some of its bins. @param {Placed} g @param {number[]} rows @returns {Placed} */
function thinned(g, rows) {
  const size = g.outputs.length * g.inputs.length, values = zeros(rows.length * size), valid = g.valid && new Uint8Array(rows.length * size);
  rows.forEach((b, k) => {
    values.re.set(g.values.re.subarray(b * size, (b + 1) * size), k * size);
    values.im.set(g.values.im.subarray(b * size, (b + 1) * size), k * size);
    valid?.set(/** @type {Uint8Array} */ (g.valid).subarray(b * size, (b + 1) * size), k * size);
  });
  return { ...g, values, valid, error: Float64Array.from(rows, (b) => g.error[b]), bins: rows.length };
}

/** How much a stated error is on some bins: of each pair where it tells pairs apart. @param {any} stated
 * @param {number[]} rows @returns {Source} */
function sourceOf(stated, rows) {
  const all = unpack(stated.pairs ?? stated.size), entries = all.length / unpack(stated.size).length;
  const size = Float64Array.from({ length: rows.length * entries }, (_, x) => all[rows[Math.floor(x / entries)] * entries + (x % entries)]);
  return { whole: !stated.pairs, size };
}

/** @param {Complex} shares to which is added @param {Source} source @param {Complex} noise whose largest value at each
 * frequency is all of e(f) @param {number} bins */
function add(shares, { whole, size }, noise, bins) {
  const entries = shares.re.length / bins;
  for (let b = 0; b < bins; b++) {
    let most = whole ? 0 : 1;
    if (whole) for (let x = b * entries; x < (b + 1) * entries; x++) most = Math.max(most, Math.hypot(noise.re[x], noise.im[x]));
    for (let x = b * entries; x < (b + 1) * entries; x++) {
      const s = (whole ? size[b] : size[x]) / most;
      shares.re[x] += s * noise.re[x];
      shares.im[x] += s * noise.im[x];
    }
  }
}

/** G and `shares` of its largest entry at each frequency. @param {Placed} g @param {Complex} shares @returns {Placed} */
function perturbed(g, shares) {
  const size = g.values.re.length / g.bins, values = { re: g.values.re.slice(), im: g.values.im.slice() };
  for (let b = 0; b < g.bins; b++) {
    let most = 0;
    for (let x = b * size; x < (b + 1) * size; x++) if (!g.valid || g.valid[x]) most = Math.max(most, Math.hypot(values.re[x], values.im[x]));
    for (let x = b * size; x < (b + 1) * size; x++) { values.re[x] += most * shares.re[x]; values.im[x] += most * shares.im[x]; }
  }
  return { ...g, values };
}

/** Noise of its own from a number: sums of 64 waves, normal in strength and in how fast they turn. @param {number} seed
 * @returns {Noise} */
export function noiseOf(seed) {
  const normal = normals(seed);
  return (frequency, entries) => {
    const out = zeros(frequency.length * entries), re = new Float64Array(WAVES * entries), im = new Float64Array(WAVES * entries);
    const tau = Float64Array.from({ length: WAVES }, () => normal() / CORRELATION);
    const unit = 1 / Math.sqrt(2 * WAVES); // of variance
    for (let x = 0; x < re.length; x++) { re[x] = unit * normal(); im[x] = unit * normal(); }
    for (let f = 0; f < frequency.length; f++) {
      for (let w = 0; w < WAVES; w++) {
        const c = Math.cos(frequency[f] * tau[w]), s = Math.sin(frequency[f] * tau[w]);
        for (let e = 0; e < entries; e++) {
          const a = re[w * entries + e], b = im[w * entries + e];
          out.re[f * entries + e] += c * a - s * b;
          out.im[f * entries + e] += c * b + s * a;
        }
      }
    }
    return out;
  };
}

/** Normal numbers (Marsaglia's polar method) of a 32-bit generator. @param {number} seed @returns {() => number} */
function normals(seed) {
  let state = seed >>> 0, kept = NaN;
  const even = () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(state ^ (state >>> 15), state | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
  return () => {
    if (!Number.isNaN(kept)) { const v = kept; kept = NaN; return v; }
    for (;;) {
      const a = 2 * even() - 1, b = 2 * even() - 1, r = a * a + b * b;
      if (r === 0 || r >= 1) continue;
      const size = Math.sqrt((-2 * Math.log(r)) / r);
      kept = b * size;
      return a * size;
    }
  };
}
