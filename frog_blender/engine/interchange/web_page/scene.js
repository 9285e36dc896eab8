// The scene's numbers, unpacked: see page.py, which writes them.

const ROW = 2048; // texels of a texture's row

/** Bytes of base64 text. */
function bytesOf(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** What zlib compressed. */
async function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** One column's integers, number by number of a Gaussian and frame by frame. */
class Column {
  constructor(description, bytes, frames) {
    Object.assign(this, description);
    this.frames = this.film ? frames : 1;
    const count = this.width * this.frames * this.rows;
    const wide = this.steps > 255;
    this.values = wide ? new Uint16Array(count) : bytes;
    if (wide) for (let i = 0; i < count; i++) this.values[i] = bytes[i] | (bytes[count + i] << 8);
    // Each frame is the difference from the one before; the integers wrap round.
    for (let number = 0; number < this.width; number++)
      for (let i = this.rows; i < this.frames * this.rows; i++) {
        const at = number * this.frames * this.rows + i;
        this.values[at] += this.values[at - this.rows];
      }
  }

  /**
   * Writes a number of every Gaussian at a frame: row r goes to target[begin + r * stride].
   * Between frames quantised values are blended, so sizes blend as logarithms; a whole frame is shown as it is.
   */
  write(number, frame, target, begin, stride) {
    const last = this.frames - 1;
    const before = Math.min(Math.floor(frame), last);
    const share = Math.min(frame, last) - before;
    const first = (number * this.frames + before) * this.rows;
    const next = share > 0 ? first + this.rows : first;
    const low = this.low[number];
    const unit = (this.high[number] - low) / this.steps;
    const { values, curve } = this;
    const center = this.center ? this.center[number] : 0;
    const spread = this.spread ? this.spread[number] : 1;
    for (let row = 0; row < this.rows; row++) {
      const a = values[first + row];
      let value = low + unit * (a + share * (values[next + row] - a));
      if (curve === "exp") value = Math.exp(value);
      else if (curve === "sinh") value = center + spread * Math.sinh(value);
      target[begin + row * stride] = value;
    }
  }
}

/** Gaussians by time, in the layout of the renderer's textures. */
class Scene {
  static async load(description, data) {
    const scene = new Scene();
    Object.assign(scene, description);
    scene.columns = [];
    let begin = 0;
    for (const array of description.arrays) {
      const bytes = await inflated(data.subarray(begin, begin + array.bytes));
      scene.columns.push(new Column(array, bytes, description.frames));
      begin += array.bytes;
    }
    // Three RGBA texels: position and opacity, quaternion, size; then one for each SH coefficient.
    scene.texels = 3 + scene.sh_count;
    scene.rows = Math.ceil((scene.count * scene.texels) / ROW);
    scene.numbers = new Float32Array(4 * ROW * scene.rows);
    for (const column of scene.columns) if (!column.film) scene.place(column, 0, scene.count - column.rows);
    scene.frame = -1;
    return scene;
  }

  /** Where the numbers of a column lie among the 4 * texels of a Gaussian. */
  offsets(name) {
    if (name === "means") return [0, 1, 2];
    if (name === "quaternions") return [4, 5, 6, 7];
    if (name === "scales") return [8, 9, 10];
    if (name === "base") return [12, 13, 14, 3]; // the first coefficient and the opacity
    const coefficient = 12 + 4 * Number(name.slice(3));
    return [coefficient, coefficient + 1, coefficient + 2];
  }

  place(column, frame, firstRow) {
    const stride = 4 * this.texels;
    this.offsets(column.name).forEach((offset, number) =>
      column.write(number, frame, this.numbers, firstRow * stride + offset, stride));
  }

  /** Moves the dynamic Gaussians to a frame, which may lie between two; true where anything changed. */
  show(frame) {
    frame = Math.min(Math.max(frame, 0), this.frames - 1);
    if (this.held) frame = Math.floor(frame);
    const changed = this.frame < 0 || (this.dynamic > 0 && frame !== this.frame);
    if (changed) for (const column of this.columns) if (column.film) this.place(column, frame, 0);
    this.frame = frame;
    return changed;
  }
}
