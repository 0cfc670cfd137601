// What is drawn: which triangles a view needs, which hides which, and what a cut takes away.
import assert from "node:assert/strict";
import { test } from "node:test";
import { displace } from "../../forearm_fem/show/workbench/page/field.js";
import { Raster, tableOf } from "../../forearm_fem/show/workbench/page/picture.js";
import { all, openEdges, seen } from "../../forearm_fem/show/workbench/page/picture.js";
import { eyeOf, matrixOf } from "../../forearm_fem/show/workbench/page/picture.js";

const VIEW = { turn: 0, tilt: Math.PI / 2, far: 100, centre: [0, 0, 0] }, BOX = { x: 0, y: 0, w: 40, h: 40 }; // from above
const surface = (rest, faces) => ({ name: "skin", rest: Float32Array.from(rest), normals: new Float32Array(rest.length).fill(0), faces: Uint16Array.from(faces), shapes: new Float32Array(0), components: 1, tissue: null, tissues: [] });
// a tetrahedron, counted anticlockwise from outside: base below, three sides to the top
const CORNERS = [-5, -5, 0, 5, -5, 0, 0, 6, 0, 0, 0, 6], CLOSED = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3];
const camera = (raster) => ({ matrix: matrixOf(VIEW, BOX.w, BOX.h), eye: eyeOf(VIEW), panel: raster.panel(BOX, 1) });
const RED_TO_BLUE = tableOf([1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1]);

function painted(...layers) {
  const raster = new Raster();
  raster.begin(40, 40);
  for (const [height, u, cut] of layers) {
    const s = surface([-8, -8, height, 8, -8, height, 8, 8, height, -8, 8, height], [0, 1, 2, 0, 2, 3]);
    s.normals.forEach((_, i) => { s.normals[i] = i % 3 === 2 ? 1 : 0; });
    raster.surface(all(s), s.rest, s.normals, new Float32Array(4).fill(u), camera(raster), { limit: 1, table: RED_TO_BLUE, cut: cut ?? null, flat: true });
  }
  return raster;
}
// light comes in 64 levels, so that full white may be 254
const at = (raster, x, y) => { const p = raster.pixels[y * 40 + x]; return [p & 255, (p >> 8) & 255, (p >> 16) & 255, p >>> 24].map((v) => (v > 250 ? 255 : v)); };

test("a view needs the triangles that face it, and all where one can look inside", () => {
  const whole = surface(CORNERS, CLOSED), matrix = matrixOf(VIEW, 40, 40), eye = eyeOf(VIEW).map((e) => 100 * e);
  assert.equal(openEdges(whole).length, 0);
  assert.deepEqual([...seen(whole, openEdges(whole), matrix, eye, false).faces], CLOSED.slice(3));
  assert.equal(seen(whole, openEdges(whole), matrix, eye, true).faces.length, 12);
  const open = surface(CORNERS, CLOSED.slice(0, 9));
  assert.deepEqual([...openEdges(open)].sort(), [0, 2, 3]);
  assert.equal(seen(open, openEdges(open), matrix, eye, false).faces.length, 9);
});

test("what lies beside the panel is left out", () => {
  const far = surface(CORNERS.map((v, i) => (i % 3 === 1 ? v + 200 : v)), CLOSED);
  assert.equal(seen(far, openEdges(far), matrixOf(VIEW, 40, 40), eyeOf(VIEW).map((e) => 100 * e), true).faces.length, 0);
});

test("the nearer of two hides the other, whichever is drawn first; colours end at the limit", () => {
  for (const order of [[[0, -1], [5, 1]], [[5, 1], [0, -1]]]) {
    const raster = painted(...order);
    assert.deepEqual(at(raster, 20, 20), [0, 0, 255, 255]);
    assert.deepEqual(at(raster, 1, 1), [0, 0, 0, 0]); // nothing there
  }
  assert.deepEqual(at(painted([0, -3]), 20, 20), [255, 0, 0, 255]);
  assert.equal(at(painted([0, 0]), 20, 20)[1], 255); // the middle is green
});

test("a cut takes away what lies beyond it", () => {
  const raster = painted([0, 1, [0, 1, 0, 0]]); // y > 0, which is to the left as x points down the screen
  const half = [17, 22].map((x) => at(raster, x, 20)[3]);
  assert.deepEqual([...half].sort(), [0, 255]);
});

test("glass tints and hides nothing", () => {
  const raster = painted([0, 1]), triangle = Float32Array.from([-8, -8, 5, 8, -8, 5, 0, 8, 5]);
  raster.glass(triangle, Float32Array.from([0, 0, 1, 0, 0, 1, 0, 0, 1]), [1, 0, 0, 0.5], camera(raster));
  const [r, g, b, a] = at(raster, 20, 20);
  assert.ok(Math.abs(r - 127) < 3 && g === 0 && Math.abs(b - 127) < 3 && a === 255, `${[r, g, b, a]}`);
});

test("three states at once are three times one state", () => {
  const s = { ...surface([0, 0, 0, 1, 0, 0], []), normals: Float32Array.of(0, 0, 1, 1, 0, 0), components: 3, shapes: Float32Array.from({ length: 2 * 3 * 5 }, (_, i) => Math.sin(i)) };
  const rows = [1, 2, 3].map((k) => Float64Array.from({ length: 5 }, (_, j) => Math.cos(k * j)));
  const into = rows.map(() => ({ moved: new Float32Array(6), u: new Float32Array(2) }));
  displace(s, rows, into, [0, 1]);
  rows.forEach((row, i) => {
    const sum = (v, c) => row.reduce((t, a, j) => t + a * s.shapes[(v * 3 + c) * 5 + j], 0);
    assert.ok(Math.abs(into[i].moved[4] - sum(1, 1)) < 1e-6);
    assert.ok(Math.abs(into[i].u[0] - sum(0, 2)) < 1e-6 && Math.abs(into[i].u[1] - sum(1, 0)) < 1e-6);
  });
});
