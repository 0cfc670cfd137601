/**
 * Signal strength S and the drives' limits. As Python's metrics/strength.py and rendering/drives.py.
 *
 * @typedef {import("./wavelet.js").Record} Record
 */
import { timeOf } from "./wavelet.js";

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
