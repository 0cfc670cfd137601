// Files in and out of the page: what is written is read back, what is damaged is refused in one sentence.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Fft } from "../../forearm_fem/show/workbench/page/numeric.js";
import { between, checkSize, FileProblem, fitting, readSamplesCsv, readTransfer, readWav, transferCsv, transferJson, writeCsv, writeToml, writeWav } from "../../forearm_fem/show/workbench/page/files.js";
import { svd } from "../../forearm_fem/show/workbench/page/numeric.js";
import { say, sayUnit } from "../../forearm_fem/show/workbench/page/dom.js";
import { ticks } from "../../forearm_fem/show/workbench/page/dom.js";

const OUT = ["1", "2"], IN = ["A1"], G = { re: Float64Array.of(1, 2, 3, NaN), im: Float64Array.of(-1, 0.5, 0, NaN) }, F = Float64Array.of(10, 20);
const sentence = (act, words) => assert.throws(act, (e) => e instanceof FileProblem && words.test(e.message) && e.message.length < 300 && !e.message.includes("\n"));

test("transforms of every kind of length are the sum they stand for", () => {
  for (const n of [1, 2, 12, 35, 74, 97, 500, 2 * 101]) {
    const x = { re: Float64Array.from({ length: n }, (_, j) => Math.sin(3 * j * j)), im: Float64Array.from({ length: n }, (_, j) => Math.cos(5 * j)) };
    const y = new Fft(n).forward(x);
    for (const k of [0, 1 % n, n >> 1, n - 1]) {
      let re = 0, im = 0;
      for (let j = 0; j < n; j++) { const a = (-2 * Math.PI * ((j * k) % n)) / n; re += x.re[j] * Math.cos(a) - x.im[j] * Math.sin(a); im += x.re[j] * Math.sin(a) + x.im[j] * Math.cos(a); }
      assert.ok(Math.hypot(y.re[k] - re, y.im[k] - im) < 1e-9 * n, `length ${n}, bin ${k}`); // rounding grows with the length
    }
  }
});

test("singular values and vectors give the matrix back, wide or tall", () => {
  for (const [m, n] of [[5, 4], [3, 6], [4, 4]]) {
    const a = { re: Float64Array.from({ length: m * n }, (_, i) => Math.sin(7 * i + 1)), im: Float64Array.from({ length: m * n }, (_, i) => Math.cos(3 * i * i)) };
    const { left, s, right, rank } = svd(a, m, n);
    for (let i = 0; i < m; i++) for (let j = 0; j < n; j++) {
      let re = 0;
      for (let k = 0; k < rank; k++) re += s[k] * (left.re[i * n + k] * right.re[j * n + k] + left.im[i * n + k] * right.im[j * n + k]);
      assert.ok(Math.abs(re - a.re[i * n + j]) < 1e-12);
    }
    for (let k = 1; k < rank; k++) assert.ok(s[k] <= s[k - 1]);
  }
});

test("G goes out and comes back, as CSV and as JSON, unknown entries too", () => {
  const csv = transferCsv(F, G, OUT.map((name) => ({ name })), IN.map((name) => ({ name })), "m/V"), json = transferJson(F, G, OUT, IN, "m/V", "");
  for (const [name, text] of [["g.csv", csv], ["g.json", json]]) {
    const back = readTransfer(name, text, OUT, IN, "m/V");
    assert.deepEqual(Array.from(back.frequency), [10, 20]);
    assert.deepEqual(Array.from(back.values.re), Array.from(G.re));
    assert.deepEqual(Array.from(back.values.im), Array.from(G.im));
    assert.ok(back.told);
  }
  const polar = readTransfer("p.csv", "frequency_Hz,output,input,magnitude,phase_rad\n10,1,A1,2,1.5707963267948966\n", OUT, IN, "m/V");
  assert.ok(Math.abs(polar.values.im[0] - 2) < 1e-12 && Number.isNaN(polar.values.re[1]));
  assert.ok(!polar.told); // a lab's table says no unit
});

test("a damaged or foreign G is refused in a sentence", () => {
  const csv = "frequency_Hz,output,input,real,imag\n";
  sentence(() => readTransfer("a.csv", "a,b\n1,2\n", OUT, IN, "m/V"), /expected the columns frequency_Hz/);
  sentence(() => readTransfer("a.csv", csv, OUT, IN, "m/V"), /no lines of data/);
  sentence(() => readTransfer("a.csv", `${csv}10,1,A1,1\n`, OUT, IN, "m/V"), /line 2 is damaged/);
  sentence(() => readTransfer("a.csv", `${csv}10,1,A1,x,0\n`, OUT, IN, "m/V"), /line 2 is damaged/);
  sentence(() => readTransfer("a.csv", `${csv}-1,1,A1,1,0\n`, OUT, IN, "m/V"), /line 2 is damaged/);
  sentence(() => readTransfer("a.csv", `${csv}10,1,A1,1,0\n10,1,A1,1,0\n`, OUT, IN, "m/V"), /occurs twice/);
  sentence(() => readTransfer("a.csv", "frequency_Hz,output,input,magnitude,phase_rad\n10,1,A1,-96,0\n", OUT, IN, "m/V"), /line 2: magnitude is -96, expected 0 or more in m\/V, not decibels/);
  for (const mark of ["2", "", "yes"]) sentence(() => readTransfer("a.csv", `frequency_Hz,output,input,real,imag,valid\n10,1,A1,1,0,${mark}\n`, OUT, IN, "m/V"), /line 2: valid is .*, expected 1 or 0/);
  sentence(() => readTransfer("a.csv", "frequency_Hz,output,input,real,imag,real\n10,1,A1,1,0,2\n", OUT, IN, "m/V"), /two columns \(real\)/);
  sentence(() => readTransfer("a.csv", "frequency_Hz,output,input,real,imag,magnitude,phase_rad\n10,1,A1,1,0,2,0\n", OUT, IN, "m/V"), /two columns \(real and magnitude\)/);
  sentence(() => readTransfer("a.csv", `${csv}10,7,B,1,0\n`, OUT, IN, "m/V"), /none of its outputs/);
  sentence(() => readTransfer("a.csv", `# forearm_fem {"unit":"m/N"}\n${csv}10,1,A1,1,0\n`, OUT, IN, "m/V"), /is in m\/N/);
  sentence(() => readTransfer("a.json", "{", OUT, IN, "m/V"), /is damaged/);
  sentence(() => readTransfer("a.json", "null", OUT, IN, "m/V"), /not the JSON that this page writes/);
  sentence(() => readTransfer("a.json", '{"content":"forearm_fem transfer","unit":"m/V","outputs":["1"],"inputs":["A1"],"frequency_Hz":[10],"real":[1],"imag":[]}', OUT, IN, "m/V"), /not the JSON/);
  const json = { content: "forearm_fem transfer", unit: "m/V", outputs: OUT, inputs: IN, frequency_Hz: [10], real: [1, 2], imag: [0, 0] };
  const changed = (change) => () => readTransfer("a.json", JSON.stringify({ ...json, ...change }), OUT, IN, "m/V");
  sentence(changed({ outputs: "12" }), /not the JSON/);
  sentence(changed({ frequency_Hz: ["a"] }), /no positive number/);
  sentence(changed({ real: [null, null] }), /none of its 2 entries/);
  sentence(changed({ unit: `m/V\n${"x".repeat(400)}` }), /is in m\/V x/);
  sentence(() => readTransfer(`${"n".repeat(400)}\n.csv`, `${csv}Infinity,1,A1,1,0\n`, OUT, IN, "m/V"), /^n+…$/);
  sentence(() => readTransfer("a.csv", `${csv}Infinity,1,A1,1,0\n`, OUT, IN, "m/V"), /line 2 is damaged/);
  sentence(() => checkSize("a", 0), /empty/);
  sentence(() => checkSize("a", 1e9), /too large/);
});

test("WAV: what is written is read, what is not plain is refused", () => {
  const wave = writeWav([[0, 0.5, -1, 0.25]], 10000), back = readWav("a.wav", wave);
  assert.equal(back.rate, 10000);
  assert.deepEqual(Array.from(back.samples), [0, 0.5, -1, 0.25]);
  sentence(() => writeWav([[0, 1]], 51200 / 3), /whole sample rates only/);
  sentence(() => readWav("a.wav", wave.slice(0, 50)), /cut short/);
  sentence(() => readWav("a.wav", new ArrayBuffer(60)), /no WAV file/);
  sentence(() => readWav("a.wav", writeWav([[0, 1], [1, 0]], 8000)), /2 channels/);
  const eight = new DataView(wave.slice(0));
  eight.setUint16(20, 1, true); eight.setUint16(34, 8, true);
  sentence(() => readWav("a.wav", eight.buffer), /8 bits/);
});

test("two hundred damaged files are read or refused in a sentence", () => {
  const bytes = (text) => new TextEncoder().encode(text), text = (data) => new TextDecoder().decode(data), record = { rate: 10000, n: 200 };
  const ports = (names) => names.map((name) => ({ name }));
  /** @type {[Uint8Array, (data: Uint8Array) => unknown][]} */
  const kinds = [
    [bytes(transferCsv(F, G, ports(OUT), ports(IN), "m/V")), (d) => readTransfer("a.csv", text(d), OUT, IN, "m/V")],
    [bytes(transferJson(F, G, OUT, IN, "m/V", "")), (d) => readTransfer("a.json", text(d), OUT, IN, "m/V")],
    [bytes(writeCsv({ t: [0, 1e-4, 2e-4], v: [1, 2, 3] }, ["note"])), (d) => fitting("a.csv", readSamplesCsv("a.csv", text(d)), record)],
    [new Uint8Array(writeWav([[0, 0.5, -1, 0.25]], 10000)), (d) => fitting("a.wav", readWav("a.wav", d.slice().buffer), record)],
  ];
  let state = 33, refused = 0;
  const below = (n) => { state = (Math.imul(state, 1103515245) + 12345) >>> 0; return Math.floor((state / 2 ** 32) * n); };
  for (let k = 0; k < 200; k++) {
    const [whole, read] = kinds[k % 4], data = k % 3 ? whole.slice() : whole.slice(0, 1 + below(whole.length - 1));
    if (k % 3) for (let i = 0; i < k % 5 + 1; i++) data[below(data.length)] = below(256);
    try {
      read(data);
    } catch (problem) {
      refused++;
      assert.ok(problem instanceof FileProblem && problem.message.length < 300 && !/[\n\r]/.test(problem.message), `file ${k}: ${problem.stack}`);
    }
  }
  assert.ok(refused > 100, `${refused} refused`); // most damage is seen; what changes a digit cannot be
});

test("samples must fit the record as they are", () => {
  const record = { rate: 1000, n: 100 };
  assert.equal(fitting("a", readSamplesCsv("a.csv", "time,value\n0,0\n0.001,1\n0.002,0\n"), record).length, 3);
  assert.equal(readSamplesCsv("a.csv", writeCsv({ v: [1, 2] }, ["note"])).samples[1], 2);
  sentence(() => fitting("a", readSamplesCsv("a.csv", "0,0\n0.1,1\n0.2,0\n"), record), /sampled at 10/);
  sentence(() => readSamplesCsv("a.csv", "0,0\n0.1,1\n0.5,0\n"), /evenly increasing/);
  sentence(() => readSamplesCsv("a.csv", "1\n2\nx\n"), /row 3/);
  sentence(() => readSamplesCsv("a.csv", "1,2,3\n"), /3 columns of numbers/);
  sentence(() => readSamplesCsv("a.pdf", "%PDF-1.4\n"), /no columns of numbers/);
  sentence(() => fitting("a", { samples: new Float64Array(5), rate: null }, record), /all 5 samples are zero/);
  sentence(() => fitting("a", { samples: new Float64Array(500).fill(1), rate: null }, record), /500 samples/);
});

test("a cubic is met between its samples, nothing beyond them, beside holes and in gaps", () => {
  const x = Float64Array.of(1, 2, 3, 4.5, 5, 6, 7, 8, 9, 20, 21, 22), f = (v) => v ** 3 - 2 * v, y = x.map(f);
  const found = between(x, y, [1.5, 4.2, 8.5, 0.5, 12, 20, 20.5]);
  for (const [i, v] of [[0, 1.5], [1, 4.2], [2, 8.5]]) assert.ok(Math.abs(found[i] - f(v)) < 1e-9);
  assert.ok(Number.isNaN(found[3]) && Number.isNaN(found[4]));
  assert.equal(found[5], f(20));
  assert.ok(Number.isNaN(found[6])); // three samples alone carry no spline
});

test("numbers are said with few digits and their unit", () => {
  assert.equal(say(0.00001234), "1.23·10⁻⁵");
  assert.equal(say(-1234.5), "−1,230");
  assert.equal(say(NaN), "unknown");
  assert.equal(sayUnit(0.00031, "W"), "310 µW");
  assert.deepEqual(ticks(-1, 1, 4), [-1, -0.5, 0, 0.5, 1]);
});

test("TOML keeps what names and texts hold", () => {
  const text = writeToml({ name: 'a "b" \\ é\n', flag: true, small: 1e-12, list: [[0.1, 2]], part: { layers: [{ tissue: "skin", thickness: 0.001 }], below: { "odd key": 3 } } });
  assert.match(text, /^name = "a \\"b\\" \\\\ é\\n"$/m);
  assert.match(text, /^small = 1\.0e-12$/m);
  assert.match(text, /^\[part\.below\]$/m);
});
