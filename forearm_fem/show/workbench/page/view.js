/**
 * Where the arms are looked at from: one camera for all panels.
 *
 * @typedef {{turn: number, tilt: number, far: number, centre: number[]}} View  angles [rad], lengths [mm]
 * @typedef {{x: number, y: number, w: number, h: number}} Box  [css px] from the canvas' upper left corner
 */

/** Unit vector from the centre to the eye. @param {View} view */
export function eyeOf(view) {
  return [Math.cos(view.tilt) * Math.cos(view.turn), Math.cos(view.tilt) * Math.sin(view.turn), Math.sin(view.tilt)];
}

/** @param {View} view @param {number} w @param {number} h @returns {Float32Array} column by column */
export function matrixOf(view, w, h) {
  const { turn, tilt, far, centre } = view, e = eyeOf(view);
  const x = [-Math.sin(turn), Math.cos(turn), 0], y = [-Math.sin(tilt) * Math.cos(turn), -Math.sin(tilt) * Math.sin(turn), Math.cos(tilt)];
  const dot = (/** @type {number[]} */ a) => a[0] * centre[0] + a[1] * centre[1] + a[2] * centre[2];
  const rows = [[...x, -dot(x)], [...y, -dot(y)], [...e, -dot(e) - far]];
  const f = 2.6 * Math.min(1, w / h), near = far / 20, end = far * 6, a = (near + end) / (near - end), b = (2 * near * end) / (near - end);
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) {
    out[4 * c] = ((f * h) / w) * rows[0][c];
    out[4 * c + 1] = f * rows[1][c];
    out[4 * c + 2] = a * rows[2][c] + (c === 3 ? b : 0);
    out[4 * c + 3] = -rows[2][c];
  }
  return out;
}

/** Place [css px] in the panel and depth of a point [mm]. @param {Float32Array} m @param {ArrayLike<number>} p @param {Box} box
 * @returns {[number, number, number]} */
export function project(m, p, box) {
  const q = [0, 1, 3].map((r) => m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r]);
  return [box.x + (0.5 + (0.5 * q[0]) / q[2]) * box.w, box.y + (0.5 - (0.5 * q[1]) / q[2]) * box.h, q[2]];
}
