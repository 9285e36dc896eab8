// The scene's numbers, unpacked as they arrive: see page.py, which writes them.

/** One column's integers, frame by frame and number by number of a Gaussian. */
class Column {
  constructor(description, frames) {
    Object.assign(this, description);
    this.frames = this.film ? frames : 1;
    this.count = this.width * this.rows; // of a frame's integers
    this.wide = this.steps > 255;
    this.size = this.wide ? 2 * this.count : this.count; // of their bytes
    this.values = new (this.wide ? Uint16Array : Uint8Array)(this.count * this.frames);
    this.arrived = 0;
  }

  /** The next frame's bytes: the difference from the one before; the integers wrap round. */
  add(bytes) {
    const { values, count } = this;
    const begin = this.arrived++ * count;
    for (let i = 0; i < count; i++) {
      const value = this.wide ? bytes[i] | (bytes[count + i] << 8) : bytes[i];
      values[begin + i] = begin ? value + values[begin + i - count] : value;
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
    const first = before * this.count + number * this.rows;
    const next = share > 0 ? first + this.count : first;
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
  constructor(description) {
    Object.assign(this, description);
    this.columns = this.arrays.map((array) => new Column(array, this.frames));
    this.numbers = new Float32Array(4 * this.texture[0] * this.texture[1]);
    const films = this.columns.filter((column) => column.film);
    this.coming = [...this.columns, ...Array(this.frames - 1).fill(films).flat()];
    this.drawable = this.columns.filter((column) => !column.name.startsWith("sh")).length;
    this.next = this.filled = 0;
    this.part = new Uint8Array(Math.max(...this.columns.map((column) => column.size)));
    this.frame = -1;
  }

  /** Takes bytes in the order in which they are stored. */
  add(bytes) {
    for (let begin = 0; begin < bytes.length; ) {
      const column = this.coming[this.next];
      if (!column) throw new Error("There is more than the scene has.");
      const taken = bytes.subarray(begin, begin + column.size - this.filled);
      this.part.set(taken, this.filled);
      begin += taken.length;
      this.filled += taken.length;
      if (this.filled < column.size) return;
      column.add(this.part);
      if (!column.film) this.place(column, 0, this.count - column.rows);
      if (column.arrived === 1) this.renewed = true;
      this.filled = 0;
      this.next++;
    }
  }

  /** How many frames can be shown; the first can before its colours depend on the view. */
  get arrived() {
    if (this.next === this.coming.length) return this.frames;
    if (this.next < this.drawable) return 0;
    return Math.max(this.coming[this.next].arrived, 1);
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

  /** Moves the dynamic Gaussians to a frame, which may lie between two; returns how many rows of numbers changed. */
  show(frame) {
    frame = Math.min(Math.max(frame, 0), this.arrived - 1);
    if (this.held) frame = Math.floor(frame);
    const [width, height] = this.texture;
    const moved = frame !== this.frame ? Math.ceil((this.dynamic * this.texels) / width) : 0;
    const changed = this.renewed ? height : moved;
    if (changed) for (const column of this.columns) if (column.film && column.arrived) this.place(column, frame, 0);
    this.renewed = false;
    this.frame = frame;
    return changed;
  }
}
