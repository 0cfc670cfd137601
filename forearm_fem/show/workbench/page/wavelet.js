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
