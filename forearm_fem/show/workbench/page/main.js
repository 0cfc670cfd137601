/** The page comes alive: what its parts share, and everything around them. */
import { Arms, stopsOf } from "./arms.js";
import { aimAt, controls, keys, pointer, transport } from "./controls.js";
import { $, say } from "./dom.js";
import { Experiment, METHODS } from "./experiment.js";
import { caption, charts, drives, gAsCsv, gAsJson, scenarioToml, signals, still } from "./exports.js";
import { Field } from "./field.js";
import { Anywhere } from "./moves.js";
import { cursor, errors, heads, spectra, table, traces } from "./readouts.js";
import { halves, noiseOf, timeOf, whyNone } from "./signals.js";

/**
 * What the parts of the page share, and the order in which things are worked out again after a change.
 *
 * @typedef {import("./experiment.js").Settings} Settings
 * @typedef {import("./experiment.js").Method} Method
 * @typedef {import("./experiment.js").Outcome} Outcome
 * @typedef {{name: string, frequency: Float64Array, values: import("./numeric.js").Complex, told: boolean}} Overlay a measured G
 */

const BEFORE = 0.012, AFTER = 0.045, HEARD = 1e-3;
const PATIENCE = 250, SLICE = 12; // [ms] before intervals are drawn, and of work at a time

class App {
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

/** The page comes alive: content, experiment, arms, and everything around them. */

const SLOW = 45, COARSEST = 0.7; // [ms] between frames, pixels per css pixel
const STILL = 2, AT_REST = 200; // pixels per css pixel of a still picture, [ms] until it is one

const began = performance.now();

/** @param {string} text @param {boolean} [bad] */
function tell(text, bad = false) {
  $("say").textContent = text;
  $("say").className = bad ? "bad" : "";
}

/** @param {unknown} problem */
function failed(problem) {
  $("wait").textContent = "";
  tell(`The page cannot show this: ${problem instanceof Error ? problem.message : String(problem)}`, true);
}

/** Title, colours and what is known before anything is computed. @param {any} content */
function head(content) {
  $("name").textContent = content.name;
  $("description").textContent = content.description;
  $("stamp").textContent = `${content.stamp}${content.stamp.includes("forearm_fem") ? "" : ` · forearm_fem ${content.program}`} · e^{+iωt}, displacement positive out of the skin`;
}

/** @param {Arms} arms @param {() => void} redraw */
function themes(arms, redraw) {
  const root = document.documentElement, dark = matchMedia("(prefers-color-scheme: dark)");
  const put = (/** @type {string} */ name) => {
    root.dataset.theme = arms.theme = name;
    const bar = $("bar"), g = bar.getContext("2d"), fill = g.createLinearGradient(0, 0, 256, 0);
    stopsOf(name).forEach((c, k) => fill.addColorStop(k / 4, c));
    g.fillStyle = fill;
    g.fillRect(0, 0, 256, 1);
    redraw();
  };
  const turn = () => put(root.dataset.theme === "dark" ? "light" : "dark");
  $("theme").addEventListener("click", turn);
  dark.addEventListener("change", () => put(dark.matches ? "dark" : "light"));
  let before = "light";
  addEventListener("beforeprint", () => { before = root.dataset.theme ?? "light"; put("light"); });
  addEventListener("afterprint", () => put(before));
  put(dark.matches ? "dark" : "light");
  return turn;
}

/** @param {App} app @param {ReturnType<typeof transport>} bar */
function animate(app, bar) {
  let last = performance.now(), slow = 0, told = NaN, moved = last, coarse = app.arms.scale, looked = "";
  const step = (/** @type {number} */ now) => {
    const passed = Math.min(now - last, 200) / 1e3;
    last = now;
    const [from, to] = app.span;
    if (app.playing && !document.hidden) {
      app.arms.scale = coarse;
      app.arms.time += passed * app.speed;
      if (app.arms.time > to) app.arms.time = from + ((app.arms.time - from) % (to - from));
      app.arms.turn(app.experiment);
      // drawing goes on after the call, so what counts is how far frames are apart; fewer pixels where they are too far
      slow = 0.9 * slow + 100 * passed;
      if (slow > SLOW && coarse > COARSEST) { coarse = Math.max(COARSEST, coarse * 0.85); slow = 0; }
    } else if (app.arms.drawnAt !== app.arms.time || app.arms.lookedAt !== looked) {
      [moved, looked, app.arms.scale] = [now, app.arms.lookedAt, coarse];
      if (app.arms.drawnAt !== app.arms.time) app.arms.turn(app.experiment);
    } else if (now - moved > AT_REST && app.arms.scale !== STILL) {
      app.arms.scale = STILL;
      app.arms.move();
    }
    if (told !== app.arms.time) {
      told = app.arms.time;
      bar.scrub.value = String(Math.round((1000 * (told - from)) / (to - from)));
      $("now").textContent = `t = ${(1e3 * told).toFixed(1).replace("-", "−")} ms`;
      cursor(app);
    }
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
  new ResizeObserver(() => app.arms.draw(app.experiment)).observe($("stage"));
}

/** @param {any} content @param {Field} field @param {Arms} arms @param {() => void} ready */
function start(content, field, arms, ready) {
  const experiment = new Experiment(content), app = new App(experiment, field, arms);
  app.say = tell;
  const bar = transport(app);
  const turn = themes(arms, () => arms.draw(experiment));
  app.listeners.push(() => heads(app), () => traces(app), () => spectra(app), () => table(app, (row) => aimAt(app, row)), () => errors(app), () => {
    const shown = arms.shown.get(app.focus), limit = shown?.limit ?? (arms.live ? arms.largest(experiment, app.focus) : 0);
    const most = limit ? `${say(1e6 * limit, 2)} µm` : "";
    $("low").textContent = most && (shown?.rms ? "0" : `−${most}`);
    $("high").textContent = most && (shown?.rms ? `${most} rms` : `+${most} outwards`);
    $("bar").style.objectPosition = shown?.rms ? "right" : "";
    $("bar").classList.toggle("half-bar", Boolean(shown?.rms));
    $("scale").textContent = shown?.rms ? `${app.focus}; rms over ${app.span.map((t) => (1e3 * t).toFixed(0)).join(" to ").replace(/-/g, "−")} ms, along the skin's normal` : shown ? `${app.focus}; ${arms.section ? "on the cut: motion towards the volar side" : "displacement along the skin's normal"}` : "";
  });
  // paper has another width than the screen: it gets a picture, drawn after the colours for paper are put
  addEventListener("beforeprint", () => $("printed").replaceChildren(still(app)));
  addEventListener("afterprint", () => $("printed").replaceChildren());
  controls(app);
  keys(app, bar, turn);
  pointer(app);
  app.refresh();
  app.playing = false; // still, at the moment that everything aims at
  arms.time = app.moment;
  bar.said();
  arms.draw(experiment);
  animate(app, bar);
  // read by the tests, and by whoever wants numbers in the browser's console
  Object.assign(globalThis, { workbench: { app, experiment, field, arms, METHODS, began, exports: { caption: () => caption(app), charts: () => charts(app), drives: () => drives(app), gAsCsv: () => gAsCsv(app), gAsJson: () => gAsJson(app), scenarioToml: () => scenarioToml(app), signals: () => signals(app) } } });
  ready();
}

try {
  const content = JSON.parse(/** @type {HTMLElement} */ (document.getElementById("content")).textContent ?? "");
  head(content);
  const field = new Field(content.field, content.inputs.length);
  const arms = new Arms(field, content, { body: $("bodies"), over: $("over"), panels: Array.from(document.querySelectorAll(".panel")) });
  arms.theme = document.documentElement.dataset.theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  arms.draw(null);
  document.body.dataset.first = String(Math.round(performance.now()));
  setTimeout(() => {
    try {
      start(content, field, arms, () => { $("wait").textContent = ""; document.body.dataset.ready = String(Math.round(performance.now())); });
    } catch (problem) {
      failed(problem);
      throw problem;
    }
  }, 30);
} catch (problem) {
  failed(problem);
  throw problem;
}
