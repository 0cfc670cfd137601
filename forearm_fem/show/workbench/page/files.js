/**
 * What goes in and out of the page as files: WAV, CSV, JSON, TOML. Every refusal is one sentence.
 *
 * @typedef {import("./numeric.js").Complex} Complex
 */
import { zeros } from "./numeric.js";

/** A failure that the reader can act upon: one line, whatever a file's name or text hold. */
export class FileProblem extends Error {
  /** @param {string} message */
  constructor(message) {
    super(inOneLine(message));
  }
}

/** @param {string} text */
export function inOneLine(text) {
  const plain = text.replace(/[\s\p{Cc}]+/gu, " ").trim();
  return plain.length < LONGEST ? plain : `${plain.slice(0, LONGEST - 2)}…`;
}

const MOST = 64e6, LONGEST = 300; // bytes, letters

/** @param {string} name @param {number} size */
export function checkSize(name, size) {
  if (size > MOST) throw new FileProblem(`${name}: ${(size / 1e6).toFixed(0)} MB is too large for the page, which reads up to ${MOST / 1e6} MB`);
  if (!size) throw new FileProblem(`${name}: is empty`);
}

/**
 * Samples of a WAV file with one channel: PCM of 16, 24 or 32 bits, or floating point.
 * @param {string} name @param {ArrayBuffer} bytes @returns {{samples: Float64Array, rate: number}}
 */
export function readWav(name, bytes) {
  const view = new DataView(bytes), text = (/** @type {number} */ at) => String.fromCharCode(...new Uint8Array(bytes, at, 4));
  if (bytes.byteLength < 44 || text(0) !== "RIFF" || text(8) !== "WAVE") throw new FileProblem(`${name}: is no WAV file; export it as PCM of 16 bits, one channel`);
  let at = 12, format = 0, channels = 0, rate = 0, bits = 0;
  while (at + 8 <= bytes.byteLength) {
    const size = view.getUint32(at + 4, true), start = at + 8;
    if (text(at) === "fmt " && start + 16 <= bytes.byteLength) {
      format = view.getUint16(start, true);
      if (format === 0xfffe && size >= 26 && start + 26 <= bytes.byteLength) format = view.getUint16(start + 24, true);
      channels = view.getUint16(start + 2, true); rate = view.getUint32(start + 4, true); bits = view.getUint16(start + 14, true);
    }
    if (text(at) === "data") {
      if (start + size > bytes.byteLength) throw new FileProblem(`${name}: is cut short, ${size} bytes are announced and ${bytes.byteLength - start} are there`);
      if (channels !== 1) throw new FileProblem(`${name}: has ${channels} channels, expected one; export a single one`);
      return { samples: samplesOf(name, view, start, size, format, bits), rate };
    }
    at = start + size + (size % 2);
  }
  throw new FileProblem(`${name}: holds no samples; it is cut short or damaged`);
}

/** @param {string} name @param {DataView} view @param {number} start @param {number} size @param {number} format @param {number} bits */
function samplesOf(name, view, start, size, format, bits) {
  /** @type {((at: number) => number) | null} */
  const get = format === 3 && bits === 32 ? (at) => view.getFloat32(at, true) : format === 3 && bits === 64 ? (at) => view.getFloat64(at, true)
    : format === 1 && bits === 16 ? (at) => view.getInt16(at, true) : format === 1 && bits === 32 ? (at) => view.getInt32(at, true)
    : format === 1 && bits === 24 ? (at) => (view.getInt8(at + 2) << 16) | view.getUint16(at, true) : null;
  if (!get) throw new FileProblem(`${name}: format ${format} with ${bits} bits is not read; export PCM of 16, 24 or 32 bits, or floating point`);
  return Float64Array.from({ length: Math.floor((8 * size) / bits) }, (_, j) => get(start + (j * bits) / 8));
}

/** One column of samples, or time [s] and value. @param {string} name @param {string} text @returns {{samples: Float64Array, rate: number | null}} */
export function readSamplesCsv(name, text) {
  const rows = text.split(/\r?\n/).filter((l) => l.trim() && !l.startsWith("#")).map((l) => l.split(",").map((c) => c.trim()));
  if (rows.length && rows[0].some((c) => c === "" || Number.isNaN(Number(c)))) rows.shift();
  const table = rows.map((r) => r.map((c) => (c === "" ? NaN : Number(c)))), width = table[0]?.length ?? 0;
  const bad = table.findIndex((r) => r.length !== width || r.some((v) => !Number.isFinite(v)));
  if (!table.length || width > 2) throw new FileProblem(`${name}: expected one column of samples, or time and value, got ${width || "no"} columns of numbers`);
  if (bad >= 0) throw new FileProblem(`${name}: row ${bad + 1} of the numbers is damaged (${rows[bad].join(",").slice(0, 40)})`);
  if (width === 1) return { samples: Float64Array.from(table, (r) => r[0]), rate: null };
  const step = (table[table.length - 1][0] - table[0][0]) / (table.length - 1);
  const uneven = !(step > 0) || table.some((r, j) => j > 0 && Math.abs(r[0] - table[j - 1][0] - step) > 1e-3 * step);
  if (uneven) throw new FileProblem(`${name}: its first column is not an evenly increasing time in seconds`);
  return { samples: Float64Array.from(table, (r) => r[1]), rate: 1 / step };
}

/** Samples that fit the record as they are: nothing is resampled. @param {string} name
 * @param {{samples: Float64Array, rate: number | null}} found @param {{rate: number, n: number}} record @returns {Float64Array} */
export function fitting(name, { samples, rate }, record) {
  if (rate !== null && Math.abs(rate / record.rate - 1) > 1e-3) throw new FileProblem(`${name}: is sampled at ${rate.toPrecision(6)} Hz, expected ${record.rate} Hz; resample it first`);
  if (samples.length < 2 || samples.length > record.n) throw new FileProblem(`${name}: has ${samples.length} samples, expected 2 to ${record.n}, the record of ${record.n / record.rate} s`);
  if (!samples.every(Number.isFinite)) throw new FileProblem(`${name}: holds samples that are no finite numbers`);
  if (!samples.some((v) => v !== 0)) throw new FileProblem(`${name}: all ${samples.length} samples are zero`);
  return samples;
}

/**
 * A measured G: CSV with the columns frequency_Hz, output, input and real, imag (or magnitude, phase_rad), or this page's JSON.
 *
 * Entries that are absent or not valid are NaN. Only points and actuators of the page are kept, by name.
 * @param {string} name @param {string} text @param {string[]} outputs @param {string[]} inputs @param {string} unit
 * @returns {{name: string, frequency: Float64Array, values: Complex, told: boolean}} (frequency x outputs x inputs), and
 * whether the file says in which unit it is
 */
export function readTransfer(name, text, outputs, inputs, unit) {
  const rows = /\.json$/i.test(name) || text.trimStart().startsWith("{") ? rowsOfJson(name, text, unit) : rowsOfCsv(name, text, unit);
  const frequency = Float64Array.from(new Set(rows.map((r) => r.f))).sort(), place = new Map(Array.from(frequency, (f, k) => [f, k]));
  const values = { re: new Float64Array(frequency.length * outputs.length * inputs.length).fill(NaN), im: new Float64Array(frequency.length * outputs.length * inputs.length).fill(NaN) };
  let kept = 0, known = 0;
  for (const r of rows) {
    const o = outputs.indexOf(r.output), i = inputs.indexOf(r.input);
    if (o < 0 || i < 0) continue;
    const at = (/** @type {number} */ (place.get(r.f)) * outputs.length + o) * inputs.length + i;
    if (!Number.isNaN(values.re[at])) throw new FileProblem(`${name}: ${r.output} from ${r.input} at ${r.f} Hz occurs twice; keep one of them`);
    values.re[at] = r.valid ? r.re : NaN;
    values.im[at] = r.valid ? r.im : NaN;
    kept++;
    if (r.valid) known++;
  }
  if (!kept) throw new FileProblem(`${name}: none of its outputs and inputs are called as here (${outputs.slice(0, 3).join(", ")}...; ${inputs.slice(0, 3).join(", ")}...)`);
  if (!known) throw new FileProblem(`${name}: says of none of its ${kept} entries what it is; export it again, with numbers`);
  return { name, frequency, values, told: /^(# forearm_fem )?\{/.test(text.trimStart()) };
}

/** @typedef {{f: number, output: string, input: string, re: number, im: number, valid: boolean}} Entry */

/** @param {string} name @param {string} text @param {string} unit @returns {Entry[]} */
function rowsOfCsv(name, text, unit) {
  const all = text.split(/\r?\n/), head = /^# forearm_fem (\{.*\})$/.exec(all[0] ?? "");
  if (head) checkUnit(name, parsed(name, head[1]), unit);
  const lines = all.map((l, k) => ({ l, k })).filter(({ l }) => l.trim() && !l.startsWith("#"));
  const columns = (lines.shift()?.l ?? "").split(",").map((c) => c.trim()), at = (/** @type {string} */ c) => columns.indexOf(c);
  const polar = at("magnitude") >= 0 && at("phase_rad") >= 0, plain = at("real") >= 0 && at("imag") >= 0;
  if (["frequency_Hz", "output", "input"].some((c) => at(c) < 0) || (!polar && !plain)) {
    throw new FileProblem(`${name}: expected the columns frequency_Hz, output, input and real, imag (or magnitude, phase_rad), got ${columns.join(", ").slice(0, 80)}`);
  }
  const twice = ["frequency_Hz", "output", "input", "valid", "real", "imag", "magnitude", "phase_rad"].find((c) => at(c) !== columns.lastIndexOf(c)) ?? (polar && plain ? "real and magnitude" : "");
  if (twice) throw new FileProblem(`${name}: says the same in two columns (${twice}); keep those that are meant`);
  if (!lines.length) throw new FileProblem(`${name}: has a header and no lines of data`);
  return lines.map(({ l, k }) => {
    const cells = l.split(","), number = (/** @type {string} */ c) => (cells[at(c)]?.trim() === "nan" ? NaN : Number(cells[at(c)] || "x"));
    const f = number("frequency_Hz"), mark = at("valid") < 0 ? "1" : (cells[at("valid")] ?? "").trim(), valid = Number(mark || "x") !== 0;
    if (mark === "" || ![0, 1].includes(Number(mark))) throw new FileProblem(`${name}, line ${k + 1}: valid is ${mark.slice(0, 20) || "blank"}, expected 1 or 0`);
    const [a, b] = plain ? [number("real"), number("imag")] : [number("magnitude"), number("phase_rad")];
    if (cells.length !== columns.length || !isFrequency(f) || (valid && !(Number.isFinite(a) && Number.isFinite(b)))) throw new FileProblem(`${name}: line ${k + 1} is damaged (${l.slice(0, 40)})`);
    if (polar && a < 0) throw new FileProblem(`${name}, line ${k + 1}: magnitude is ${a}, expected 0 or more in ${unit}, not decibels`);
    return { f, output: cells[at("output")].trim(), input: cells[at("input")].trim(), re: plain ? a : a * Math.cos(b), im: plain ? b : a * Math.sin(b), valid };
  });
}

/** @param {string} name @param {string} text @param {string} unit @returns {Entry[]} */
function rowsOfJson(name, text, unit) {
  const found = parsed(name, text), size = (/** @type {string} */ key) => (Array.isArray(found?.[key]) ? found[key].length : 0), count = size("outputs") * size("inputs") * size("frequency_Hz");
  if (found?.content !== "forearm_fem transfer" || !count || size("real") !== count || size("imag") !== count) {
    throw new FileProblem(`${name}: is not the JSON that this page writes; export G again, or use CSV`);
  }
  checkUnit(name, found, unit);
  /** @type {Entry[]} */
  const rows = [];
  let at = 0;
  for (const f of found.frequency_Hz) for (const output of found.outputs) for (const input of found.inputs) {
    const re = found.real[at], im = found.imag[at++], valid = Number.isFinite(re) && Number.isFinite(im);
    if (!isFrequency(f)) throw new FileProblem(`${name}: a frequency is no positive number`);
    rows.push({ f, output: String(output), input: String(input), re, im, valid });
  }
  return rows;
}

/** @param {unknown} f [Hz] */
const isFrequency = (f) => typeof f === "number" && Number.isFinite(f) && f > 0;

/** @param {string} name @param {string} text @returns {any} */
function parsed(name, text) {
  try {
    return JSON.parse(text);
  } catch {
    throw new FileProblem(`${name}: is damaged, its JSON ends or breaks in the middle; export it again`);
  }
}

/** @param {string} name @param {any} head @param {string} unit */
function checkUnit(name, head, unit) {
  if (head?.unit !== unit) throw new FileProblem(`${name}: is in ${String(head?.unit).slice(0, 12)}, this page in ${unit}; convert it first`);
}

/** This page's JSON of G. @param {ArrayLike<number>} frequency @param {Complex} values @param {string[]} outputs @param {string[]} inputs
 * @param {string} unit @param {string} stamp */
export function transferJson(frequency, values, outputs, inputs, unit, stamp) {
  const plain = (/** @type {Float64Array} */ v) => Array.from(v, (x) => (Number.isFinite(x) ? x : null));
  return JSON.stringify({ content: "forearm_fem transfer", unit, time_convention: "e^{+i omega t}", source: stamp, outputs, inputs, frequency_Hz: Array.from(frequency), real: plain(values.re), imag: plain(values.im) });
}

/** G as the CSV that `forearm-fem compare` reads. @param {ArrayLike<number>} frequency @param {Complex} values @param {any[]} outputs
 * @param {any[]} inputs @param {string} unit */
export function transferCsv(frequency, values, outputs, inputs, unit) {
  const head = { unit, quantity: "displacement", sign: "+iwt", spectrum: "one-sided", masked: true, outputs, inputs };
  const lines = [`# forearm_fem ${JSON.stringify(head)}`, "frequency_Hz,output,input,real,imag,valid"];
  let at = 0;
  for (let f = 0; f < frequency.length; f++) for (const o of outputs) for (const i of inputs) {
    const re = values.re[at], im = values.im[at++], valid = Number.isFinite(re) && Number.isFinite(im);
    lines.push(`${frequency[f]},${o.name},${i.name},${valid ? re : "nan"},${valid ? im : "nan"},${valid ? 1 : 0}`);
  }
  return `${lines.join("\n")}\n`;
}

/** A WAV file of floating point, a channel per signal. @param {ArrayLike<number>[]} signals @param {number} rate @returns {ArrayBuffer} */
export function writeWav(signals, rate) {
  if (!Number.isInteger(rate)) throw new FileProblem(`a WAV file holds whole sample rates only, not ${rate.toPrecision(8)} Hz; keep the signals as CSV`);
  const channels = signals.length, n = signals[0].length, size = 4 * channels * n, bytes = new ArrayBuffer(44 + size), view = new DataView(bytes);
  const text = (/** @type {number} */ at, /** @type {string} */ s) => { for (let i = 0; i < s.length; i++) view.setUint8(at + i, s.charCodeAt(i)); };
  text(0, "RIFF"); view.setUint32(4, 36 + size, true); text(8, "WAVEfmt "); view.setUint32(16, 16, true);
  view.setUint16(20, 3, true); view.setUint16(22, channels, true); view.setUint32(24, Math.round(rate), true);
  view.setUint32(28, 4 * channels * Math.round(rate), true); view.setUint16(32, 4 * channels, true); view.setUint16(34, 32, true);
  text(36, "data"); view.setUint32(40, size, true);
  for (let j = 0, at = 44; j < n; j++) for (let c = 0; c < channels; c++, at += 4) view.setFloat32(at, signals[c][j], true);
  return bytes;
}

/** Columns as CSV. @param {Record<string, ArrayLike<number>>} columns @param {string[]} notes */
export function writeCsv(columns, notes) {
  const names = Object.keys(columns), n = columns[names[0]].length, lines = [...notes.map((l) => `# ${l.replace(/[\r\n]+/g, " ")}`), names.join(",")];
  for (let j = 0; j < n; j++) lines.push(names.map((c) => columns[c][j]).join(","));
  return `${lines.join("\n")}\n`;
}

/** A table as TOML: plain values first, tables under their names. @param {Record<string, any>} table @param {string} [path] @returns {string} */
export function writeToml(table, path = "") {
  const isTable = (/** @type {any} */ v) => v !== null && typeof v === "object" && !Array.isArray(v);
  const entries = Object.entries(table).filter(([, v]) => v !== null && v !== undefined);
  let text = entries.filter(([, v]) => !isTable(v)).map(([k, v]) => `${keyOf(k)} = ${valueOf(v)}\n`).join("");
  if (path && text) text = `\n[${path}]\n${text}`;
  for (const [k, v] of entries.filter(([, x]) => isTable(x))) text += writeToml(v, path ? `${path}.${keyOf(k)}` : keyOf(k));
  return text;
}

/** @param {string} key */
const keyOf = (key) => (/^[A-Za-z0-9_-]+$/.test(key) ? key : textOf(key));
/** @param {string} text */
const textOf = (text) => JSON.stringify(text).replace(/\u007f/g, "\\u007f");

/** @param {any} value @returns {string} */
function valueOf(value) {
  if (typeof value === "string") return textOf(value);
  if (typeof value === "number") return Number.isInteger(value) && Math.abs(value) < 1e15 ? String(value) : String(value).replace(/^(-?\d+)e/, "$1.0e");
  if (Array.isArray(value)) return `[${value.map(valueOf).join(", ")}]`;
  if (typeof value === "object") return `{ ${Object.entries(value).filter(([, v]) => v !== null).map(([k, v]) => `${keyOf(k)} = ${valueOf(v)}`).join(", ")} }`;
  return String(value);
}

/**
 * Values between the samples of a row by a not-a-knot cubic spline, as in Python's rendering/interpolation.py; NaN outside,
 * beside unknown samples and in gaps three times wider than both neighbours.
 * @param {Float64Array} x @param {Float64Array} y @param {ArrayLike<number>} at @returns {Float64Array}
 */
export function between(x, y, at) {
  const n = x.length, out = new Float64Array(at.length).fill(NaN), step = (/** @type {number} */ i) => x[i + 1] - x[i];
  /** @type {[number, number][]} */
  const runs = [];
  let first = -1;
  for (let i = 0; i < n; i++) {
    const known = Number.isFinite(y[i]), wide = i > 0 && step(i - 1) > 3 * Math.max(i > 1 ? step(i - 2) : 0, i < n - 1 ? step(i) : 0);
    if (first >= 0 && (!known || wide)) { runs.push([first, i]); first = -1; }
    if (known && first < 0) first = i;
  }
  if (first >= 0) runs.push([first, n]);
  for (const [a, b] of runs) {
    const slopes = b - a >= 8 ? splineSlopes(x.subarray(a, b), y.subarray(a, b)) : null;
    for (let k = 0; k < at.length; k++) {
      const v = at[k];
      if (v < x[a] - 1e-9 * v || v > x[b - 1] + 1e-9 * v) continue;
      let i = a;
      while (i < b - 2 && x[i + 1] <= v) i++;
      const near = Math.abs(v - x[i]) < 1e-6 * v ? i : Math.abs(v - x[Math.min(i + 1, b - 1)]) < 1e-6 * v ? i + 1 : -1;
      if (near >= 0) { out[k] = y[near]; continue; }
      if (!slopes) continue;
      const d = step(i), t = (v - x[i]) / d, s0 = slopes[i - a] * d, s1 = slopes[i - a + 1] * d, rise = y[i + 1] - y[i];
      out[k] = y[i] + t * (s0 + t * (3 * rise - 2 * s0 - s1 + t * (s0 + s1 - 2 * rise)));
    }
  }
  return out;
}

/** Slopes at the samples. @param {Float64Array} x @param {Float64Array} y @returns {Float64Array} */
function splineSlopes(x, y) {
  const n = x.length, d = Float64Array.from({ length: n - 1 }, (_, i) => x[i + 1] - x[i]), m = d.map((v, i) => (y[i + 1] - y[i]) / v);
  const low = new Float64Array(n), middle = new Float64Array(n), high = new Float64Array(n), right = new Float64Array(n);
  middle[0] = d[1]; high[0] = d[0] + d[1];
  right[0] = ((d[0] + 2 * high[0]) * d[1] * m[0] + d[0] * d[0] * m[1]) / high[0];
  for (let i = 1; i < n - 1; i++) { low[i] = d[i]; middle[i] = 2 * (d[i - 1] + d[i]); high[i] = d[i - 1]; right[i] = 3 * (d[i] * m[i - 1] + d[i - 1] * m[i]); }
  const a = d[n - 2], b = d[n - 3];
  low[n - 1] = a + b; middle[n - 1] = b;
  right[n - 1] = (a * a * m[n - 3] + (2 * (a + b) + a) * b * m[n - 2]) / (a + b);
  for (let i = 1; i < n; i++) { const w = low[i] / middle[i - 1]; middle[i] -= w * high[i - 1]; right[i] -= w * right[i - 1]; }
  const out = zeros(n).re;
  out[n - 1] = right[n - 1] / middle[n - 1];
  for (let i = n - 2; i >= 0; i--) out[i] = (right[i] - high[i] * out[i + 1]) / middle[i];
  return out;
}
