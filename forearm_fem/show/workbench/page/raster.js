/**
 * Triangles drawn by the processor, as quickly with a graphics processor as without one: one buffer of pixels and depths,
 * one panel after the other.
 *
 * @typedef {import("./view.js").View} View
 * @typedef {import("./view.js").Box} Box
 * @typedef {import("./seen.js").Seen} Seen
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
