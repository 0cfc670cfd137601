/**
 * What stands in the picture: moved skin, cones with their coils, lines where tissues meet.
 *
 * @typedef {import("./field.js").Surface} Surface
 * @typedef {import("./device.js").Port} Port
 */
const HEIGHT_OF_CONE = 6, HEIGHT_OF_COIL = 9.85, RADIUS_OF_COIL = 7, AROUND = 28;

/**
 * Positions moved by `gain` [mm per m] and the smooth normals of what results, where it is seen.
 * @param {Surface} surface @param {import("./seen.js").Seen} seen @param {Float32Array} moved [m] @param {number} gain
 * @param {Float32Array} positions @param {Float32Array} normals
 */
export function deform(surface, seen, moved, gain, positions, normals) {
  const { rest } = surface, { faces, vertices } = seen;
  for (let i = 0; i < vertices.length; i++) for (let a = 3 * vertices[i], end = a + 3; a < end; a++) {
    positions[a] = rest[a] + gain * moved[a];
    normals[a] = 0;
  }
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const x = positions[a], y = positions[a + 1], z = positions[a + 2];
    const ux = positions[b] - x, uy = positions[b + 1] - y, uz = positions[b + 2] - z;
    const vx = positions[c] - x, vy = positions[c + 1] - y, vz = positions[c + 2] - z;
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
    normals[a] += nx; normals[a + 1] += ny; normals[a + 2] += nz;
    normals[b] += nx; normals[b + 1] += ny; normals[b + 2] += nz;
    normals[c] += nx; normals[c + 1] += ny; normals[c + 2] += nz;
  }
}

/** Triangles [mm] of a cone and its coil, and their normals. @param {Port} port @returns {{triangles: Float32Array, normals: Float32Array, top: number[]}} */
export function actuatorBody(port) {
  const foot = port.position.map((v) => 1e3 * v), axis = port.axis;
  const side = Math.abs(axis[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0];
  const u = unit(cross(axis, side)), v = cross(axis, u), low = Math.max(1e3 * port.radius, 0.8);
  const profile = [[low, 0], [low, 0.3], [RADIUS_OF_COIL * 0.8, HEIGHT_OF_CONE], [RADIUS_OF_COIL, HEIGHT_OF_CONE], [RADIUS_OF_COIL, HEIGHT_OF_CONE + HEIGHT_OF_COIL], [0, HEIGHT_OF_CONE + HEIGHT_OF_COIL]];
  /** @type {number[]} */
  const triangles = [], normals = [];
  const at = (/** @type {number[]} */ [r, z], /** @type {number} */ k) => {
    const a = (2 * Math.PI * k) / AROUND, c = Math.cos(a), s = Math.sin(a);
    return foot.map((f, i) => f + r * (c * u[i] + s * v[i]) + z * axis[i]);
  };
  for (let p = 0; p + 1 < profile.length; p++) for (let k = 0; k < AROUND; k++) {
    const q = [at(profile[p], k), at(profile[p], k + 1), at(profile[p + 1], k + 1), at(profile[p + 1], k)];
    const across = cross(minus(q[2], q[0]), minus(q[3], q[1]));
    for (const i of [0, 1, 2, 0, 2, 3]) { triangles.push(...q[i]); normals.push(...across); }
  }
  const top = foot.map((f, i) => f + (HEIGHT_OF_CONE + HEIGHT_OF_COIL) * axis[i]);
  return { triangles: Float32Array.from(triangles), normals: Float32Array.from(normals), top };
}

/** @param {number[]} a @param {number[]} b */
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {number[]} a @param {number[]} b */
const minus = (a, b) => a.map((v, i) => v - b[i]);
/** @param {number[]} a */
const unit = (a) => { const s = Math.hypot(...a) || 1; return a.map((v) => v / s); };

/** Lines where tissues meet and where the section ends: pairs of vertices. @param {Surface} surface @returns {Uint32Array} */
export function outlines(surface) {
  /** @type {Map<string, number[]>} */
  const seen = new Map();
  for (let f = 0; f < surface.faces.length / 3; f++) for (let e = 0; e < 3; e++) {
    const a = surface.faces[3 * f + e], b = surface.faces[3 * f + ((e + 1) % 3)], key = a < b ? `${a} ${b}` : `${b} ${a}`;
    seen.set(key, [...(seen.get(key) ?? []), surface.tissue ? surface.tissue[f] : 0]);
  }
  const pairs = [...seen].filter(([, t]) => t.length === 1 || t[0] !== t[1]).flatMap(([key]) => key.split(" ").map(Number));
  return Uint32Array.from(pairs);
}
