// What the page computes, for tests/test_workbench.py: reads {content, jobs} from the file named, prints one JSON value a job.
import { readFileSync } from "node:fs";
import { Experiment, METHODS } from "../../forearm_fem/show/workbench/page/experiment.js";
import { halves, noiseOf, shorter, whyNone } from "../../forearm_fem/show/workbench/page/signals.js";
import { amplitudesAt, displace, Field } from "../../forearm_fem/show/workbench/page/field.js";

const { content, jobs } = JSON.parse(readFileSync(process.argv[2], "utf8"));
const plain = (v) => Array.from(v, (x) => (Number.isFinite(x) ? x : null));

/** Settings as JSON has them: device keys are merged, null springs are full contact. */
function changed(experiment, settings) {
  const { device = {}, ...rest } = settings, now = experiment.settings.device;
  const spring = (device.spring ?? now.spring).map((s) => s ?? Infinity);
  return { ...rest, device: { ...now, ...device, spring, coil: { ...now.coil, ...device.coil }, housing: { ...now.housing, ...device.housing } } };
}

function done(job) {
  const experiment = new Experiment(content);
  experiment.set(changed(experiment, job.settings ?? {}));
  if (job.stimulus) experiment.stimulate({ ...job.stimulus, samples: job.stimulus.samples && Float64Array.from(job.stimulus.samples) });
  const actions = {
    strengths: () => METHODS.map((m) => plain(experiment.outputs.map((_, t) => experiment.strength(m, t)))),
    transfer: () => { const { values } = experiment.transfer(); return [plain(values.re), plain(values.im)]; },
    transferAt: () => { const g = experiment.transferAt(job.frequency); return [plain(g.re), plain(g.im)]; },
    zeros: () => METHODS.map((m) => experiment.outputs.map((_, t) => experiment.zerosOf(m, t).map((i) => experiment.outputs[i].name))),
    problem: () => experiment.outcome(job.method).problem,
    signals: () => experiment.outcome(job.method).signals.map(plain),
    sent: () => experiment.sent(experiment.outcome(job.method)).map(plain),
    "why no interval": () => whyNone(content),
    moves: () => experiment.outcome(job.method).moves.map(plain),
    undriven: () => experiment.outcome(job.method).undriven,
    condition: () => plain(experiment.outcome(job.method).aim.inversion.condition),
    interval: () => experiment.interval(job.method, job.settings?.target ?? 0),
    "arm strengths": () => METHODS.map((m) => experiment.strengthOn(job.arm, m, job.settings.target)),
    arms: () => experiment.arms(job.method, job.settings?.target ?? 0),
    // with Python's own noise (draw by draw, source by source) if there is any
    halves: () => { const given = job.noise ?? []; let k = 0; const noise = job.noise ? () => { const [re, im] = given[k++]; return { re: Float64Array.from(re), im: Float64Array.from(im) }; } : noiseOf(1); const work = halves(experiment, METHODS, noise); let step = work.next(); while (!step.done) step = work.next(); return step.value; },
    drawn: () => { const work = halves(experiment, METHODS, noiseOf(1)); let step = work.next(); while (!step.done) step = work.next(); experiment.drawn = { key: experiment.question, half: step.value }; return [experiment.interval(job.method, 4), experiment.strength(job.method, 4), step.value[METHODS.indexOf(job.method)][4]]; },
    bins: () => shorter(experiment).rows.map((b) => experiment.frequency[b]),
    skin: () => skin(experiment, job),
    place: () => { const field = new Field(content.field, experiment.inputs.length); experiment.reach = (v) => field.reach(v); experiment.set({ place: { vertex: job.vertex, position: [0, 0, 0], normal: [0, 0, 1] } }); const g = experiment.transfer(), m = g.outputs.length, n = g.inputs.length, rows = Array.from({ length: g.bins }, (_, b) => Array.from({ length: n }, (_, i) => (b * m + m - 1) * n + i)).flat(); return [rows.map((i) => g.values.re[i]), rows.map((i) => g.values.im[i])]; },
  };
  return actions[job.ask]();
}

/** Displacement (vertices x 3) of a surface at an instant. */
function skin(experiment, job) {
  const field = new Field(content.field, experiment.inputs.length), o = experiment.outcome(job.method), surface = field.surfaces[job.surface ?? 0];
  const force = experiment.changeable ? experiment.forces() : null, duration = experiment.record.n / experiment.record.rate;
  const track = field.track(force, o.sent, o.spectra, experiment.index, duration, [job.time - 0.01, job.time + 0.01]);
  const states = [0, 1, 2].map(() => ({ moved: new Float32Array(surface.rest.length), u: new Float32Array(surface.rest.length / 3) }));
  const rows = states.map((_, i) => amplitudesAt(track, job.time + (i - 1) * 1e-3, new Float64Array(field.k)));
  displace(surface, rows, states, Array.from(states[0].u.keys()));
  return plain(states[1].moved);
}

console.log(JSON.stringify(jobs.map(done)));
