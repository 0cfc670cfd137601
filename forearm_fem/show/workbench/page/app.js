/**
 * What the parts of the page share, and the order in which things are worked out again after a change.
 *
 * @typedef {import("./experiment.js").Settings} Settings
 * @typedef {import("./experiment.js").Method} Method
 * @typedef {import("./experiment.js").Outcome} Outcome
 * @typedef {{name: string, frequency: Float64Array, values: import("./arrays.js").Complex, told: boolean}} Overlay a measured G
 */
import { Arms } from "./arms.js";
import { Anywhere } from "./anywhere.js";
import { Experiment, METHODS } from "./experiment.js";
import { halves, noiseOf, whyNone } from "./interval.js";
import { timeOf } from "./wavelet.js";

const BEFORE = 0.012, AFTER = 0.045, HEARD = 1e-3;
const PATIENCE = 250, SLICE = 12; // [ms] before intervals are drawn, and of work at a time

export class App {
  /** @param {import("./experiment.js").Experiment} experiment @param {import("./field.js").Field} field @param {Arms} arms */
  constructor(experiment, field, arms) {
    this.experiment = experiment;
    this.field = field;
    this.arms = arms;
    experiment.reach = (vertex) => /** @type {any} */ (field.reach(vertex));
    /** @type {Method} */
    this.focus = "inverse filter";
    this.playing = true;
    this.speed = 1 / 40;
    this.factor = 1;
    this.same = false;
    /** @type {Overlay | null} */
    this.overlay = null;
    /** @type {[number, number]} */
    this.span = [-0.02, 0.06];
    /** @type {(() => void)[]} */
    this.listeners = [];
    /** @type {(text: string, bad?: boolean) => void} */
    this.say = () => {};
    this.version = 0;
    /** Where the actuators stood when the picture was worked out. @type {number[][] | null} */
    this.stood = null;
    /** A device kept to be compared with the present one, and whether both are seen. @type {Experiment | null} */
    this.kept = null;
    this.beside = false;
    /** Whether colours are rms over the passage, not the motion at an instant. */
    this.map = false;
    field.anywhere = experiment.places instanceof Anywhere ? experiment.places : null;
  }

  /** Keep the present device beside what is changed from now on; null forgets it. @param {boolean} keep */
  keep(keep) {
    this.kept = null;
    this.beside = keep;
    if (keep) {
      this.kept = new Experiment(this.experiment.content);
      this.kept.reach = this.experiment.reach;
      this.kept.set(this.experiment.settings);
    }
    this.refresh();
  }

  /** What each panel of the picture shows. @returns {import("./arms.js").Slot[]} */
  get slots() {
    const { experiment, kept, focus } = this;
    if (kept && this.beside) return [{ key: `kept ${focus}`, method: focus, experiment: kept, title: "kept device: " }, { key: focus, method: focus, experiment, title: "device now: " }];
    return METHODS.map((method) => ({ key: method, method, experiment, title: "" }));
  }

  /** Put a method in focus: scales and drives are its own, and a still picture goes to its moment. @param {Method} method */
  attend(method) {
    this.focus = method;
    if (!this.playing) this.arms.time = this.moment;
    this.rescale();
  }

  /** Change settings and work everything out again; a change that cannot be is said, and undone. @param {Partial<Settings>} change */
  set(change) {
    const before = this.experiment.settings;
    try {
      this.experiment.set(change);
      this.refresh();
      this.say(""); // what was said of an earlier change is no longer so
    } catch (problem) {
      this.experiment.set(before);
      this.refresh();
      this.say(problem instanceof Error ? problem.message : String(problem), true);
    }
  }

  /** Everything that follows from the settings. */
  refresh() {
    const { experiment, field, arms } = this, { record, index } = experiment;
    this.version++;
    this.follow();
    this.span = this.shownSpan();
    if (this.kept) {
      const { target, place, zeros, rule, amplitude, window, wavelet } = experiment.settings;
      this.kept.set({ target, place, zeros, rule, amplitude, window, wavelet });
    }
    arms.slots = this.slots;
    /** @type {[import("./arms.js").Slot, import("./field.js").Track][]} */
    const tracks = [];
    arms.shown.clear();
    for (const slot of arms.slots) {
      const { experiment: own } = slot, o = own.outcome(slot.method);
      if (!o.sent || !o.spectra || own.settings.arm) continue; // of a drawn arm only the points are known
      const force = own.changeable ? own.forces() : null;
      tracks.push([slot, field.track(force, o.sent, o.spectra, index, record.n / record.rate, this.span, own.settings.contacts)]);
    }
    this.show(tracks);
    const { device } = experiment.settings;
    arms.live = experiment.settings.arm > 0;
    arms.lifted = device.touching.map((t, k) => !t || device.gain[k] === 0);
    arms.keptInputs = this.kept ? this.kept.inputs : [];
    if (!(arms.time >= this.span[0] && arms.time <= this.span[1])) arms.time = this.span[0];
    for (const tell of this.listeners) tell();
    arms.draw(experiment);
    this.drawIntervals();
  }

  /** The picture and the bodies go where the actuators are. */
  follow() {
    const { experiment, field, arms } = this, { places, settings } = experiment;
    if (!places || !settings.contacts || this.stood === settings.contacts) return;
    this.stood = settings.contacts;
    if (!(places instanceof Anywhere)) field.amplitudes = places.picture(settings.contacts);
    arms.stand(experiment.inputs);
  }

  /** Intervals of S for changed settings, little by little; given up as soon as something else is changed. */
  drawIntervals() {
    const { experiment, version } = this, key = experiment.question;
    if (experiment.asRun || experiment.settings.arm || experiment.drawn?.key === key || whyNone(experiment.content, experiment.errors)) return;
    const work = halves(experiment, METHODS, noiseOf(1));
    const slice = () => {
      if (version !== this.version) return;
      const end = performance.now() + SLICE;
      let step = work.next();
      while (!step.done && performance.now() < end) step = work.next();
      if (!step.done) { setTimeout(slice, 0); return; }
      experiment.drawn = { key, half: step.value };
      for (const tell of this.listeners) tell();
    };
    setTimeout(slice, PATIENCE);
  }

  /** Where all arms' colours end [m]; null where each has its own. */
  get common() {
    return this.same || (this.kept && this.beside) ? Math.max(...this.slots.map((s) => this.arms.largest(s.experiment, s.method))) : null; // two devices are compared on one scale
  }

  /** The instant at which the target moves most [s]. */
  get moment() {
    const { experiment } = this, { record } = experiment, u = this.outcome.moves[experiment.settings.target];
    if (!u) return 0;
    let best = 0;
    u.forEach((v, j) => { if (Math.abs(v) > Math.abs(u[best])) best = j; });
    return Math.min(Math.max(timeOf(record, best), this.span[0]), this.span[1]);
  }

  /** Samples [from, to) of the record that are shown. @returns {[number, number]} */
  get shownSamples() {
    const { record } = this.experiment, [from, to] = this.span, first = Math.max(0, Math.round((from - timeOf(record, 0)) * record.rate));
    return [first, Math.min(record.n, first + Math.round((to - from) * record.rate) + 1)];
  }

  /** Colours and magnification of all panels: each its own, or the same. @param {[import("./arms.js").Slot, import("./field.js").Track][]} tracks */
  show(tracks) {
    const { arms, common, factor, map } = this, reach = common === null ? 0 : Math.max(0, ...tracks.map(([, track]) => arms.highest(track)));
    for (const [slot, track] of tracks) arms.show(slot, track, factor, common, map, reach);
  }

  /** Scales alone, without new drives. */
  rescale() {
    const { experiment, arms } = this;
    if (this.kept && this.beside && !arms.shown.has(this.focus)) return this.refresh(); // another method has other tracks
    this.show(arms.slots.flatMap((slot) => { const shown = arms.shown.get(slot.key); return shown ? [[slot, shown.track]] : []; }));
    for (const tell of this.listeners) tell();
    arms.draw(experiment);
  }

  /** From a little before the wavelet is heard to when its waves have passed [s]. @returns {[number, number]} */
  shownSpan() {
    const { record, settings } = this.experiment, { samples } = settings.wavelet;
    const most = samples.reduce((a, v) => Math.max(a, Math.abs(v)), 0);
    let first = record.n, last = 0;
    samples.forEach((v, j) => { if (Math.abs(v) > HEARD * most) { first = Math.min(first, j); last = j; } });
    return [Math.max(timeOf(record, first) - BEFORE, timeOf(record, 0)), Math.min(timeOf(record, last) + AFTER, timeOf(record, record.n - 1))];
  }

  /** @returns {Outcome} of the method in focus */
  get outcome() {
    return this.experiment.outcome(this.focus);
  }
}
