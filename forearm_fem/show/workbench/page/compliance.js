/**
 * The skin between its ports without the device: displacement per newton on each contact.
 *
 * @typedef {import("./arrays.js").Complex} Complex
 * @typedef {import("./arrays.js").Packed} Packed
 * @typedef {{poles: Complex, left: Complex, right: Complex, shares: Float64Array}} Poles
 */
import { unpack, unpackComplex, zeros } from "./arrays.js";

/** @param {any} model packed @returns {Poles} */
export function polesOf(model) {
  return {
    poles: unpackComplex(model.poles),
    left: unpackComplex(model.left),
    right: unpackComplex(model.right),
    shares: unpack(model.shares),
  };
}

/**
 * C(omega) = sum_k left_ik right_kj share_j / (i omega - pole_k), made symmetric as in Python's fem/reduction/affine.py.
 *
 * Ports are contacts first; (frequency x ports x contacts), the last fastest.
 * @param {Poles} model @param {ArrayLike<number>} frequency [Hz] @param {number} contacts @returns {Complex} [m/N]
 */
export function complianceAt(model, frequency, contacts) {
  const { poles, left, right, shares } = model, modes = poles.re.length, ports = shares.length;
  const pairs = zeros(ports * contacts * modes);
  for (let i = 0; i < ports; i++) for (let j = 0; j < contacts; j++) for (let k = 0; k < modes; k++) {
    const a = i * modes + k, b = k * ports + j, c = j * modes + k, d = k * ports + i, at = (i * contacts + j) * modes + k;
    const re = left.re[a] * right.re[b] - left.im[a] * right.im[b] + left.re[c] * right.re[d] - left.im[c] * right.im[d];
    const im = left.re[a] * right.im[b] + left.im[a] * right.re[b] + left.re[c] * right.im[d] + left.im[c] * right.re[d];
    pairs.re[at] = (re / 2) * shares[j];
    pairs.im[at] = (im / 2) * shares[j];
  }
  const out = zeros(frequency.length * ports * contacts), one = zeros(modes), rows = ports * contacts;
  for (let f = 0; f < frequency.length; f++) {
    const omega = 2 * Math.PI * frequency[f];
    for (let k = 0; k < modes; k++) {
      const re = -poles.re[k], im = omega - poles.im[k], norm = re * re + im * im;
      one.re[k] = re / norm;
      one.im[k] = -im / norm;
    }
    for (let row = 0; row < rows; row++) {
      let re = 0, im = 0;
      for (let k = 0, at = row * modes; k < modes; k++, at++) {
        re += pairs.re[at] * one.re[k] - pairs.im[at] * one.im[k];
        im += pairs.re[at] * one.im[k] + pairs.im[at] * one.re[k];
      }
      out.re[f * rows + row] = re;
      out.im[f * rows + row] = im;
    }
  }
  return out;
}
