/**
 * What is read beside the arms: S, displacements, drives and limits, spectra, conditioning, errors.
 *
 * @typedef {import("./app.js").App} App
 * @typedef {import("./experiment.js").Method} Method
 * @typedef {import("./plots.js").Series} Series
 */
import { METHODS } from "./experiment.js";
import { $, h, replace, say, sayUnit } from "./dom.js";
import { between } from "./files.js";
import { whyNone } from "./interval.js";
import { across, draw, valueAt } from "./plots.js";
import { levels } from "./strength.js";
import { timeOf } from "./wavelet.js";

/** @type {Record<Method, string>} */
export const CLASS = { "inverse filter": "inverse", funneling: "funneling", combination: "combination" };
const S_IS = "Signal strength: the mean motion of the target over the mean motion of the other points. Above 1 the target moves more than the others do on average.";
const ACTUATORS = Array.from({ length: 9 }, (_, k) => `var(--a${k})`);

/** @param {Method} method */
const colour = (method) => `var(--${CLASS[method]})`;

/** S and scales over each arm. @param {App} app */
export function heads(app) {
  const { arms } = app, { settings } = app.experiment;
  $("stage").dataset.panels = String(app.slots.length);
  replace($("heads"), ...app.slots.map(({ key, method, experiment, title }) => {
    const o = experiment.outcome(method), range = experiment.interval(method, settings.target);
    const band = experiment.arms(method, settings.target);
    const why = o.problem ? o.problem : range ? `${interval(range, o.strength, " to ")} by the errors of G` : experiment === app.experiment ? whyUnknown(app) : "";
    const beside = nearMotor(experiment.outputs[settings.target], experiment.inputs, experiment.content.clearance) ? "not counted: under or beside a motor, with which the skin moves" : "";
    return h("div", { class: "head" },
      h("div", {},
        h("button", { type: "button", class: CLASS[method], "aria-pressed": String(app.focus === method), onclick: () => app.attend(method), text: `${title}${method}` }),
        h("div", { class: "s", "data-method": method }, whatIsS(), o.problem ? "–" : strengthText(o.strength)),
        h("div", { class: "why", text: why }), beside ? h("div", { class: "why beside", text: beside }) : null,
        band ? h("div", { class: "why", "data-arms": method, text: `people ${roughly(band[0])} to ${roughly(band[2])}, median ${roughly(band[1])}` }) : null),
      h("div", { class: "foot", text: arms.words(method, experiment, key) }));
  }));
}

/** S to three digits, the last of which may be 0. @param {number} s */
function strengthText(s) {
  return Number.isFinite(s) && s > 0 && s < 100 ? s.toFixed(s < 1 ? 3 : s < 10 ? 2 : 1) : say(s);
}

/** S of people, to two digits. @param {number} s */
function roughly(s) {
  return s > 0.01 && s < 99 ? s.toPrecision(2) : say(s, 2);
}

/** Ends of an interval of S; one number where it is narrower than the digits. @param {[number, number]} range @param {number} s @param {string} to */
function interval(range, s, to) {
  const [low, high] = range.map(strengthText);
  return low === high ? `± less than ${say(10 ** (Math.floor(Math.log10(s)) - 2), 1)}` : `${low}${to}${high}`;
}

/** The letter S, with what it is when pointed at or focused. */
function whatIsS() {
  return h("span", { class: "tip", tabindex: 0, "data-tip": S_IS, "aria-label": `S: ${S_IS}` }, h("small", { text: "S" }), " ");
}

/** @param {App} app */
function whyUnknown(app) {
  const { experiment } = app, { settings } = experiment;
  if (settings.arm) return "a drawn arm: the errors of its own G are not kept";
  if (!experiment.asRun) return whyNone(experiment.content, experiment.errors) ? `interval unknown: ${whyNone(experiment.content, experiment.errors)}` : "interval: being drawn …";
  const rendered = experiment.content.strength.methods;
  return `interval unknown: ${rendered ? experiment.content.strength.unknown || "not rendered at this target" : "this G states none"}`;
}

/** Displacements and drives, a column per method. @param {App} app */
export function traces(app) {
  const { experiment, span } = app, { record, settings } = experiment, ms = /** @type {[number, number]} */ (span.map((t) => 1e3 * t));
  const [first, last] = app.shownSamples, x = Float64Array.from({ length: last - first }, (_, j) => 1e3 * timeOf(record, first + j)), window = experiment.window();
  const shade = window ? /** @type {[number, number]} */ (window.map((t) => 1e3 * t)) : null, device = experiment.content.device;
  const volts = experiment.content.unit === "m/V", unit = experiment.content.unit.split("/")[1];
  $("traces").replaceChildren(...METHODS.map((method) => {
    const o = experiment.outcome(method), held = o.aim?.zeros ?? [];
    const cut = (/** @type {Float64Array} */ y, /** @type {number} */ factor) => Float64Array.from(y.subarray(first, last), (v) => factor * v);
    /** @type {Series[]} */
    const moves = o.moves.map((u, i) => ({ y: cut(u, 1e6), colour: i === settings.target ? colour(method) : held.includes(i) ? "var(--warn)" : "var(--soft)", width: i === settings.target ? 1.8 : 0.8, dash: held.includes(i) ? "3 2" : undefined, opacity: i === settings.target ? 1 : 0.55 }));
    if (moves.length) moves.push(/** @type {Series} */ (moves.splice(settings.target, 1)[0]));
    const sent = experiment.sent(o).map((s, i) => ({ y: cut(s, 1), colour: ACTUATORS[i % ACTUATORS.length], width: 1.2 }));
    const limits = volts ? [{ y: device.max_voltage, label: `limit ${say(device.max_voltage)} V` }, { y: -device.max_voltage, label: "" }] : [];
    const charts = [
      draw({ title: `${method}: outward displacement of all points`, x, span: ms, xLabel: "time [ms]", yLabel: "displacement [µm]", series: moves, symmetric: true, shade }),
      draw({ title: `${method}: drives`, x, span: ms, xLabel: "time [ms]", yLabel: `drive [${unit}]`, series: sent, symmetric: true, limits }),
    ];
    for (const svg of charts) svg.addEventListener("click", (e) => { app.playing = false; app.arms.time = Math.min(Math.max(valueAt(svg, e.clientX, ms) / 1e3, span[0]), span[1]); });
    return h("div", { class: "trace" },
      h("h2", {}, h("span", { class: CLASS[method], text: method }), h("small", { text: o.problem ? ` ${o.problem}` : ` target ${experiment.outputs[settings.target].name}` })),
      under(charts[0]), legend([[colour(method), "target"], ["var(--warn)", "zero points", true], ["var(--soft)", "other points"]]),
      under(charts[1]), legend([...experiment.inputs.map((p, i) => /** @type {[string, string]} */ ([ACTUATORS[i % ACTUATORS.length], p.name])), ...limitIn(sent, limits)]));
  }));
  cursor(app);
}

/** The drives' limit, and where it is when the chart ends before it. @param {Series[]} sent @param {{y: number}[]} limits
 * @returns {[string, string, boolean][]} */
function limitIn(sent, limits) {
  if (!limits.length) return [];
  const peak = sent.reduce((most, { y }) => Array.from(y).reduce((m, v) => Math.max(m, Math.abs(v)), most), 0);
  return [["var(--warn)", `limit ±${say(limits[0].y)} V${peak > 0 && 1.08 * peak < limits[0].y ? `, ${say(limits[0].y / peak, 2)} times the peak` : ""}`, true]];
}

/** @param {[string, string, boolean?][]} entries */
function legend(entries) {
  return h("div", { class: "legend" }, ...entries.map(([c, text, dash]) => h("span", {}, h("i", { class: dash ? "dash" : "", style: `border-color:${c}` }), text)));
}

/** A chart and the line of the instant shown, which moves without the chart being painted again. @param {SVGElement} chart */
function under(chart) {
  return h("div", { class: "plot" }, chart, h("i", { class: "instant" }));
}

/** Move the instant's line in all traces. @param {App} app */
export function cursor(app) {
  const place = `translateX(${100 * across(1e3 * app.arms.time, /** @type {[number, number]} */ (app.span.map((t) => 1e3 * t)))}%)`;
  for (const line of document.querySelectorAll("#traces .instant")) /** @type {HTMLElement} */ (line).style.transform = place;
}

/** G to the target, the drives' spectra and how well G inverts. @param {App} app */
export function spectra(app) {
  const { experiment, overlay } = app, { settings, frequency, inputs } = experiment, g = experiment.transfer(), n = inputs.length, m = g.outputs.length;
  const span = /** @type {[number, number]} */ ([frequency[0], frequency[frequency.length - 1]]), o = app.outcome, target = g.outputs[settings.target].name;
  const unit = experiment.content.unit.split("/")[1];
  /** @type {Series[]} */
  const own = inputs.map((_, i) => ({ y: sizes(g.values, g.bins, (b) => (b * m + settings.target) * n + i, 1e6), colour: ACTUATORS[i % ACTUATORS.length], width: 1.3 }));
  const measured = overlay && settings.target < experiment.points.length ? inputs.map((_, i) => ({ x: overlay.frequency, y: sizes(overlay.values, overlay.frequency.length, (b) => (b * experiment.points.length + settings.target) * n + i, 1e6), colour: ACTUATORS[i % ACTUATORS.length], width: 1, dash: "4 3" })) : [];
  const sent = o.sent ? inputs.map((_, i) => ({ y: sizes(/** @type {any} */ (o.sent), g.bins, (b) => b * n + i, 1e3), colour: ACTUATORS[i % ACTUATORS.length], width: 1.3 })) : [];
  const names = inputs.map((p, i) => /** @type {[string, string]} */ ([ACTUATORS[i % ACTUATORS.length], p.name]));
  const report = o.aim?.inversion, gentle = [app.focus === "funneling" ? "nothing is inverted in funneling" : ""];
  const parts = [
    card(`G to point ${target}`, "", draw({ title: "transfer matrix", x: frequency, span, xLabel: "frequency [Hz]", yLabel: `|G| [µm/${unit}]`, series: [...own, ...measured], log: true }), legend([...names, ...(measured.length ? [/** @type {[string, string, boolean]} */ (["var(--soft)", /** @type {any} */ (overlay).name, true])] : [])])),
    card("Drive spectra", app.focus, draw({ title: "drive spectra", x: frequency, span, xLabel: "frequency [Hz]", yLabel: `|drive| [m${unit}/Hz]`, series: sent }), legend(names)),
    card("Condition number", report ? app.focus : gentle[0], draw({ title: "condition number of the control points' rows: largest over least singular value", x: frequency, span, xLabel: "frequency [Hz]", yLabel: "condition number", series: report ? [{ y: report.condition, colour: colour(app.focus), width: 1.4 }] : [], log: true }),
      h("p", { class: "soft", style: "margin:2px 0 0;font-size:12px", text: report ? `An error of G grows up to that much in the drives. Part of target and zeros that cannot be had: ${say(100 * median(report.misfit), 2)} % in the median over the band.` : "Choose inverse filter or combination above an arm." })),
  ];
  $("spectra").replaceChildren(...parts);
}

/** @param {string} title @param {string} more @param {...Node} children */
function card(title, more, ...children) {
  return h("div", {}, h("h2", {}, title, h("small", { text: more ? ` ${more}` : "" })), ...children);
}

/** @param {import("./arrays.js").Complex} values @param {number} count @param {(b: number) => number} at @param {number} factor */
function sizes(values, count, at, factor) {
  return Float64Array.from({ length: count }, (_, b) => factor * Math.hypot(values.re[at(b)], values.im[at(b)]));
}

/** @param {Float64Array} values */
function median(values) {
  const known = Array.from(values).filter(Number.isFinite).sort((a, b) => a - b);
  return known.length ? known[Math.floor(known.length / 2)] : NaN;
}

/** S at every point by every method, drives against limits. @param {App} app @param {(row: number) => void} choose */
export function table(app, choose) {
  const { experiment, version } = app, { settings, outputs } = experiment, wavelet = settings.wavelet.name, window = experiment.window();
  const over = window ? `${say(1e3 * window[0])} to ${say(1e3 * window[1])} ms` : "the whole record";
  const beside = outputs.map((p) => nearMotor(p, experiment.inputs, experiment.content.clearance));
  const rows = outputs.map((p, row) => h("tr", { class: `${row === settings.target ? "now" : ""} ${beside[row] ? "beside" : ""}`, title: beside[row] ? "not counted: under or beside a motor, with which it moves" : "" },
    h("td", {}, h("button", { type: "button", title: `aim at ${p.name}`, onclick: () => choose(row), text: p.name })),
    ...METHODS.map((method) => h("td", { "data-s": `${method} ${p.name}`, text: "…" }))));
  const played = app.overlay ? h("p", { class: "soft", id: "played" }) : null;
  replace($("table"),
    h("h2", {}, h("span", { class: "tip", tabindex: 0, "data-tip": S_IS, text: "Signal strength S" }), h("small", { text: ` motion of the target over the mean of the other points, taken over ${over}; ${wavelet}` })),
    h("div", { class: "half" },
      h("div", { class: "scroll" }, h("table", {}, h("thead", {}, h("tr", {}, h("th", { text: "target" }), ...METHODS.map((m) => h("th", { class: CLASS[m], text: m })))), h("tbody", {}, ...rows))),
      h("div", { class: "scroll" }, drivesTable(app), played)));
  if (played) played.textContent = replayed(app);
  fill(app, version, 0);
}

/** Whether a point lies under a cone or nearer to a rim than `clearance` [m]. @param {import("./device.js").Port} point @param {import("./device.js").Port[]} inputs @param {number} clearance */
function nearMotor(point, inputs, clearance) {
  return inputs.some((a) => Math.hypot(...a.position.map((x, k) => x - point.position[k])) - a.radius < clearance - 1e-9);
}

/** S target by target, so that the page stays awake. @param {App} app @param {number} version @param {number} row */
function fill(app, version, row) {
  const { experiment } = app, outputs = experiment.outputs;
  if (version !== app.version || row >= outputs.length) {
    if (version === app.version) document.body.dataset.table = String(version);
    return;
  }
  for (const method of METHODS) {
    const cell = document.querySelector(`[data-s="${CSS.escape(`${method} ${outputs[row].name}`)}"]`);
    if (!cell) continue;
    const s = experiment.strength(method, row), range = experiment.interval(method, row);
    const band = experiment.arms(method, row), before = app.kept?.strength(method, row);
    const told = strengthText(s), wide = range && range.map(strengthText).some((end) => end !== told), was = before === undefined ? "" : strengthText(before);
    cell.replaceChildren(told, ...(wide ? [" ", h("small", { text: `(${interval(range, s, "–")})` })] : []), ...(band ? [" ", h("small", { class: "people", text: `people ${roughly(band[0])}–${roughly(band[2])}` })] : []),
      ...(before === undefined ? [] : [" ", h("small", { class: `people ${was === told ? "" : s > before ? "gain" : "loss"}`, text: `kept ${was}` })]));
    /** @type {HTMLElement} */ (cell).dataset.value = String(s);
  }
  setTimeout(() => fill(app, version, row + 1), 0);
}

/** @param {App} app */
function drivesTable(app) {
  const { experiment } = app, { content, settings, inputs } = experiment, volts = content.unit === "m/V", unit = content.unit.split("/")[1];
  const o = app.outcome, { max_voltage: most, max_power: hot } = content.device;
  const rows = experiment.sent(o).map((s, i) => {
    const l = levels(s, settings.device.coil.resistance);
    return h("tr", {}, h("td", { text: inputs[i].name }), h("td", { class: volts && l.peak > most ? "over" : "", text: `${say(l.peak)} ${unit}` }), h("td", { text: `${sayUnit(l.rms, unit)}` }), h("td", { class: volts && l.power > hot ? "over" : "", text: volts ? sayUnit(l.power, "W") : "–" }));
  });
  const limits = volts ? `limits: ${say(most)} V peak, ${sayUnit(hot, "W")} in ${say(settings.device.coil.resistance)} ohm, over the record` : "drives are no voltages, so the limits do not apply";
  const lost = o.problem ? "" : o.undriven > 1e-4 ? ` ${say(100 * o.undriven, 2)} % of the wavelet's energy lies outside ${say(experiment.frequency[0])} to ${say(experiment.frequency[experiment.frequency.length - 1])} Hz, where G is unknown: it is not driven.` : "";
  return h("div", {}, h("table", {}, h("thead", {}, h("tr", {}, h("th", { text: `drives, ${app.focus}` }), h("th", { text: "peak" }), h("th", { text: "rms" }), h("th", { text: "mean power" }))), h("tbody", {}, ...rows)),
    h("p", { class: o.undriven > 0.1 && !o.problem ? "" : "soft", id: "limits", style: "margin:6px 0 0;font-size:12.5px", text: `${limits}.${lost}` }));
}

/** What these drives do on the measured G laid over. @param {App} app */
function replayed(app) {
  const { experiment, overlay } = app;
  if (!overlay) return "";
  const values = overlayOnBins(app), known = values.re.reduce((a, v) => a + (Number.isFinite(v) ? 1 : 0), 0) / values.re.length;
  const g = experiment.transfer(), m = experiment.points.length, n = experiment.inputs.length;
  let miss = 0, size = 0;
  for (let b = 0; b < g.bins; b++) for (let p = 0; p < m; p++) for (let i = 0; i < n; i++) {
    const x = (b * m + p) * n + i, y = (b * g.outputs.length + p) * n + i;
    if (!Number.isFinite(values.re[x])) continue;
    miss += (values.re[x] - g.values.re[y]) ** 2 + (values.im[x] - g.values.im[y]) ** 2;
    size += values.re[x] ** 2 + values.im[x] ** 2;
  }
  return `${overlay.name} covers ${say(100 * known, 3)} % of the bins; this page's G differs from it by ${say(100 * Math.sqrt(miss / size), 3)} % over all entries and these bins.`;
}

/** The overlay on the page's bins; NaN where it says nothing. @param {App} app @returns {import("./arrays.js").Complex} */
function overlayOnBins(app) {
  const { experiment } = app, overlay = /** @type {import("./app.js").Overlay} */ (app.overlay), { frequency } = experiment;
  const entries = experiment.points.length * experiment.inputs.length, out = { re: new Float64Array(frequency.length * entries), im: new Float64Array(frequency.length * entries) };
  for (let e = 0; e < entries; e++) for (const part of /** @type {("re" | "im")[]} */ (["re", "im"])) {
    const row = Float64Array.from(overlay.frequency, (_, k) => overlay.values[part][k * entries + e]), found = between(overlay.frequency, row, frequency);
    for (let b = 0; b < frequency.length; b++) out[part][b * entries + e] = found[b];
  }
  return out;
}

/** Errors, in words. @param {App} app */
export function errors(app) {
  const { experiment, field } = app, { content } = experiment;
  const { engine, error } = experiment.engine;
  $("badge").textContent = `${experiment.inputs.length} actuators · ${experiment.points.length} points`;
  $("engine").textContent = `Answered by ${engine}; error of G ${error === null ? "unknown" : `${say(100 * error, 2)} %`}.${experiment.places || experiment.kind === "transfer" ? "" : " Actuators can be moved on the page of a layered run (--set engine=layered) or of a library."}`;
  const estimates = experiment.errors.map((/** @type {any} */ e) => h("li", {}, h("strong", { text: `${e.source} ` }), e.band === null ? "unknown" : `${say(100 * e.band)} % over the band, ${say(100 * e.worst)} % at the worst frequency`, h("span", { class: "soft", text: `: ${e.method}` })));
  const changed = experiment.asRun ? [] : experiment.settings.arm ? ["The errors of G above are those of the run's own arm: a drawn arm's are not kept, so that its intervals of S are unknown."] : [`${experiment.kind === "places" || experiment.moved ? "Intervals of S are for the errors of G above, wherever the actuators stand." : "The errors of G above are those of the run as it was made."} ${whyNone(content, experiment.errors) ? `Intervals of S are unknown: ${whyNone(content, experiment.errors)}.` : "Intervals of S are drawn anew here, from 12 copies of G as the run's were; they take what was changed to err by the same shares of G."}`];
  const unseen = experiment.inputs.filter((p, k) => content.device.out_of_contact.includes(p.name) && experiment.settings.device.touching[k]).map((p) => p.name);
  if (unseen.length && field.surfaces[0].components === 3) changed.push(`The picture leaves out what ${unseen.join(", ")} moves: out of contact in the run. Numbers at the points hold it.`);
  if (content.device.housing.skin_share && !content.device.housing.fixed) changed.push("The picture leaves out what the skin follows of the housing; numbers at the points hold it.");
  const picture = experiment.kind === "transfer" ? [] : [field.anywhere ? `The picture: ${field.words}.` : `The picture: ${field.words}. Its shapes leave out ${say(100 * field.error, 2)} % of the motion; numbers at the points do not come from them, those at a free place do.`];
  const section = field.surfaces.length > 1 ? [] : ["No section: this run kept no motion inside the limb."];
  const arms = content.arms && `People: ${say(100 * content.arms.levels[0])} to ${say(100 * content.arms.levels[content.arms.levels.length - 1])} % of S over ${content.arms.draws} arms drawn by forearm-fem predict. It is no error of this arm's numbers, and is shown only while nothing is changed.`;
  const notes = [...changed, ...(arms ? [arms] : []), ...(experiment.kind === "transfer" ? [field.words[0].toUpperCase() + field.words.slice(1) + "."] : []), ...picture, ...section, "An interval of S holds nine in ten true values within the errors stated for G; how arms differ between people is never in it.", ...content.notes];
  $("errors").replaceChildren(
    h("div", {}, h("h2", { text: "How wrong may it be?" }), h("p", { style: "margin:0 0 4px", text: content.accuracy }), h("ul", {}, ...estimates)),
    h("div", {}, h("h2", { text: "Notes" }), h("ul", { class: "soft" }, ...notes.map((/** @type {string} */ t) => h("li", { text: t })))));
}
