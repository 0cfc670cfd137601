/**
 * Which triangles of a surface a view can show: the others need neither be moved nor drawn.
 *
 * @typedef {import("./field.js").Surface} Surface
 * @typedef {{faces: Uint16Array | Uint32Array, vertices: Uint32Array}} Seen  triangles, and the vertices that they use
 */

const ROOM = 1.25, EDGE_ON = 0.25; // of the panel, for what motion brings in; of a normal, for what motion turns

/** All of a surface. @param {Surface} surface @returns {Seen} */
export function all(surface) {
  return { faces: surface.faces, vertices: Uint32Array.from({ length: surface.rest.length / 3 }, (_, v) => v) };
}

/** Vertices on open edges, through which the other side of the skin is seen. @param {Surface} surface @returns {Uint32Array} */
export function openEdges(surface) {
  const { faces, rest } = surface, n = rest.length / 3;
  /** @type {Map<number, number>} */
  const count = new Map();
  for (let f = 0; f < faces.length; f += 3) for (let e = 0; e < 3; e++) {
    const a = faces[f + e], b = faces[f + ((e + 1) % 3)], key = a < b ? a * n + b : b * n + a;
    count.set(key, (count.get(key) ?? 0) + 1);
  }
  const open = new Set();
  for (const [key, c] of count) if (c === 1) { open.add(Math.floor(key / n)); open.add(key % n); }
  return Uint32Array.from(open);
}

/**
 * Triangles inside the panel; those that face away are left out as long as no open edge lets one look inside.
 * @param {Surface} surface @param {Uint32Array} open vertices on open edges @param {Float32Array} matrix to the panel
 * @param {number[]} eye [mm] where it is looked from @param {boolean} opened whether a cut lets one look inside
 * @returns {Seen}
 */
export function seen(surface, open, matrix, eye, opened) {
  const { rest, faces } = surface, n = rest.length / 3, outside = new Uint8Array(n), used = new Uint8Array(n);
  for (let v = 0; v < n; v++) outside[v] = sides(matrix, rest, 3 * v);
  const inside = opened || open.some((v) => !outside[v]), kept = faces.slice();
  let count = 0;
  for (let f = 0; f < faces.length; f += 3) {
    const a = faces[f], b = faces[f + 1], c = faces[f + 2];
    if ((outside[a] & outside[b] & outside[c]) || !(inside || facing(rest, 3 * a, 3 * b, 3 * c, eye))) continue;
    kept[count++] = a; kept[count++] = b; kept[count++] = c;
    used[a] = used[b] = used[c] = 1;
  }
  let vertices = 0;
  const list = new Uint32Array(n);
  for (let v = 0; v < n; v++) if (used[v]) list[vertices++] = v;
  return { faces: kept.slice(0, count), vertices: list.slice(0, vertices) };
}

/** Bits for the sides of the panel that a vertex lies beyond. @param {Float32Array} m @param {Float32Array} p @param {number} i */
function sides(m, p, i) {
  const [x, y, w] = [0, 1, 3].map((r) => m[r] * p[i] + m[4 + r] * p[i + 1] + m[8 + r] * p[i + 2] + m[12 + r]), most = ROOM * w;
  return w <= 0 ? 0 : (x < -most ? 1 : x > most ? 2 : 0) | (y < -most ? 4 : y > most ? 8 : 0);
}

/** Whether a triangle, counted anticlockwise from outside, faces the eye or nearly. @param {Float32Array} p @param {number} a
 * @param {number} b @param {number} c @param {number[]} eye */
function facing(p, a, b, c, eye) {
  const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2], vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
  const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx, ex = eye[0] - p[a], ey = eye[1] - p[a + 1], ez = eye[2] - p[a + 2];
  return nx * ex + ny * ey + nz * ez > -EDGE_ON * Math.hypot(nx, ny, nz) * Math.hypot(ex, ey, ez);
}
