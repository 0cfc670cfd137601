/**
 * What is kept of the page: pictures, films, signals, G, and the scenario that reproduces it.
 *
 * @typedef {import("./main.js").App} App
 */
import { $, h, mark } from "./dom.js";
import { METHODS } from "./experiment.js";
import { transferCsv, transferJson, writeCsv, writeToml, writeWav } from "./files.js";
import { CLASS } from "./readouts.js";
import { timeOf } from "./signals.js";

/** @param {App} app */
export function exportsPanel(app) {
  const make = (/** @type {string} */ text, /** @type {string} */ id, /** @type {() => void} */ act) => h("button", { type: "button", id, text, onclick: () => { try { act(); } catch (problem) { app.say(/** @type {Error} */ (problem).message, true); } } });
  return h("details", {}, h("summary", { text: "Keep" }), h("div", { class: "row" },
    make("PNG", "png", () => void picture(app)), make("SVG", "svg", () => save(app, ".svg", charts(app), "image/svg+xml")), make("film", "film", () => film(app)),
    make("signals CSV", "csv", () => save(app, ".csv", signals(app), "text/csv")), make("drives WAV", "wav", () => save(app, `-${app.focus.replace(" ", "-")}.wav`, drives(app), "audio/wav")),
    make("G CSV", "gcsv", () => save(app, "-G.csv", gAsCsv(app), "text/csv")), make("G JSON", "gjson", () => save(app, "-G.json", gAsJson(app), "application/json")),
    make("scenario TOML", "toml", () => scenario(app)), make("print", "print", () => print())),
  h("p", { class: "soft", style: "margin:6px 0 0;font-size:12px", text: "WAV: floating point, 1.0 is one volt, a channel per actuator, before its gain. TOML: what is seen, for forearm-fem run." }));
}

/** @param {App} app @param {string} ending @param {BlobPart} content @param {string} type */
function save(app, ending, content, type) {
  const link = h("a", { download: `${nameOf(app)}${ending}`, href: URL.createObjectURL(new Blob([content], { type })) });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

/** A name that files may have. @param {App} app */
function nameOf(app) {
  return app.experiment.content.name.replace(/[^\p{L}\p{N}._-]+/gu, "-").replace(/^[-.]+|-+$/g, "").slice(0, 60) || "workbench";
}

/** What was seen, in a line. @param {App} app */
export function caption(app) {
  const { experiment } = app, { settings } = experiment;
  return `${experiment.content.name}, target ${experiment.outputs[settings.target].name}, ${settings.wavelet.name}, t = ${(1e3 * app.arms.time).toFixed(1)} ms; ${experiment.content.stamp}`;
}

/** The arms as seen, with names, S and scales. @param {App} app @returns {HTMLCanvasElement} */
function composed(app) {
  const { body, over } = app.arms.parts, s = app.arms.sharp, out = /** @type {HTMLCanvasElement} */ (h("canvas", { width: over.width, height: over.height + Math.round(26 * s) }));
  const g = /** @type {CanvasRenderingContext2D} */ (out.getContext("2d")), style = getComputedStyle(document.documentElement), ink = (/** @type {string} */ n) => style.getPropertyValue(n).trim();
  g.fillStyle = ink("--paper"); g.fillRect(0, 0, out.width, out.height);
  g.drawImage(body, 0, 0, over.width, over.height);
  g.drawImage(over, 0, 0);
  g.setTransform(s, 0, 0, s, 0, 0);
  app.arms.boxes().forEach((box, i) => {
    const slot = app.slots[i];
    if (!slot) return;
    const { method, experiment, title, key } = slot, o = experiment.outcome(method);
    g.fillStyle = ink(`--${CLASS[method]}`); g.font = "600 14px system-ui, sans-serif"; g.fillText(`${title}${method}`, box.x + 14, box.y + 24);
    g.fillStyle = ink("--ink"); g.font = "600 20px system-ui, sans-serif"; g.fillText(o.problem ? "" : `S ${o.strength.toPrecision(3)}`, box.x + 14, box.y + 48);
    const range = experiment.interval(method, experiment.settings.target);
    if (range) { g.fillStyle = ink("--soft"); g.font = "11px system-ui, sans-serif"; g.fillText(`${range.map((v) => v.toPrecision(3)).join(" to ")} by the errors of G`, box.x + 14, box.y + 64); }
    g.fillStyle = ink("--soft"); g.font = "11px system-ui, sans-serif"; g.fillText(app.arms.words(method, experiment, key), box.x + 14, box.y + box.h - 12);
  });
  g.fillStyle = ink("--soft"); g.font = "11px system-ui, sans-serif"; g.fillText(caption(app), 10, over.height / s + 17);
  return out;
}

/** The same with as many pixels as a still picture deserves, for paper and slides. @param {App} app */
export function still(app) {
  const { arms, experiment } = app, before = [arms.sharp, arms.scale];
  arms.sharp = arms.scale = 2;
  arms.draw(experiment);
  const out = composed(app);
  [arms.sharp, arms.scale] = before;
  arms.draw(experiment);
  return out;
}

/** @param {App} app */
async function picture(app) {
  const blob = await new Promise((done) => still(app).toBlob(done, "image/png"));
  if (blob) save(app, ".png", blob, "image/png");
}

const FRAME = 40, MOST_FRAMES = 500; // [ms]

/** One passage of the waves as WebM. @param {App} app */
function film(app) {
  const screen = composed(app);
  if (typeof MediaRecorder === "undefined" || !screen.captureStream) throw new Error("this browser records no films; PNG and print work");
  const g = /** @type {CanvasRenderingContext2D} */ (screen.getContext("2d")), recorder = new MediaRecorder(screen.captureStream(1e3 / FRAME), { mimeType: "video/webm", videoBitsPerSecond: 5e6 });
  /** @type {Blob[]} */
  const parts = [];
  recorder.ondataavailable = (e) => parts.push(e.data);
  const [from, to] = app.span, before = { playing: app.playing, time: app.arms.time };
  app.playing = false;
  let shown = 0, timer = 0;
  // by numbers of frames, not by the clock: a slow machine makes the same film, only longer
  const next = () => {
    const time = from + shown++ * (FRAME / 1e3) * app.speed;
    if (time > to || shown > MOST_FRAMES) { clearInterval(timer); setTimeout(() => recorder.stop(), 5 * FRAME); return; }
    app.arms.time = time;
    app.arms.draw(app.experiment);
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.drawImage(composed(app), 0, 0);
    $("wait").textContent = `film: ${Math.round((100 * (time - from)) / (to - from))} %`;
  };
  recorder.onstart = () => { timer = setInterval(next, FRAME); };
  recorder.onstop = () => {
    $("wait").textContent = "";
    app.playing = before.playing;
    app.arms.time = before.time;
    const film = new Blob(parts, { type: "video/webm" });
    if (film.size > 1000) save(app, ".webm", film, "video/webm");
    else app.say("this browser recorded no picture; try once more, or keep PNGs", true);
  };
  recorder.start();
}

/** All charts under each other, with their own styles. @param {App} app */
export function charts(app) {
  const style = getComputedStyle(document.documentElement), all = /** @type {SVGElement[]} */ (Array.from(document.querySelectorAll("#traces .chart, #spectra .chart")));
  const fill = (/** @type {string} */ text) => text.replace(/var\((--[a-z0-9]+)\)/g, (_, n) => style.getPropertyValue(n).trim());
  const body = all.map((svg, k) => { const copy = /** @type {SVGElement} */ (svg.cloneNode(true)); copy.setAttribute("x", String(440 * (k % 2))); copy.setAttribute("y", String(250 * Math.floor(k / 2) + 24)); copy.setAttribute("width", "420"); copy.setAttribute("height", "190");
    if (svg.closest("#traces")) mark(copy, 1e3 * app.arms.time, /** @type {[number, number]} */ (app.span.map((t) => 1e3 * t)));
    return `<text x="${440 * (k % 2) + 46}" y="${250 * Math.floor(k / 2) + 18}" font-weight="600">${escaped(svg.getAttribute("aria-label") ?? "")}</text>${fill(new XMLSerializer().serializeToString(copy))}${legendOf(svg, 440 * (k % 2) + 46, 250 * Math.floor(k / 2) + 226)}`; }).join("\n");
  const height = 250 * Math.ceil(all.length / 2) + 30, css = fill(".grid{stroke:var(--grid)}.zero{stroke:var(--soft);stroke-width:.7}.cursor{stroke:var(--ink)}.limit{stroke:var(--warn);stroke-dasharray:5 3}.shade{fill:var(--field)}text{fill:var(--ink);font-family:Arial,sans-serif}");
  return `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 870 ${height}" font-size="10"><style>${css}</style><rect width="870" height="${height}" fill="${style.getPropertyValue("--paper").trim()}"/>${body}<text x="10" y="${height - 8}">${escaped(caption(app))}</text></svg>`;
}

/** What a chart's colours stand for, from the legend beside it, as SVG from (x, y). @param {Element} chart @param {number} x @param {number} y */
function legendOf(chart, x, y) {
  const beside = (chart.closest(".plot") ?? chart).nextElementSibling;
  let at = x, row = y;
  return Array.from(beside?.className === "legend" ? beside.children : [], (entry) => {
    const line = /** @type {Element} */ (entry.firstElementChild), text = entry.textContent ?? "", width = 26 + 5.2 * text.length;
    if (at > x && at + width > x + 380) { at = x; row += 13; }
    const drawn = `<line x1="${at}" x2="${at + 14}" y1="${row - 3.5}" y2="${row - 3.5}" stroke="${getComputedStyle(line).borderTopColor}" stroke-width="2"${line.className ? ' stroke-dasharray="4 2"' : ""}/><text x="${at + 18}" y="${row}">${escaped(text)}</text>`;
    at += width;
    return drawn;
  }).join("");
}

/** @param {string} text */
const escaped = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;").replace(/>/g, "&gt;");

/** Displacements and drives while they are shown. @param {App} app */
export function signals(app) {
  const { experiment } = app, { record } = experiment, [first, last] = app.shownSamples;
  /** @type {Record<string, ArrayLike<number>>} */
  const columns = { time_s: Float64Array.from({ length: last - first }, (_, j) => timeOf(record, first + j)) }, unit = experiment.content.unit.split("/")[1];
  for (const method of METHODS) {
    const o = experiment.outcome(method), short = method.replace(" ", "_");
    o.moves.forEach((u, i) => { columns[`${short}_u_${experiment.outputs[i].name}_m`] = u.subarray(first, last); });
    experiment.sent(o).forEach((s, i) => { columns[`${short}_drive_${experiment.inputs[i].name}_${unit}`] = s.subarray(first, last); });
  }
  return writeCsv(columns, [caption(app), ...METHODS.map((m) => `S ${m}: ${experiment.outcome(m).strength}`)]);
}

/** @param {App} app */
export function drives(app) {
  const { outcome, experiment } = app;
  if (!outcome.signals.length) throw new Error(outcome.problem);
  if (!experiment.content.unit.endsWith("/V")) throw new Error(`drives of a G in ${experiment.content.unit} are no volts, as which a WAV file is played; keep the signals as CSV`);
  return writeWav(experiment.sent(outcome), experiment.record.rate);
}

/** G of the points as it plays; invalid entries NaN. @param {App} app */
function ownG(app) {
  const { experiment } = app, g = experiment.transfer(), m = g.outputs.length, n = g.inputs.length, kept = experiment.points.length, out = { re: new Float64Array(g.bins * kept * n), im: new Float64Array(g.bins * kept * n) };
  for (let b = 0; b < g.bins; b++) for (let p = 0; p < kept; p++) for (let i = 0; i < n; i++) {
    const from = (b * m + p) * n + i, to = (b * kept + p) * n + i, known = !g.valid || g.valid[from];
    out.re[to] = known ? g.values.re[from] : NaN;
    out.im[to] = known ? g.values.im[from] : NaN;
  }
  return out;
}

/** @param {App} app */
export function gAsCsv(app) {
  const { experiment } = app;
  return transferCsv(experiment.frequency, ownG(app), experiment.points, experiment.inputs, experiment.content.unit);
}

/** @param {App} app */
export function gAsJson(app) {
  const { experiment } = app;
  return transferJson(experiment.frequency, ownG(app), experiment.points.map((p) => p.name), experiment.inputs.map((p) => p.name), experiment.content.unit, experiment.content.stamp);
}

/** @param {App} app */
function scenario(app) {
  const { wavelet } = app.experiment.settings;
  save(app, ".toml", scenarioToml(app), "application/toml");
  if (hasOwnFile(wavelet)) save(app, "-stimulus.csv", writeCsv({ sample: wavelet.samples }, [wavelet.name]), "text/csv");
}

/**
 * The scenario with what was changed here; an Error where no scenario can say it.
 * @param {App} app @returns {string}
 */
export function scenarioToml(app) {
  const { experiment } = app, { settings, content } = experiment, then = experiment.original(), { device } = settings;
  if (experiment.kind === "transfer") throw new Error("this page holds a G that was given, not a scenario; keep G and signals as CSV instead");
  if (settings.arm) throw new Error("a drawn arm is no scenario: forearm-fem predict draws it; go back to the run's own arm, or keep signals and G");
  const cannot = [device.gain.some((g) => g === 0) && "an actuator that is off", !settings.calibrated && "a device that was not measured again"].filter(Boolean);
  if (cannot.length) throw new Error(`a scenario has no key for ${cannot.join(", ")}: set ${cannot.length > 1 ? "them" : "it"} back to keep a scenario, or keep signals and G as CSV`);
  const table = structuredClone(content.scenario), notes = [];
  table.name = `${content.name}-workbench`;
  const put = (/** @type {string} */ path, /** @type {any} */ value) => { const keys = path.split("."), last = /** @type {string} */ (keys.pop()); let at = table; for (const k of keys) at = at[k] ??= {}; at[last] = value; };
  for (const key of /** @type {const} */ (["resistance", "inductance", "force_factor", "moving_mass", "resonance", "quality"])) if (device.coil[key] !== then.device.coil[key]) put(`device.coil.${key}`, device.coil[key]);
  if (device.cone.mass !== then.device.cone.mass) put("device.cone.mass", device.cone.mass);
  if (device.housing.fixed !== then.device.housing.fixed) put("device.housing", device.housing.fixed ? { fixed: true } : {});
  const without = (/** @type {string} */ part, /** @type {string[]} */ keys) => { for (const key of keys) if (table[part]) delete table[part][key]; };
  const named = (/** @type {(k: number) => number | null} */ value) => Object.fromEntries(experiment.inputs.map((p, k) => [p.name, value(k)]).filter(([, v]) => v !== null));
  put("device.out_of_contact", experiment.inputs.filter((_, k) => !device.touching[k]).map((p) => p.name));
  put("device.gains", named((k) => (device.gain[k] === 1 ? null : device.gain[k])));
  put("device.contact_springs", named((k) => (Number.isFinite(device.spring[k]) && device.touching[k] ? device.spring[k] : null)));
  if ((experiment.kind === "places" || experiment.moved) && settings.contacts) {
    const [c, s] = [Math.cos(content.device.rotation ?? 0), Math.sin(content.device.rotation ?? 0)];
    without("device", ["rows", "columns", "spacing", "spacing_y", "stagger"]);
    put("device.contacts", settings.contacts.map(([x, y]) => [c * x + s * y, -s * x + c * y].map((v) => Number(v.toFixed(6)))));
    if (experiment.kind === "places") notes.push("run it with --library and the library that this page was made of, or without for a solve");
  }
  put("rendering.methods", METHODS);
  put("rendering.amplitude", settings.amplitude);
  put("rendering.window", settings.window);
  put("rendering.regularisation", settings.rule?.kind ?? "auto");
  if (settings.rule) put("rendering.regularisation_value", settings.rule.value);
  else if (table.rendering) delete table.rendering.regularisation_value;
  if (settings.wavelet.kind === "ricker") { put("rendering.wavelet.peak", settings.wavelet.peak); delete table.rendering.wavelet.file; }
  else if (hasOwnFile(settings.wavelet)) { put("rendering.wavelet", { file: `${nameOf(app)}-stimulus.csv` }); notes.push("its stimulus lies beside it, kept at the same time"); }
  const target = experiment.outputs[settings.target].name;
  if (settings.place) { put("grid", { points: placesOf(app) }); notes.push("the free place is the last point: it is solved anew, so S there agrees within the errors stated"); }
  const last = String(experiment.points.length + 1), zeros = experiment.zerosOf("inverse filter", settings.target).map((i) => (i < experiment.points.length ? experiment.outputs[i].name : last));
  put("rendering.targets", settings.zeros === "run" && !settings.place ? content.rendering.targets : [settings.place ? last : target]);
  if (settings.zeros !== "run" || settings.place) put("rendering.zeros", zeros);
  if (/"(file|path|surface|surfaces)"/.test(JSON.stringify(content.scenario))) notes.push("it names files: keep it beside the scenario it came from");
  const lines = [`from the workbench: ${caption(app)}`, `S at ${target}: ${METHODS.map((m) => `${m} ${experiment.outcome(m).strength.toPrecision(6)}`).join(", ")}`, ...notes];
  return lines.map((l) => `# ${l.replace(/[\r\n\u0000-\u001f\u007f]+/g, " ")}\n`).join("") + writeToml(table);
}

/** Whether a scenario needs samples that no file holds yet. @param {import("./signals.js").Wavelet} wavelet */
const hasOwnFile = (wavelet) => wavelet.kind === "burst" || wavelet.kind === "own";

/** All points and the free place in the device's own frame [m]. @param {App} app @returns {number[][]} */
function placesOf(app) {
  const { experiment } = app, { content, outputs } = experiment, [a, b] = content.device.centres, p = experiment.inputs[0].position, q = experiment.inputs[1]?.position;
  if (!q) throw new Error("a free place needs two actuators to be written in the device's frame");
  // the similarity that takes the actuators from the skin seen from above to the device's frame
  const [dx, dy, ex, ey] = [q[0] - p[0], q[1] - p[1], b[0] - a[0], b[1] - a[1]], size = dx * dx + dy * dy, c = (ex * dx + ey * dy) / size, s = (ey * dx - ex * dy) / size;
  return outputs.map((o) => { const x = o.position[0] - p[0], y = o.position[1] - p[1]; return [a[0] + c * x - s * y, a[1] + s * x + c * y].map((v) => Number(v.toFixed(7))); });
}
