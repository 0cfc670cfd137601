/**
 * Rectangles of ports and the zero points that follow from them. As Python's rendering/funneling.py and inverse_filter.py.
 *
 * @typedef {import("./device.js").Port} Port
 * @typedef {{angle: number, rows: number[], columns: number[], place: number[][], slack: number}} Lattice
 */
const SLACK = 0.05;

/** The N x M array (N, M >= 2) that ports form seen from above, or null. @param {Port[]} ports @returns {Lattice | null} */
function latticeOf(ports) {
  if (ports.length < 4) return null;
  const step = ports.map((p) => [p.position[0] - ports[0].position[0], p.position[1] - ports[0].position[1]]);
  let nearest = 1;
  step.forEach((s, i) => { if (i && Math.hypot(...s) < Math.hypot(...step[nearest])) nearest = i; });
  const reach = Math.hypot(...step[nearest]);
  let angle = Math.atan2(step[nearest][1], step[nearest][0]);
  angle -= (Math.PI / 2) * Math.round(angle / (Math.PI / 2));
  const turned = ports.map((p) => turn(p.position, -angle));
  const [rows, r] = lines(turned.map((t) => t[0]), SLACK * reach), [columns, c] = lines(turned.map((t) => t[1]), SLACK * reach);
  const place = ports.map((_, i) => [r[i], c[i]]);
  const distinct = new Set(place.map(String)).size;
  const filled = rows.length >= 2 && columns.length >= 2 && rows.length * columns.length === ports.length && distinct === ports.length;
  return filled ? { angle, rows, columns, place, slack: SLACK * reach } : null;
}

/** @param {number[]} at @param {number} angle @returns {[number, number]} */
function turn(at, angle) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return [c * at[0] - s * at[1], s * at[0] + c * at[1]];
}

/** @param {number[]} coordinate @param {number} slack @returns {[number[], number[]]} */
function lines(coordinate, slack) {
  const order = coordinate.map((_, i) => i).sort((a, b) => coordinate[a] - coordinate[b]);
  /** @type {number[]} */
  const line = new Array(coordinate.length).fill(0);
  order.forEach((i, k) => { line[i] = k ? line[order[k - 1]] + (coordinate[i] - coordinate[order[k - 1]] > 2 * slack ? 1 : 0) : 0; });
  const count = Math.max(...line) + 1;
  const means = Array.from({ length: count }, (_, l) => {
    const own = coordinate.filter((_, i) => line[i] === l);
    return own.reduce((a, b) => a + b, 0) / own.length;
  });
  return [means, line];
}

/** (1 - d_x / D_x)(1 - d_y / D_y) of each actuator, or why there is none. 
 *
 * Actuators on a line or in triangles have the weights that Python found for each point (`known`).
 * @param {Port[]} inputs @param {Port} target @param {number[] | null} known @returns {number[] | string} */
export function funnelingWeights(inputs, target, known) {
  const grid = latticeOf(inputs);
  if (!grid) return known ?? triangleWeights(inputs.map((p) => p.position), target.position) ?? `funneling does not reach this place: these ${inputs.length} actuators form no rectangle around it`;
  const at = turn(target.position, -grid.angle);
  const shares = [grid.rows, grid.columns].map((found, axis) => sharesOf(at[axis], found, grid.slack));
  if (shares.some((s) => s === null)) return "funneling reaches only places inside the actuators' rectangle";
  return inputs.map((_, i) => /** @type {number[]} */ (shares[0])[grid.place[i][0]] * /** @type {number[]} */ (shares[1])[grid.place[i][1]]);
}

/** Shares (n,) of a point in the triangle of nearest places around it: no other lies in the triangle's circle. Where several
 * triangles are as good, their mean; null outside all. As Python's rendering/triangles.py, but for points beside an edge.
 * @param {number[][]} places @param {number[]} at @returns {number[] | null} */
function triangleWeights(places, at) {
  const out = places.map(() => 0), cross = (/** @type {number[]} */ a, /** @type {number[]} */ b, /** @type {number[]} */ c) => (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
  let count = 0;
  places.forEach((a, i) => places.slice(0, i).forEach((b, j) => places.slice(0, j).forEach((c, k) => {
    const area = cross(a, b, c), share = [cross(b, c, at), cross(c, a, at), cross(a, b, at)].map((v) => v / area);
    if (!(Math.abs(area) > 1e-9 * ((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2)) || share.some((v) => v < -1e-9)) return;
    const [x, y, u, v] = [b[0] - a[0], b[1] - a[1], c[0] - a[0], c[1] - a[1]], p = x * x + y * y, q = u * u + v * v;
    const centre = [a[0] + (v * p - y * q) / (2 * area), a[1] + (x * q - u * p) / (2 * area)], radius = Math.hypot(centre[0] - a[0], centre[1] - a[1]);
    if (places.some((d) => Math.hypot(d[0] - centre[0], d[1] - centre[1]) < radius * (1 - 1e-6))) return;
    const clipped = share.map((w) => Math.max(w, 0)), sum = clipped.reduce((s, w) => s + w, 0);
    [i, j, k].forEach((corner, n) => { out[corner] += clipped[n] / sum; });
    count++;
  })));
  return count ? out.map((w) => w / count) : null;
}

/** @param {number} at @param {number[]} found @param {number} slack @returns {number[] | null} */
function sharesOf(at, found, slack) {
  const last = found.length - 1;
  if (at < found[0] - slack || at > found[last] + slack) return null;
  const inside = Math.min(Math.max(at, found[0]), found[last]), out = found.map(() => 0);
  let k = 0;
  while (k < last - 1 && inside > found[k + 1]) k++;
  const share = (inside - found[k]) / (found[k + 1] - found[k]);
  out[k] = 1 - share;
  out[k + 1] = share;
  return out;
}

/** Corners of the grid; for a corner the other three and the middle; null without a rectangle. @param {Port[]} outputs
 * @param {number} target @returns {number[] | null} */
export function thesisZeros(outputs, target) {
  const grid = latticeOf(outputs);
  if (!grid) return null;
  const last = [grid.rows.length - 1, grid.columns.length - 1];
  const corner = (/** @type {number} */ i) => grid.place[i].every((v, axis) => v === 0 || v === last[axis]);
  const chosen = outputs.map((_, i) => i).filter((i) => i !== target && corner(i));
  if (chosen.length === 3) {
    const off = outputs.map((_, i) => Math.abs(grid.place[i][0] - last[0] / 2) + Math.abs(grid.place[i][1] - last[1] / 2));
    const middle = off.indexOf(Math.min(...off));
    if (middle !== target && !chosen.includes(middle)) chosen.push(middle);
  }
  return chosen;
}

/** The thesis' corners for up to four actuators on a grid, else all others. @param {Port[]} outputs @param {number} target
 * @param {number} actuators that are known at all @returns {number[]} */
export function autoZeros(outputs, target, actuators) {
  const corners = actuators <= 4 ? thesisZeros(outputs, target) : null;
  return corners ?? outputs.map((_, i) => i).filter((i) => i !== target);
}
