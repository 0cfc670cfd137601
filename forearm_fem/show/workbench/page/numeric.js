/** Numbers: arrays of the page's JSON, linear algebra, and transforms. */

/**
 * Arrays out of the page's JSON, and complex arrays as two rows of numbers.
 *
 * @typedef {{re: Float64Array, im: Float64Array}} Complex
 * @typedef {{kind: string, shape: number[], data: string}} Packed
 * @typedef {Float32Array | Float64Array | Int16Array | Uint16Array | Uint32Array | Int32Array | Uint8Array} Numbers
 */

/** @param {number} n @returns {Complex} n zeros */
export function zeros(n) {
  return { re: new Float64Array(n), im: new Float64Array(n) };
}

/** @param {string} text base64 @returns {ArrayBuffer} */
function bytesOf(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes.buffer;
}

/** Real numbers as they were packed. @param {Packed} packed @returns {any} */
export function unpack(packed) {
  const bytes = bytesOf(packed.data);
  switch (packed.kind) {
    case "f4": return new Float32Array(bytes);
    case "f8": return new Float64Array(bytes);
    case "i2": return new Int16Array(bytes);
    case "u2": return new Uint16Array(bytes);
    case "u4": return new Uint32Array(bytes);
    case "i4": return new Int32Array(bytes);
    case "u1": return new Uint8Array(bytes);
    default: throw new Error(`the page holds an array of unknown kind ${packed.kind}`);
  }
}

/** Complex numbers, packed as pairs. @param {Packed} packed @returns {Complex} */
export function unpackComplex(packed) {
  const bytes = bytesOf(packed.data);
  const pairs = packed.kind === "c8" ? new Float32Array(bytes) : new Float64Array(bytes);
  const out = zeros(pairs.length / 2);
  for (let i = 0; i < out.re.length; i++) {
    out.re[i] = pairs[2 * i];
    out.im[i] = pairs[2 * i + 1];
  }
  return out;
}

/** Shapes of the field from 16 bits. @param {{scale: Packed, values: Packed}} packed @returns {Float32Array} */
export function unpackShapes(packed) {
  const scale = unpack(packed.scale), values = unpack(packed.values), k = scale.length;
  const out = new Float32Array(values.length);
  for (let i = 0; i < out.length; i += k) for (let j = 0; j < k; j++) out[i + j] = values[i + j] * scale[j];
  return out;
}

/** Amplitudes (frequency x k x input) from 16 bits. @param {{scale: Packed, values: Packed}} packed @returns {Complex} */
export function unpackAmplitudes(packed) {
  const scale = unpack(packed.scale), values = unpack(packed.values), [frequencies, k, inputs] = packed.values.shape, out = zeros(values.length / 2);
  for (let f = 0, at = 0; f < frequencies; f++) for (let j = 0; j < k; j++) for (let a = 0; a < inputs; a++, at++) {
    out.re[at] = values[2 * at] * scale[f * inputs + a];
    out.im[at] = values[2 * at + 1] * scale[f * inputs + a];
  }
  return out;
}

/**
 * Small complex systems and singular values, one frequency at a time.
 *
 * @typedef {import("./numeric.js").Complex} Complex
 */

const ROUNDING = 1e-14, SWEEPS = 40, LOST = 1e-33;

/**
 * X of A X = B by elimination with pivots; A (n, n) and B (n, m), row by row, are overwritten: B by X.
 * @param {Complex} a @param {Complex} b @param {number} n @param {number} m
 */
export function solveInPlace(a, b, n, m) {
  for (let k = 0; k < n; k++) {
    let best = k, size = -1;
    for (let i = k; i < n; i++) {
      const found = Math.hypot(a.re[i * n + k], a.im[i * n + k]);
      if (found > size) { size = found; best = i; }
    }
    if (best !== k) { swapRows(a, n, k, best); swapRows(b, m, k, best); }
    const pr = a.re[k * n + k], pi = a.im[k * n + k], norm = pr * pr + pi * pi;
    for (let i = 0; i < n; i++) {
      if (i === k) continue;
      const xr = a.re[i * n + k], xi = a.im[i * n + k];
      if (xr === 0 && xi === 0) continue;
      const fr = (xr * pr + xi * pi) / norm, fi = (xi * pr - xr * pi) / norm;
      subtractRow(a, n, i, k, fr, fi, k);
      subtractRow(b, m, i, k, fr, fi, 0);
    }
  }
  for (let k = 0; k < n; k++) {
    const pr = a.re[k * n + k], pi = a.im[k * n + k], norm = pr * pr + pi * pi;
    for (let j = k * m; j < k * m + m; j++) {
      const re = (b.re[j] * pr + b.im[j] * pi) / norm;
      b.im[j] = (b.im[j] * pr - b.re[j] * pi) / norm;
      b.re[j] = re;
    }
  }
}

/** @param {Complex} a @param {number} width @param {number} i @param {number} k */
function swapRows(a, width, i, k) {
  for (let j = 0; j < width; j++) {
    for (const part of [a.re, a.im]) {
      const kept = part[i * width + j];
      part[i * width + j] = part[k * width + j];
      part[k * width + j] = kept;
    }
  }
}

/**
 * Row i minus (fr + i fi) times row k, from column `first` on.
 * @param {Complex} a @param {number} width @param {number} i @param {number} k @param {number} fr @param {number} fi
 * @param {number} first
 */
function subtractRow(a, width, i, k, fr, fi, first) {
  for (let j = first; j < width; j++) {
    const re = a.re[k * width + j], im = a.im[k * width + j];
    a.re[i * width + j] -= fr * re - fi * im;
    a.im[i * width + j] -= fr * im + fi * re;
  }
}

/**
 * @typedef {{left: Complex, s: Float64Array, right: Complex, rows: number, columns: number, rank: number}} Svd
 *   `left` (rows x columns) holds the left vectors as columns, `right` (columns x columns) the right ones as columns;
 *   the first `rank` = min(rows, columns), with singular values `s` in descending order, are meant.
 */

/**
 * Singular value decomposition A = U diag(s) V^H by rotations of columns (one-sided Jacobi, Hestenes 1958).
 * @param {Complex} matrix (rows x columns), row by row @param {number} rows @param {number} columns @returns {Svd}
 */
export function svd(matrix, rows, columns) {
  const a = { re: matrix.re.slice(), im: matrix.im.slice() }, v = zeros(columns * columns);
  for (let j = 0; j < columns; j++) v.re[j * columns + j] = 1;
  // columns below rounding stay as they are: turning them for ever would wear their phases down
  const floor = a.re.reduce((sum, re, i) => sum + re * re + a.im[i] ** 2, 0) * LOST;
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    let turned = false;
    for (let p = 0; p < columns - 1; p++) for (let q = p + 1; q < columns; q++) turned = rotate(a, v, rows, columns, p, q, floor) || turned;
    if (!turned) break;
  }
  return sorted(a, v, rows, columns);
}

/**
 * Make columns p and q of `a` orthogonal; false where they are.
 * @param {Complex} a @param {Complex} v @param {number} rows @param {number} columns @param {number} p @param {number} q
 * @param {number} floor of a squared length
 */
function rotate(a, v, rows, columns, p, q, floor) {
  let alpha = 0, beta = 0, gr = 0, gi = 0;
  for (let i = 0; i < rows; i++) {
    const x = i * columns + p, y = i * columns + q;
    const pr = a.re[x], pi = a.im[x], qr = a.re[y], qi = a.im[y];
    alpha += pr * pr + pi * pi;
    beta += qr * qr + qi * qi;
    gr += pr * qr + pi * qi;
    gi += pr * qi - pi * qr;
  }
  const size = Math.hypot(gr, gi);
  if (alpha <= floor || beta <= floor || size <= ROUNDING * Math.sqrt(alpha * beta)) return false;
  const zeta = (beta - alpha) / (2 * size);
  const t = (zeta >= 0 ? 1 : -1) / (Math.abs(zeta) + Math.hypot(1, zeta));
  const c = 1 / Math.hypot(1, t), s = c * t, fr = gr / size, fi = gi / size;
  turn(a, rows, columns, p, q, c, s, fr, fi);
  turn(v, columns, columns, p, q, c, s, fr, fi);
  return true;
}

/**
 * @param {Complex} a @param {number} rows @param {number} columns @param {number} p @param {number} q
 * @param {number} c @param {number} s @param {number} fr @param {number} fi
 */
function turn(a, rows, columns, p, q, c, s, fr, fi) {
  for (let i = 0; i < rows; i++) {
    const x = i * columns + p, y = i * columns + q;
    const pr = a.re[x], pi = a.im[x];
    const qr = a.re[y] * fr + a.im[y] * fi, qi = a.im[y] * fr - a.re[y] * fi;
    a.re[x] = c * pr - s * qr; a.im[x] = c * pi - s * qi;
    a.re[y] = s * pr + c * qr; a.im[y] = s * pi + c * qi;
  }
}

/** @param {Complex} a @param {Complex} v @param {number} rows @param {number} columns @returns {Svd} */
function sorted(a, v, rows, columns) {
  const size = Array.from({ length: columns }, (_, j) => {
    let sum = 0;
    for (let i = 0; i < rows; i++) sum += a.re[i * columns + j] ** 2 + a.im[i * columns + j] ** 2;
    return Math.sqrt(sum);
  });
  const order = size.map((_, j) => j).sort((x, y) => size[y] - size[x]);
  const left = zeros(rows * columns), right = zeros(columns * columns), s = new Float64Array(columns);
  order.forEach((from, to) => {
    s[to] = size[from];
    for (let i = 0; i < rows; i++) {
      left.re[i * columns + to] = size[from] > 0 ? a.re[i * columns + from] / size[from] : 0;
      left.im[i * columns + to] = size[from] > 0 ? a.im[i * columns + from] / size[from] : 0;
    }
    for (let i = 0; i < columns; i++) {
      right.re[i * columns + to] = v.re[i * columns + from];
      right.im[i * columns + to] = v.im[i * columns + from];
    }
  });
  return { left, s, right, rows, columns, rank: Math.min(rows, columns) };
}

/**
 * Fourier transforms of any length: mixed radix for small prime factors, Bluestein's for large ones.
 *
 * @typedef {import("./numeric.js").Complex} Complex
 */

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
