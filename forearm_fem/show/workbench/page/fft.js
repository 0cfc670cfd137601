/**
 * Fourier transforms of any length: mixed radix for small prime factors, Bluestein's for large ones.
 *
 * @typedef {import("./arrays.js").Complex} Complex
 */
import { zeros } from "./arrays.js";

const LARGEST_PRIME = 31;

/** Forward transform X_k = sum_j x_j exp(-2 pi i j k / n) of one length. */
export class Fft {
  /** @param {number} n */
  constructor(n) {
    this.n = n;
    /** @type {number[]} */
    this.factors = [];
    let rest = n;
    for (let p = 2; rest > 1; ) {
      if (rest % 4 === 0) { this.factors.push(4); rest /= 4; }
      else if (rest % p === 0) { this.factors.push(p); rest /= p; }
      else if (p * p > rest) { this.factors.push(rest); rest = 1; }
      else p++;
    }
    this.cos = new Float64Array(n);
    this.sin = new Float64Array(n);
    for (let j = 0; j < n; j++) {
      this.cos[j] = Math.cos((2 * Math.PI * j) / n);
      this.sin[j] = -Math.sin((2 * Math.PI * j) / n);
    }
    /** @type {Bluestein | null} */
    this.chirp = Math.max(1, ...this.factors) > LARGEST_PRIME ? new Bluestein(n) : null;
    this.work = zeros(LARGEST_PRIME + 1);
  }

  /** @param {Complex} x (n,) @returns {Complex} a new array */
  forward(x) {
    if (this.chirp) return this.chirp.forward(x);
    const out = zeros(this.n);
    this.pass(out, 0, x, 0, 1, 0);
    return out;
  }

  /** The inverse without its 1 / n: x_j = sum_k X_k exp(+2 pi i j k / n). @param {Complex} x @returns {Complex} */
  backward(x) {
    const { re, im } = this.forward({ re: x.im, im: x.re });
    return { re: im, im: re };
  }

  /**
   * Transform of every `stride`-th value from `from` on, into `out` from `at` on.
   * @param {Complex} out @param {number} at @param {Complex} x @param {number} from @param {number} stride
   * @param {number} level
   */
  pass(out, at, x, from, stride, level) {
    if (level === this.factors.length) {
      out.re[at] = x.re[from];
      out.im[at] = x.im[from];
      return;
    }
    const p = this.factors[level], m = this.n / stride / p;
    for (let q = 0; q < p; q++) this.pass(out, at + q * m, x, from + q * stride, stride * p, level + 1);
    if (p === 4) this.butterfly4(out, at, m, stride);
    else this.butterfly(out, at, m, stride, p);
  }

  /** @param {Complex} out @param {number} at @param {number} m @param {number} stride */
  butterfly4(out, at, m, stride) {
    const { re, im } = out, { cos, sin } = this;
    for (let k = 0; k < m; k++) {
      const i0 = at + k, i1 = i0 + m, i2 = i1 + m, i3 = i2 + m;
      const t1 = k * stride, t2 = 2 * t1, t3 = 3 * t1;
      const r1 = re[i1] * cos[t1] - im[i1] * sin[t1], s1 = re[i1] * sin[t1] + im[i1] * cos[t1];
      const r2 = re[i2] * cos[t2] - im[i2] * sin[t2], s2 = re[i2] * sin[t2] + im[i2] * cos[t2];
      const r3 = re[i3] * cos[t3] - im[i3] * sin[t3], s3 = re[i3] * sin[t3] + im[i3] * cos[t3];
      const ar = re[i0] + r2, ai = im[i0] + s2, br = re[i0] - r2, bi = im[i0] - s2;
      const cr = r1 + r3, ci = s1 + s3, dr = r1 - r3, di = s1 - s3;
      re[i0] = ar + cr; im[i0] = ai + ci;
      re[i1] = br + di; im[i1] = bi - dr;
      re[i2] = ar - cr; im[i2] = ai - ci;
      re[i3] = br - di; im[i3] = bi + dr;
    }
  }

  /** @param {Complex} out @param {number} at @param {number} m @param {number} stride @param {number} p */
  butterfly(out, at, m, stride, p) {
    const { re, im } = out, { cos, sin, n, work } = this;
    for (let k = 0; k < m; k++) {
      for (let q = 0; q < p; q++) { work.re[q] = re[at + k + q * m]; work.im[q] = im[at + k + q * m]; }
      for (let j = 0; j < p; j++) {
        const step = (stride * (k + j * m)) % n;
        let a = work.re[0], b = work.im[0], t = 0;
        for (let q = 1; q < p; q++) {
          t += step;
          if (t >= n) t -= n;
          a += work.re[q] * cos[t] - work.im[q] * sin[t];
          b += work.re[q] * sin[t] + work.im[q] * cos[t];
        }
        re[at + k + j * m] = a;
        im[at + k + j * m] = b;
      }
    }
  }
}

/** A transform of any length as a convolution whose length is a power of two (Bluestein 1970). */
class Bluestein {
  /** @param {number} n */
  constructor(n) {
    this.n = n;
    let m = 1;
    while (m < 2 * n - 1) m *= 2;
    this.fft = new Fft(m);
    this.chirp = zeros(n);
    const kernel = zeros(m);
    for (let j = 0; j < n; j++) {
      const angle = (Math.PI * ((j * j) % (2 * n))) / n;
      this.chirp.re[j] = Math.cos(angle);
      this.chirp.im[j] = -Math.sin(angle);
      for (const at of j ? [j, m - j] : [0]) { kernel.re[at] = Math.cos(angle); kernel.im[at] = Math.sin(angle); }
    }
    this.kernel = this.fft.forward(kernel);
  }

  /** @param {Complex} x @returns {Complex} */
  forward(x) {
    const { n, fft, chirp, kernel } = this, m = fft.n, a = zeros(m);
    for (let j = 0; j < n; j++) {
      a.re[j] = x.re[j] * chirp.re[j] - x.im[j] * chirp.im[j];
      a.im[j] = x.re[j] * chirp.im[j] + x.im[j] * chirp.re[j];
    }
    const spectrum = fft.forward(a);
    for (let j = 0; j < m; j++) {
      const re = spectrum.re[j] * kernel.re[j] - spectrum.im[j] * kernel.im[j];
      spectrum.im[j] = spectrum.re[j] * kernel.im[j] + spectrum.im[j] * kernel.re[j];
      spectrum.re[j] = re;
    }
    const back = fft.backward(spectrum), out = zeros(n);
    for (let j = 0; j < n; j++) {
      out.re[j] = (back.re[j] * chirp.re[j] - back.im[j] * chirp.im[j]) / m;
      out.im[j] = (back.re[j] * chirp.im[j] + back.im[j] * chirp.re[j]) / m;
    }
    return out;
  }
}

/** @type {Map<number, Fft>} */
const made = new Map();

/** The transform of length n, made once. @param {number} n @returns {Fft} */
function fftOf(n) {
  const known = made.get(n) ?? new Fft(n);
  made.set(n, known);
  return known;
}

/**
 * Real signals of n samples at `rate` [Hz] from one-sided spectra [unit/Hz] on the bins `index`, t = 0 at sample n // 2.
 *
 * `spectra` (bins x rows, row fastest). Two signals share one transform. As Python's rendering/spectrum.py, to_time.
 * @param {Complex} spectra @param {number} rows @param {Int32Array} index @param {number} n @param {number} rate
 * @returns {Float64Array[]}
 */
export function toTime(spectra, rows, index, n, rate) {
  const fft = fftOf(n), centre = Math.floor(n / 2), scale = rate / n;
  /** @type {Float64Array[]} */
  const out = [];
  for (let row = 0; row < rows; row += 2) {
    const both = row + 1 < rows, x = zeros(n);
    for (let b = 0; b < index.length; b++) {
      const at = b * rows + row, k = index[b];
      const ar = spectra.re[at], ai = spectra.im[at];
      const br = both ? spectra.re[at + 1] : 0, bi = both ? spectra.im[at + 1] : 0;
      x.re[k] = ar - bi; x.im[k] = ai + br;
      x.re[n - k] = ar + bi; x.im[n - k] = br - ai;
    }
    const y = fft.backward(x);
    const first = new Float64Array(n), second = new Float64Array(both ? n : 0);
    for (let j = 0; j < n; j++) {
      const to = (j + centre) % n;
      first[to] = y.re[j] * scale;
      if (both) second[to] = y.im[j] * scale;
    }
    out.push(first);
    if (both) out.push(second);
  }
  return out;
}

/**
 * One-sided spectrum (n // 2 + 1,) [unit/Hz] of real samples, phase referred to t = 0 at sample n // 2.
 * @param {Float64Array} samples @param {number} rate @returns {Complex}
 */
export function toSpectrum(samples, rate) {
  const n = samples.length, centre = Math.floor(n / 2), x = zeros(n);
  for (let j = 0; j < n; j++) x.re[j] = samples[(j + centre) % n] / rate;
  const all = fftOf(n).forward(x), half = Math.floor(n / 2) + 1;
  return { re: all.re.slice(0, half), im: all.im.slice(0, half) };
}
