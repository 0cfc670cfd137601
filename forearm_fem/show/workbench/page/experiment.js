/**
 * The whole way from the skin's compliance to S, with everything a reader of the page may change; no picture, no window.
 *
 * @typedef {import("./arrays.js").Complex} Complex
 * @typedef {import("./device.js").Device} Device
 * @typedef {import("./device.js").Port} Port
 * @typedef {import("./renderers.js").Aim} Aim
 * @typedef {import("./renderers.js").Method} Method
 * @typedef {import("./renderers.js").Placed} Placed
 * @typedef {import("./renderers.js").Rule} Rule
 * @typedef {import("./wavelet.js").Wavelet} Wavelet
 * @typedef {import("./wavelet.js").Record} Record
 * @typedef {{vertex: number, position: number[], normal: number[]}} Place  anywhere on the skin, [m]
 * @typedef {object} Settings
 * @property {number} target  row among the points, the free place after them
 * @property {Place | null} place
 * @property {"run" | "auto" | "thesis" | "others" | number[]} zeros
 * @property {Rule | null} rule
 * @property {number} amplitude  [V], and [1e-6 m] for the inverse filter
 * @property {"wavelet" | "record" | [number, number]} window
 * @property {Wavelet} wavelet
 * @property {Device} device
 * @property {boolean} calibrated  whether renderers know the changed device
 * @property {number} arm  0 is the run's own, the others are drawn ones
 * @property {number[][] | null} contacts  where actuators stand, seen from above [m]; only with a library or flat layers
 * @typedef {object} Outcome  one method at one target
 * @property {Method} method
 * @property {string} problem  why there is none; empty otherwise
 * @property {Aim | null} aim
 * @property {Complex | null} sent  drive spectra (bins x inputs) [V/Hz]
 * @property {Complex | null} spectra  (bins x outputs) [m/Hz]
 * @property {Float64Array[]} signals  [V]
 * @property {Float64Array[]} moves  [m]
 * @property {number[]} areas
 * @property {number} strength
 * @property {number} undriven  share of the wavelet's energy on bins that are not driven
 */
import { unpack, unpackAmplitudes, unpackComplex, zeros } from "./arrays.js";
import { complianceAt, polesOf } from "./compliance.js";
import { closeLoop } from "./device.js";
import { toSpectrum, toTime } from "./fft.js";
import { Anywhere } from "./anywhere.js";
import { Places } from "./places.js";
import { aim, knownInputs, respond } from "./renderers.js";
import { area, strengthOf } from "./strength.js";
import { burst, placed, ricker, windowOf } from "./wavelet.js";
import { autoZeros, thesisZeros } from "./zeros.js";

/** @type {Method[]} */
export const METHODS = ["inverse filter", "funneling", "combination"];

export class Experiment {
  /** @param {any} content of the page, packed */
  constructor(content) {
    this.content = content;
    /** @type {Record} */
    this.record = content.record;
    /** @type {Int32Array} */
    this.index = unpack(content.bins);
    this.frequency = Float64Array.from(this.index, (k) => (k * this.record.rate) / this.record.n);
    /** @type {Port[]} */
    this.inputs = content.inputs;
    /** @type {Port[]} */
    this.points = content.outputs;
    /** @type {Float64Array} */
    this.error = unpack(content.error);
    this.kind = content.model.kind;
    this.poles = this.kind === "poles" ? polesOf(content.model) : null;
    /** Where actuators may stand: on a library's patch, or anywhere on flat layers. @type {Places | Anywhere | null} */
    this.places = this.kind === "places" ? new Places(content.model) : content.anywhere ? new Anywhere(content.anywhere, this.frequency, this.points) : null;
    this.skin = this.places instanceof Places ? this.places.skin(content.model.home) : this.poles
      ? complianceAt(this.poles, this.frequency, this.inputs.length)
      : this.kind === "samples" ? unpackComplex(content.model.values) : zeros(0);
    this.skinAsRun = this.skin;
    this.measured = this.kind === "transfer"
      ? { values: unpackComplex(content.model.values), valid: /** @type {Uint8Array} */ (unpack(content.model.valid)) }
      : null;
    /** Motion at a vertex of the skin per newton (bins x contacts); set by the page. @type {((vertex: number) => Complex) | null} */
    this.reach = null;
    /** @type {Settings} */
    this.settings = this.original();
    /** G of arms that a prediction drew (bins x outputs x inputs). @type {Complex[]} */
    this.drawnArms = (content.draws ?? []).map((/** @type {any} */ d) => unpackAmplitudes(d.values));
    this.cache = new Map();
    /** Half widths of log S that were drawn here, and for which settings. @type {{key: string, half: number[][]} | null} */
    this.drawn = null;
  }

  /** Settings with which the run was made. @returns {Settings} */
  original() {
    const { rendering, device } = this.content, inputs = /** @type {Port[]} */ (this.content.inputs), names = this.points.map((p) => p.name);
    const targets = rendering.targets === "all" ? names : rendering.targets;
    const start = targets.includes("5") ? "5" : targets[Math.floor(targets.length / 2)] ?? names[0];
    return {
      target: Math.max(names.indexOf(start), 0),
      place: null,
      zeros: "run",
      rule: rendering.regularisation === "auto" ? null : { kind: rendering.regularisation, value: rendering.regularisation_value },
      amplitude: rendering.amplitude,
      window: rendering.window,
      wavelet: this.content.samples
        ? { samples: unpack(this.content.samples), name: rendering.wavelet.file, kind: "file" }
        : ricker(rendering.wavelet.peak, this.record),
      device: {
        drive: device.drive, coil: { ...device.coil }, cone: { mass: device.cone.mass }, housing: { ...device.housing },
        touching: inputs.map((p) => !device.out_of_contact.includes(p.name)),
        gain: inputs.map((p) => device.gains?.[p.name] ?? 1),
        spring: inputs.map((p) => device.contact_springs?.[p.name] ?? Infinity),
      },
      calibrated: true,
      arm: 0,
      contacts: this.home,
    };
  }

  /** Where the run had its actuators, if they can be moved. @returns {number[][] | null} */
  get home() {
    return this.places instanceof Anywhere ? this.places.home : this.places ? this.content.model.home : null;
  }

  /** Whether actuators of a run on flat layers stand elsewhere than in the run. */
  get moved() {
    return this.places instanceof Anywhere && JSON.stringify(this.settings.contacts) !== JSON.stringify(this.places.home);
  }

  /** What answers, and how far off G may be. @returns {{engine: string, error: number | null}} */
  get engine() {
    const { content } = this, known = this.errors.map((/** @type {any} */ e) => e.band), error = known.includes(null) || !known.length ? null : Math.hypot(...known);
    const engine = this.kind === "transfer" ? "G as given" : this.kind === "places" ? "the arm's library" : this.moved ? "the layered model, from tables in this page" : content.engine === "layered" ? "the layered model, as run" : "finite elements, as run";
    return { engine, error };
  }

  /** Errors of G, packed: of the run, or of the page's tables once an actuator has moved. @returns {any[]} */
  get errors() {
    return this.moved ? this.content.anywhere.errors : this.content.errors;
  }

  /** Whether the device can be changed: only where the skin's compliance is known. */
  get changeable() {
    return this.kind !== "transfer";
  }

  /** Points and the free place. @returns {Port[]} */
  get outputs() {
    const { place } = this.settings;
    if (!place) return this.points;
    return [...this.points, { name: "P", kind: "point", position: place.position, axis: place.normal, radius: 0 }];
  }

  /** @template T @param {string} key @param {() => T} make @returns {T} */
  once(key, make) {
    if (!this.cache.has(key)) this.cache.set(key, make());
    return this.cache.get(key);
  }

  /** Change settings; what does not depend on them is kept. @param {Partial<Settings>} change */
  set(change) {
    if (change.arm && (change.place ?? this.settings.place)) throw new RangeError("of a drawn arm nothing is known between the points; choose a point first");
    if (change.place && (change.arm ?? this.settings.arm)) throw new RangeError("of a drawn arm nothing is known between the points; choose a point, or the run's own arm");
    if (change.contacts && this.places && change.contacts !== this.settings.contacts) this.stand(change.contacts);
    if (change.contacts) change = { ...change, device: fitted(change.device ?? this.settings.device, change.contacts.length) };
    this.settings = { ...this.settings, ...change };
    for (const key of this.cache.keys()) {
      if (!("device" in change || "place" in change || "contacts" in change || "arm" in change) && (key.startsWith("loop") || key.startsWith("svd"))) continue;
      if (!("wavelet" in change) && key === "wavelet") continue;
      this.cache.delete(key);
    }
  }

  /** Put the actuators elsewhere on a library's patch; a RangeError says where they cannot stand. @param {number[][]} contacts */
  stand(contacts) {
    const places = /** @type {Places | Anywhere} */ (this.places), names = contacts.map((_, k) => `A${k + 1}`), unmoved = places instanceof Anywhere && JSON.stringify(contacts) === JSON.stringify(places.home);
    const problem = unmoved ? "" : places.refusal(contacts, names);
    if (problem) throw new RangeError(problem);
    this.skin = unmoved ? this.skinAsRun : places.skin(contacts);
    this.inputs = unmoved ? this.content.inputs : contacts.map((at, k) => ({ ...places.port(at, this.content.inputs[k] ?? this.content.inputs[0]), name: this.content.inputs[k]?.name ?? names[k] }));
  }

  /** The distance of the two nearest actuators [m]. */
  get pitch() {
    const at = this.inputs.map((p) => p.position);
    return at.reduce((least, a, i) => at.slice(0, i).reduce((d, b) => Math.min(d, Math.hypot(a[0] - b[0], a[1] - b[1])), least), Infinity);
  }

  /** Put the nearest actuators `pitch` [m] apart, the arrangement keeping its shape and middle. @param {number} pitch */
  spread(pitch) {
    const now = /** @type {number[][]} */ (this.settings.contacts), by = pitch / this.pitch, middle = [0, 1].map((c) => now.reduce((s, p) => s + p[c], 0) / now.length);
    return now.map((p) => p.map((v, c) => Number((middle[c] + by * (v - middle[c])).toFixed(6))));
  }

  /** The contacts and one more, far from all others and from the points, near the middle. @returns {number[][]} */
  withOneMore() {
    const places = /** @type {Anywhere} */ (this.places), now = /** @type {number[][]} */ (this.settings.contacts), { half, middle, radius } = places;
    let best = now[0], room = -1;
    for (let x = -half[0] + radius; x <= half[0] - radius; x += 5e-4) for (let y = -half[1] + radius; y <= half[1] - radius; y += 5e-4) {
      const at = [middle[0] + x, middle[1] + y], clear = (/** @type {number[]} */ p) => Math.hypot(at[0] - p[0], at[1] - p[1]);
      const gap = Math.min(...now.map(clear), ...this.points.map((p) => 2 * clear(p.position))) - 0.3 * Math.hypot(x, y);
      if (gap > room) { room = gap; best = at; }
    }
    return [...now, best.map((v) => Number(v.toFixed(6)))];
  }

  /** Compliance with the free place's row (frequency x ports x contacts). */
  ports() {
    const { place } = this.settings, n = this.inputs.length, own = n + this.points.length;
    if (!place || !this.reach) return this.skin;
    const row = this.places instanceof Anywhere ? this.places.at(/** @type {number[][]} */ (this.settings.contacts), place.position) : this.reach(place.vertex), all = zeros(this.frequency.length * (own + 1) * n);
    for (let f = 0; f < this.frequency.length; f++) for (const part of /** @type {("re" | "im")[]} */ (["re", "im"])) {
      all[part].set(this.skin[part].subarray(f * own * n, (f + 1) * own * n), f * (own + 1) * n);
      all[part].set(row[part].subarray(f * n, (f + 1) * n), (f * (own + 1) + own) * n);
    }
    return all;
  }

  /** G and forces of a device on the bins. @param {Device} device @returns {{force: Complex, transfer: Complex}} */
  loop(device) {
    return closeLoop(this.once("loop ports", () => this.ports()), this.frequency, this.inputs, this.outputs, device);
  }

  /** The forces per unit drive of the present device (bins x contacts x inputs). @returns {Complex} */
  forces() {
    return this.once("loop now", () => this.loop(this.settings.device)).force;
  }

  /** G that plays: the present device's. @returns {Placed} */
  transfer() {
    const { measured } = this, { arm } = this.settings, values = arm ? this.drawnArms[arm - 1] : measured ? measured.values : this.once("loop now", () => this.loop(this.settings.device)).transfer;
    return { values, valid: measured?.valid ?? null, error: this.error, least: this.content.least_error, outputs: this.outputs, inputs: this.inputs, bins: this.index.length, weights: this.kind === "places" || this.moved ? undefined : this.content.funneling };
  }

  /** G that the renderers aim with: the present one, or the run's if the device was not calibrated again. @returns {Placed} */
  believed() {
    if (this.settings.calibrated || this.measured) return this.transfer();
    if (this.settings.arm) return { ...this.transfer(), values: this.once("loop now", () => this.loop(this.settings.device)).transfer };
    return { ...this.transfer(), values: this.once("loop before", () => this.loop(fitted(this.original().device, this.inputs.length))).transfer };
  }

  /** G at any frequency inside the band (frequency x points x inputs), by the poles. @param {ArrayLike<number>} frequency
   * @returns {Complex} */
  transferAt(frequency) {
    if (!this.poles) throw new Error("this page knows G on the bins of its record only");
    const low = this.frequency[0], high = this.frequency[this.frequency.length - 1];
    for (const f of Array.from(frequency)) {
      if (f < low || f > high) throw new RangeError(`${f} Hz lies outside the band of ${low} to ${high} Hz that was solved`);
    }
    const skin = complianceAt(this.poles, frequency, this.inputs.length);
    return closeLoop(skin, frequency, this.inputs, this.points, this.settings.device).transfer;
  }

  /** Window of S [s], null for the whole record. @returns {[number, number] | null} */
  window() {
    const { window, wavelet } = this.settings;
    if (window === "record") return null;
    return window === "wavelet" ? windowOf(wavelet.samples, this.record) : window;
  }

  /** The wavelet's spectrum on the bins [1/Hz], and its energy on them. */
  wavelet() {
    return this.once("wavelet", () => {
      const all = toSpectrum(this.settings.wavelet.samples, this.record.rate), { index, record } = this;
      const energy = Float64Array.from(all.re, (re, k) => (k === 0 || 2 * k === record.n ? 1 : 2) * (re * re + all.im[k] ** 2));
      return {
        re: Float64Array.from(index, (k) => all.re[k]), im: Float64Array.from(index, (k) => all.im[k]),
        energy, total: energy.reduce((a, b) => a + b, 0),
      };
    });
  }

  /** Zero points of a method at a target. @param {Method} method @param {number} target @returns {number[]} */
  zerosOf(method, target) {
    const { outputs } = this, { zeros: rule } = this.settings;
    if (Array.isArray(rule)) return rule.filter((row) => row !== target && row < outputs.length);
    if (rule === "others") return outputs.map((_, i) => i).filter((i) => i !== target);
    const asked = this.content.rendering.zeros;
    if (rule === "run" && !this.settings.place) {
      const found = Array.isArray(asked) ? asked : asked === "search" ? this.content.strength.zeros?.[method]?.[this.points[target]?.name] : null;
      if (found) return found.map((/** @type {string} */ n) => this.points.findIndex((p) => p.name === n)).filter((/** @type {number} */ i) => i >= 0 && i !== target);
    }
    const corners = rule === "thesis" || (rule === "run" && asked === "thesis") ? thesisZeros(outputs, target) : null;
    return corners ?? autoZeros(outputs, target, knownInputs(this.believed()));
  }

  /** Drives, displacements and S of one method at one target. @param {Method} method @param {number} target @returns {Outcome} */
  outcome(method, target = this.settings.target) {
    return this.once(`outcome ${method} ${target}`, () => this.rendered(method, target));
  }

  /** @param {Method} method @param {number} target @returns {Outcome} */
  rendered(method, target) {
    const { rule, amplitude } = this.settings, { record, index } = this, wavelet = this.wavelet();
    const believed = this.believed(), playing = this.transfer();
    const known = this.once(`svd ${this.settings.calibrated}`, () => new Map());
    /** @type {Outcome} */
    const none = { method, problem: "", aim: null, sent: null, spectra: null, signals: [], moves: [], areas: [], strength: NaN, undriven: 1 };
    /** @type {Aim} */
    let found;
    try {
      found = aim(method, believed, target, wavelet, { zeros: this.zerosOf(method, target), rule, amplitude }, known);
    } catch (problem) {
      return { ...none, problem: problem instanceof Error ? problem.message : String(problem) };
    }
    const { spectra, lost } = respond(playing, found.spectrum);
    const moves = toTime(spectra, playing.outputs.length, index, record.n, record.rate);
    lost.forEach((share, p) => { if (share > 0.5) moves[p].fill(NaN); });
    const signals = toTime(found.spectrum, this.inputs.length, index, record.n, record.rate);
    const window = this.window(), areas = moves.map((u) => area(u, record, window));
    let driven = 0;
    found.used.forEach((used, b) => { if (used) driven += wavelet.energy[index[b]]; });
    return {
      ...none, aim: found, sent: found.spectrum, spectra, signals, moves, areas, strength: strengthOf(areas, target),
      undriven: Math.min(Math.max(1 - driven / wavelet.total, 0), 1),
    };
  }

  /** What is sent to each actuator, and nothing to one that is off. A gain is the channel's own and lies behind it: as in
   * Python's drives and limits. @param {Outcome} outcome @returns {Float64Array[]} */
  sent(outcome) {
    return outcome.signals.map((s, i) => (this.settings.device.gain[i] ? s : new Float64Array(s.length)));
  }

  /** S on a drawn arm, whichever is chosen. @param {number} arm @param {Method} method @param {number} target @returns {number} */
  strengthOn(arm, method, target) {
    return this.once(`S ${method} ${target} of ${arm}`, () => {
      const { settings, cache } = this;
      this.settings = { ...settings, arm };
      this.cache = new Map([["wavelet", this.wavelet()]]);
      try {
        return this.rendered(method, target).strength;
      } finally {
        this.settings = settings;
        this.cache = cache;
      }
    });
  }

  /** S of a method at a target, without keeping signals. @param {Method} method @param {number} target */
  strength(method, target) {
    return this.once(`S ${method} ${target}`, () => this.rendered(method, target).strength);
  }

  /** Whether S is that of the run: nothing changed but target and view. @returns {boolean} */
  get asRun() {
    if (this.kind === "places" || this.moved || this.settings.arm) return false;
    const now = this.settings, then = this.original();
    return now.place === null && now.zeros === "run" && JSON.stringify([now.rule, now.window]) === JSON.stringify([then.rule, then.window])
      && now.wavelet.kind === then.wavelet.kind && now.wavelet.name === then.wavelet.name && sameDevice(now.device, then.device);
  }

  /** The run's interval of S as long as nothing is changed, then that of draws made here; null where there is none.
   * @param {Method} method @param {number} target @returns {[number, number] | null} */
  interval(method, target) {
    if (!this.asRun) {
      const half = this.drawn?.key === this.question ? this.drawn.half[METHODS.indexOf(method)][target] : NaN, s = this.strength(method, target);
      return Number.isFinite(half) && Number.isFinite(s) ? [s * Math.exp(-half), s * Math.exp(half)] : null;
    }
    const row = this.content.strength.methods?.[method]?.[this.points[target]?.name];
    return row && row.low !== null && row.high !== null ? [row.low, row.high] : null;
  }

  /** Names all settings that an interval depends on: everything but the target. */
  get question() {
    const { zeros, rule, amplitude, window, wavelet, device, calibrated, place, contacts, arm } = this.settings;
    return JSON.stringify([zeros, rule, amplitude, window, wavelet.name, { ...device, spring: device.spring.map(String) }, calibrated, place?.vertex, contacts, arm]);
  }

  /** S over arms [lower, middle, upper] that a prediction of this very scenario found, null otherwise.
   * @param {Method} method @param {number} target @returns {number[] | null} */
  arms(method, target) {
    const found = this.asRun && this.content.arms?.methods[method]?.[this.points[target]?.name];
    if (!found) return null;
    const last = found.length - 1, band = [found[0], found[last / 2], found[last]];
    return band.every(Number.isFinite) ? band : null;
  }

  /** Another stimulus. @param {{kind: "ricker", peak: number} | {kind: "burst", frequency: number, cycles: number}
   *   | {kind: "own", name: string, samples: Float64Array}} asked */
  stimulate(asked) {
    const { record } = this;
    this.drawn = null; // other samples may have the same name
    if (asked.kind === "ricker") this.set({ wavelet: ricker(asked.peak, record) });
    else if (asked.kind === "burst") this.set({ wavelet: burst(asked.frequency, asked.cycles, record) });
    else this.set({ wavelet: { samples: placed(asked.samples, record), name: asked.name, kind: "own" } });
  }
}

/** @param {Device} a @param {Device} b */
function sameDevice(a, b) {
  const plain = (/** @type {Device} */ d) => JSON.stringify({ ...d, spring: d.spring.map(String) });
  return plain(a) === plain(b);
}

/** A device with another number of actuators: new ones touch in full. @param {Device} device @param {number} n @returns {Device} */
export function fitted(device, n) {
  const all = Array.from({ length: n }, (_, k) => k);
  return { ...device, touching: all.map((k) => device.touching[k] ?? true), gain: all.map((k) => device.gain[k] ?? 1), spring: all.map((k) => device.spring[k] ?? Infinity) };
}
