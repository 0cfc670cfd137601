/**
 * Arrays out of the page's JSON, and complex arrays as two rows of numbers.
 *
 * @typedef {{re: Float64Array, im: Float64Array}} Complex
 * @typedef {{kind: string, shape: number[], data: string}} Packed
 * @typedef {Float32Array | Float64Array | Int16Array | Uint16Array | Uint32Array | Int32Array | Uint8Array} Numbers
 */

/** @param {number} n @returns {Complex} n zeros */
export function zeros(n) {
  return { re: new Float64Array(n), im: new Float64Array(n) };
}

/** @param {string} text base64 @returns {ArrayBuffer} */
function bytesOf(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes.buffer;
}

/** Real numbers as they were packed. @param {Packed} packed @returns {any} */
export function unpack(packed) {
  const bytes = bytesOf(packed.data);
  switch (packed.kind) {
    case "f4": return new Float32Array(bytes);
    case "f8": return new Float64Array(bytes);
    case "i2": return new Int16Array(bytes);
    case "u2": return new Uint16Array(bytes);
    case "u4": return new Uint32Array(bytes);
    case "i4": return new Int32Array(bytes);
    case "u1": return new Uint8Array(bytes);
    default: throw new Error(`the page holds an array of unknown kind ${packed.kind}`);
  }
}

/** Complex numbers, packed as pairs. @param {Packed} packed @returns {Complex} */
export function unpackComplex(packed) {
  const bytes = bytesOf(packed.data);
  const pairs = packed.kind === "c8" ? new Float32Array(bytes) : new Float64Array(bytes);
  const out = zeros(pairs.length / 2);
  for (let i = 0; i < out.re.length; i++) {
    out.re[i] = pairs[2 * i];
    out.im[i] = pairs[2 * i + 1];
  }
  return out;
}

/** Shapes of the field from 16 bits. @param {{scale: Packed, values: Packed}} packed @returns {Float32Array} */
export function unpackShapes(packed) {
  const scale = unpack(packed.scale), values = unpack(packed.values), k = scale.length;
  const out = new Float32Array(values.length);
  for (let i = 0; i < out.length; i += k) for (let j = 0; j < k; j++) out[i + j] = values[i + j] * scale[j];
  return out;
}

/** Amplitudes (frequency x k x input) from 16 bits. @param {{scale: Packed, values: Packed}} packed @returns {Complex} */
export function unpackAmplitudes(packed) {
  const scale = unpack(packed.scale), values = unpack(packed.values), [frequencies, k, inputs] = packed.values.shape, out = zeros(values.length / 2);
  for (let f = 0, at = 0; f < frequencies; f++) for (let j = 0; j < k; j++) for (let a = 0; a < inputs; a++, at++) {
    out.re[at] = values[2 * at] * scale[f * inputs + a];
    out.im[at] = values[2 * at + 1] * scale[f * inputs + a];
  }
  return out;
}
