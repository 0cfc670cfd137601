/**
 * Small complex systems and singular values, one frequency at a time.
 *
 * @typedef {import("./arrays.js").Complex} Complex
 */
import { zeros } from "./arrays.js";

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
