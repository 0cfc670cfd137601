/** The page comes alive: content, experiment, arms, and everything around them. */
import { App } from "./app.js";
import { Arms, stopsOf } from "./arms.js";
import { aimAt, controls, keys, pointer, transport } from "./controls.js";
import { $, say } from "./dom.js";
import { Experiment, METHODS } from "./experiment.js";
import { caption, charts, drives, gAsCsv, gAsJson, scenarioToml, signals, still } from "./exports.js";
import { Field } from "./field.js";
import { cursor, errors, heads, spectra, table, traces } from "./readouts.js";

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
