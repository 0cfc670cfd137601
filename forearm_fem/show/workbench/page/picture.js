/** The picture: camera, what is seen, bodies, and pixels. */

/**
 * Where the arms are looked at from: one camera for all panels.
 *
 * @typedef {{turn: number, tilt: number, far: number, centre: number[]}} View  angles [rad], lengths [mm]
 * @typedef {{x: number, y: number, w: number, h: number}} Box  [css px] from the canvas' upper left corner
 */

/** Unit vector from the centre to the eye. @param {View} view */
export function eyeOf(view) {
  return [Math.cos(view.tilt) * Math.cos(view.turn), Math.cos(view.tilt) * Math.sin(view.turn), Math.sin(view.tilt)];
}

/** @param {View} view @param {number} w @param {number} h @returns {Float32Array} column by column */
export function matrixOf(view, w, h) {
  const { turn, tilt, far, centre } = view, e = eyeOf(view);
  const x = [-Math.sin(turn), Math.cos(turn), 0], y = [-Math.sin(tilt) * Math.cos(turn), -Math.sin(tilt) * Math.sin(turn), Math.cos(tilt)];
  const dot = (/** @type {number[]} */ a) => a[0] * centre[0] + a[1] * centre[1] + a[2] * centre[2];
  const rows = [[...x, -dot(x)], [...y, -dot(y)], [...e, -dot(e) - far]];
  const f = 2.6 * Math.min(1, w / h), near = far / 20, end = far * 6, a = (near + end) / (near - end), b = (2 * near * end) / (near - end);
  const out = new Float32Array(16);
  for (let c = 0; c < 4; c++) {
    out[4 * c] = ((f * h) / w) * rows[0][c];
    out[4 * c + 1] = f * rows[1][c];
    out[4 * c + 2] = a * rows[2][c] + (c === 3 ? b : 0);
    out[4 * c + 3] = -rows[2][c];
  }
  return out;
}

/** Place [css px] in the panel and depth of a point [mm]. @param {Float32Array} m @param {ArrayLike<number>} p @param {Box} box
 * @returns {[number, number, number]} */
export function project(m, p, box) {
  const q = [0, 1, 3].map((r) => m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r]);
  return [box.x + (0.5 + (0.5 * q[0]) / q[2]) * box.w, box.y + (0.5 - (0.5 * q[1]) / q[2]) * box.h, q[2]];
}

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

/**
 * What stands in the picture: moved skin, cones with their coils, lines where tissues meet.
 *
 * @typedef {import("./field.js").Surface} Surface
 * @typedef {import("./device.js").Port} Port
 */
const HEIGHT_OF_CONE = 6, HEIGHT_OF_COIL = 9.85, RADIUS_OF_COIL = 7, AROUND = 28;

/**
 * Positions moved by `gain` [mm per m] and the smooth normals of what results, where it is seen.
 * @param {Surface} surface @param {import("./picture.js").Seen} seen @param {Float32Array} moved [m] @param {number} gain
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

/**
 * Triangles drawn by the processor, as quickly with a graphics processor as without one: one buffer of pixels and depths,
 * one panel after the other.
 *
 * @typedef {import("./picture.js").View} View
 * @typedef {import("./picture.js").Box} Box
 * @typedef {import("./picture.js").Seen} Seen
 * @typedef {{matrix: Float32Array, eye: number[], panel: Panel}} Camera
 * @typedef {{left: number, top: number, right: number, bottom: number, x: number, y: number, w: number, h: number}} Panel [pixels]
 * @typedef {{limit: number, table: Uint32Array, cut: number[] | null, flat: boolean}} Look  colours end at `limit` [m]
 */
const LEVELS = 64, DARKEST = 0.5, SPREAD = 0.6, NEAREST = 1; // [mm] before the eye

/** Colour and light to pixels: five stops from -1 to 1, `LEVELS` of light. @param {number[]} stops @returns {Uint32Array} */
export function tableOf(stops) {
  const table = new Uint32Array(256 * LEVELS);
  for (let l = 0; l < LEVELS; l++) for (let c = 0; c < 256; c++) {
    const s = (4 * c) / 255, i = Math.min(Math.floor(s), 3), light = DARKEST + (SPREAD * l) / (LEVELS - 1);
    const [r, g, b] = [0, 1, 2].map((k) => Math.min(255, Math.round(255 * light * (stops[3 * i + k] + (s - i) * (stops[3 * i + 3 + k] - stops[3 * i + k])))));
    table[256 * l + c] = (0xff000000 | (b << 16) | (g << 8) | r) >>> 0;
  }
  return table;
}

export class Raster {
  constructor() {
    this.width = this.height = 0;
    this.pixels = new Uint32Array(0);
    this.depth = new Float32Array(0);
    /** Of each vertex: place [pixels], one over its distance, colour, light, how far beyond the cut. */
    this.x = this.y = this.z = this.c = this.l = this.d = new Float32Array(0);
  }

  /** Empty, in another size if need be. @param {number} width @param {number} height */
  begin(width, height) {
    if (width === this.width && height === this.height) {
      this.pixels.fill(0);
      this.depth.fill(0);
      return;
    }
    this.width = width;
    this.height = height;
    this.pixels = new Uint32Array(width * height);
    this.depth = new Float32Array(width * height);
  }

  /** The pixels as a picture. @returns {ImageData} */
  image() {
    return new ImageData(new Uint8ClampedArray(this.pixels.buffer), this.width, this.height);
  }

  /** @param {Box} box [css px] @param {number} scale pixels per css pixel @returns {Panel} */
  panel(box, scale) {
    const left = Math.max(Math.round(box.x * scale), 0), top = Math.max(Math.round(box.y * scale), 0);
    return { left, top, right: Math.min(Math.round((box.x + box.w) * scale), this.width), bottom: Math.min(Math.round((box.y + box.h) * scale), this.height), x: box.x * scale, y: box.y * scale, w: box.w * scale, h: box.h * scale };
  }

  /** @param {Float32Array} positions [mm] @param {ArrayLike<number>} vertices @param {Camera} camera */
  place(positions, vertices, { matrix: m, panel }) {
    const n = positions.length / 3;
    if (this.x.length < n) [this.x, this.y, this.z, this.c, this.l, this.d] = [0, 0, 0, 0, 0, 0].map(() => new Float32Array(n));
    const { x, y, z } = this;
    for (let i = 0; i < vertices.length; i++) {
      const v = vertices[i], a = positions[3 * v], b = positions[3 * v + 1], c = positions[3 * v + 2];
      const w = m[3] * a + m[7] * b + m[11] * c + m[15], one = w > NEAREST ? 1 / w : 0;
      x[v] = panel.x + (0.5 + 0.5 * (m[0] * a + m[4] * b + m[8] * c + m[12]) * one) * panel.w;
      y[v] = panel.y + (0.5 - 0.5 * (m[1] * a + m[5] * b + m[9] * c + m[13]) * one) * panel.h;
      z[v] = one;
    }
  }

  /**
   * Skin or section, coloured by displacement and lit from above the eye.
   * @param {Seen} seen @param {Float32Array} positions [mm] @param {Float32Array} normals of any length @param {Float32Array} u [m]
   * @param {Camera} camera @param {Look} look
   */
  surface(seen, positions, normals, u, camera, look) {
    const { vertices, faces } = seen, { c, l, d, x, y, z } = this.placed(positions, vertices, camera), { eye, panel } = camera;
    const half = [eye[0] - 0.5, eye[1] + 0.35, eye[2] + 0.9], size = Math.hypot(...half), plain = ((1 - DARKEST) / SPREAD) * (LEVELS - 1);
    for (let i = 0; i < vertices.length; i++) {
      const v = vertices[i], p = normals[3 * v], q = normals[3 * v + 1], r = normals[3 * v + 2];
      c[v] = 127.5 * (1 + Math.min(Math.max(u[v] / look.limit, -1), 1));
      if (look.cut) d[v] = look.cut[0] * positions[3 * v] + look.cut[1] * positions[3 * v + 1] + look.cut[2] * positions[3 * v + 2] - look.cut[3];
      if (look.flat) { l[v] = plain; continue; }
      const length = (p * eye[0] + q * eye[1] + r * eye[2] < 0 ? -1 : 1) * Math.sqrt(p * p + q * q + r * r) || 1;
      const shine = Math.max((p * half[0] + q * half[1] + r * half[2]) / (size * length), 0);
      l[v] = Math.min(Math.max(((0.62 + 0.3 * shine + (0.1 * r) / length - DARKEST) / SPREAD) * (LEVELS - 1), 0), LEVELS - 1);
    }
    for (let f = 0; f < faces.length; f += 3) {
      const i = faces[f], j = faces[f + 1], k = faces[f + 2];
      const left = Math.max(Math.ceil(Math.min(x[i], x[j], x[k]) - 0.5), panel.left), right = Math.min(Math.floor(Math.max(x[i], x[j], x[k]) - 0.5), panel.right - 1);
      const top = Math.max(Math.ceil(Math.min(y[i], y[j], y[k]) - 0.5), panel.top), bottom = Math.min(Math.floor(Math.max(y[i], y[j], y[k]) - 0.5), panel.bottom - 1);
      if (left > right || top > bottom || !(z[i] && z[j] && z[k])) continue;
      const cutting = look.cut !== null && (d[i] > 0 || d[j] > 0 || d[k] > 0);
      if (cutting && d[i] > 0 && d[j] > 0 && d[k] > 0) continue;
      this.fill(i, j, k, left, right, top, bottom, look.table, cutting);
    }
  }

  /** @param {Float32Array} positions @param {ArrayLike<number>} vertices @param {Camera} camera */
  placed(positions, vertices, camera) {
    this.place(positions, vertices, camera);
    return this;
  }

  /** One triangle; everything is linear across it. @param {number} i @param {number} j @param {number} k @param {number} left
   * @param {number} right @param {number} top @param {number} bottom @param {Uint32Array} table @param {boolean} cutting */
  fill(i, j, k, left, right, top, bottom, table, cutting) {
    const { x, y, z, c, l, d, pixels, depth, width } = this;
    const ux = x[j] - x[i], uy = y[j] - y[i], vx = x[k] - x[i], vy = y[k] - y[i], area = ux * vy - vx * uy;
    if (area === 0) return;
    // shares p of vertex j and q of vertex k, and how they grow to the right
    const px = vy / area, py = -vx / area, qx = -uy / area, qy = ux / area;
    const zj = z[j] - z[i], zk = z[k] - z[i], cj = c[j] - c[i], ck = c[k] - c[i], lj = l[j] - l[i], lk = l[k] - l[i];
    const dz = px * zj + qx * zk, dc = px * cj + qx * ck, dl = px * lj + qx * lk;
    for (let row = top; row <= bottom; row++) {
      const ex = left + 0.5 - x[i], ey = row + 0.5 - y[i];
      let p = px * ex + py * ey, q = qx * ex + qy * ey, deep = z[i] + p * zj + q * zk, colour = c[i] + p * cj + q * ck, light = l[i] + p * lj + q * lk;
      for (let at = row * width + left, end = row * width + right; at <= end; at++) {
        if (p >= 0 && q >= 0 && p + q <= 1 && deep > depth[at] && !(cutting && d[i] + p * (d[j] - d[i]) + q * (d[k] - d[i]) > 0)) {
          depth[at] = deep;
          pixels[at] = table[(light << 8) | colour];
        }
        p += px; q += qx; deep += dz; colour += dc; light += dl;
      }
    }
  }

  /** Something seen through: triangles in a row, each of one shade, that hide nothing. @param {Float32Array} triangles [mm]
   * @param {Float32Array} normals @param {number[]} tone red, green, blue, opacity @param {Camera} camera */
  glass(triangles, normals, tone, camera) {
    const { x, y, z } = this.placed(triangles, Array.from({ length: triangles.length / 3 }, (_, v) => v), camera), { eye, panel } = camera;
    for (let i = 0; i < triangles.length / 3; i += 3) {
      const [p, q, r] = normals.subarray(3 * i, 3 * i + 3), light = 0.7 + (0.3 * Math.abs(p * eye[0] + q * eye[1] + r * eye[2])) / (Math.hypot(p, q, r) || 1);
      const shade = tone.slice(0, 3).map((t) => 255 * t * light), j = i + 1, k = i + 2;
      const left = Math.max(Math.ceil(Math.min(x[i], x[j], x[k]) - 0.5), panel.left), right = Math.min(Math.floor(Math.max(x[i], x[j], x[k]) - 0.5), panel.right - 1);
      const top = Math.max(Math.ceil(Math.min(y[i], y[j], y[k]) - 0.5), panel.top), bottom = Math.min(Math.floor(Math.max(y[i], y[j], y[k]) - 0.5), panel.bottom - 1);
      if (!(z[i] && z[j] && z[k])) continue;
      const ux = x[j] - x[i], uy = y[j] - y[i], vx = x[k] - x[i], vy = y[k] - y[i], area = ux * vy - vx * uy;
      for (let row = top; row <= bottom && area; row++) for (let column = left; column <= right; column++) {
        const ex = column + 0.5 - x[i], ey = row + 0.5 - y[i], a = (vy * ex - vx * ey) / area, b = (ux * ey - uy * ex) / area;
        if (a >= 0 && b >= 0 && a + b < 1 && z[i] + a * (z[j] - z[i]) + b * (z[k] - z[i]) > this.depth[row * this.width + column]) this.blend(row * this.width + column, shade, tone[3]);
      }
    }
  }

  /** Lines between vertices, a pixel wide and a little before what they lie on. @param {Uint32Array} pairs
   * @param {Float32Array} positions [mm] @param {number[]} tone red, green, blue, opacity @param {Camera} camera */
  lines(pairs, positions, tone, camera) {
    const { x, y, z } = this.placed(positions, pairs, camera), { panel } = camera, shade = tone.slice(0, 3).map((t) => 255 * t);
    for (let e = 0; e < pairs.length; e += 2) {
      const i = pairs[e], j = pairs[e + 1], steps = Math.ceil(Math.max(Math.abs(x[j] - x[i]), Math.abs(y[j] - y[i])));
      if (!z[i] || !z[j] || steps > 4 * this.width) continue;
      for (let s = 0; s < steps; s++) {
        const t = s / steps, column = Math.floor(x[i] + t * (x[j] - x[i])), row = Math.floor(y[i] + t * (y[j] - y[i])), at = row * this.width + column;
        if (column >= panel.left && column < panel.right && row >= panel.top && row < panel.bottom && 1.003 * (z[i] + t * (z[j] - z[i])) > this.depth[at]) this.blend(at, shade, tone[3]);
      }
    }
  }

  /** Lay a shade over a pixel, which may itself be seen through. @param {number} at @param {number[]} shade 0 to 255 @param {number} opacity */
  blend(at, shade, opacity) {
    const under = this.pixels[at], below = ((under >>> 24) / 255) * (1 - opacity), all = opacity + below;
    const mix = (/** @type {number} */ over, /** @type {number} */ old) => Math.min(255, (over * opacity + old * below) / all);
    this.pixels[at] = ((Math.round(255 * all) << 24) | (mix(shade[2], (under >>> 16) & 255) << 16) | (mix(shade[1], (under >>> 8) & 255) << 8) | mix(shade[0], under & 255)) >>> 0;
  }
}
